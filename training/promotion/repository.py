"""The folder of a repository: what is published there, read back with distrust and written whole.

repository/
  trusted-root.json         the first root, for technicians to carry to units
  metadata/N.root.json      who may sign: every version, so that a unit that slept for years can follow
  metadata/N.targets.json   which bundles there are, and which one each ring runs
  metadata/N.snapshot.json  which targets are of today
  metadata/timestamp.json   which snapshot is; the only name that is ever written over
  targets/                  files, each with its SHA-256 in front of its name
  staged/change.json        a change that waits for signatures (`training.promotion.change`)

References:
    The Update Framework, specification 1.0, sections 6.2 (consistent snapshots) and 4 (file formats).
"""

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TypeVar

from tuf.api.exceptions import RepositoryError, UnsignedMetadataError
from tuf.api.metadata import Metadata, Root, Snapshot, TargetFile, Targets, Timestamp
from tuf.api.serialization import DeserializationError

from roadgrip.errors import RoadgripError
from roadgrip.release import METADATA_FOLDER, TARGETS_FOLDER, Release, bundle_target, release_from_json
from training.promotion.keys import ROLES, TRUSTED_ROOT_NAME

STAGED_FOLDER = "staged"
PERIODS_FIELD = "x-roadgrip-expiry-days"
"""The root says, signed, how long each role's metadata lasts: whoever refreshes need not be told."""
KEPT_VERSIONS_COUNT = 20
"""Snapshots and targets that stay beside the newest, for units and mirrors that are in the middle of reading."""
_RINGS = "rings/"
_BUNDLES = "bundles/"
_Signed = TypeVar("_Signed", Root, Targets, Snapshot, Timestamp)


class RepositoryFolderError(RoadgripError):
    """A repository that cannot be read, or must not be built upon; the message says where."""


@dataclass(frozen=True, slots=True)
class Published:
    """What units can read, as it was signed.

    Attributes:
        root: The newest.
        targets: What the snapshot names.
        snapshot: What the timestamp names.
        timestamp: The beginning of every visit.
    """

    root: Metadata[Root]
    targets: Metadata[Targets]
    snapshot: Metadata[Snapshot]
    timestamp: Metadata[Timestamp]


@dataclass(frozen=True, slots=True)
class Repository:
    """A repository in a folder.

    Attributes:
        folder: See the module.
    """

    folder: Path

    @property
    def metadata_folder(self) -> Path:
        """What is signed."""
        return self.folder / METADATA_FOLDER

    @property
    def targets_folder(self) -> Path:
        """What the signatures are about."""
        return self.folder / TARGETS_FOLDER

    @property
    def change_path(self) -> Path:
        """The change that waits for signatures."""
        return self.folder / STAGED_FOLDER / "change.json"

    @property
    def trusted_root_path(self) -> Path:
        """The first root."""
        return self.folder / TRUSTED_ROOT_NAME

    def root_path(self, version: int) -> Path:
        """Return where a version of the root lies."""
        return self.metadata_folder / f"{version}.root.json"

    def newest_root_version(self) -> int:
        """Return the newest version of the root that follows the first without a gap; 0 without a repository."""
        version = 0
        while self.root_path(version + 1).is_file():
            version += 1
        return version

    def roots(self, *, up_to_version: int | None = None) -> list[Metadata[Root]]:
        """Return all roots, each signed as the one before it demands, the first as it demands itself.

        Raises:
            RepositoryFolderError: There is none, or the chain is broken.
        """
        newest = self.newest_root_version() if up_to_version is None else up_to_version
        if newest < 1:
            raise RepositoryFolderError(f"no repository in {self.folder}: `roadgrip-train keys init` makes one")
        chain: list[Metadata[Root]] = []
        for version in range(1, newest + 1):
            root = read_metadata(self.root_path(version), Root)
            if root.signed.version != version:
                raise RepositoryFolderError(f"{self.root_path(version)} holds version {root.signed.version}")
            for delegator in (*chain[-1:], root):
                check_signed(delegator.signed, root, self.root_path(version))
            chain.append(root)
        return chain

    def published(self, *, root_version: int | None = None) -> Published:
        """Return what units can read, after checking that those who may have signed it.

        An expired date is no reason to refuse: whoever reads this is about to renew it.

        Args:
            root_version: The newest root by default; the one before it while a publication is interrupted.

        Raises:
            RepositoryFolderError: Something is missing, or not signed by those who may; nothing should be built on it.
        """
        root = self.roots(up_to_version=root_version)[-1]
        timestamp = self._checked(self.metadata_folder / "timestamp.json", Timestamp, root.signed)
        snapshot_version = timestamp.signed.snapshot_meta.version
        snapshot = self._checked(self.metadata_folder / f"{snapshot_version}.snapshot.json", Snapshot, root.signed)
        targets_version = snapshot.signed.meta["targets.json"].version
        targets = self._checked(self.metadata_folder / f"{targets_version}.targets.json", Targets, root.signed)
        return Published(root, targets, snapshot, timestamp)

    @staticmethod
    def _checked(path: Path, kind: type[_Signed], root: Root) -> Metadata[_Signed]:
        metadata = read_metadata(path, kind)
        check_signed(root, metadata, path)
        return metadata

    def target_path(self, target: TargetFile) -> Path:
        """Return where a target's file lies."""
        return self.targets_folder / target.get_prefixed_paths()[0]

    def target_bytes(self, target: TargetFile) -> bytes:
        """Return a target's content.

        Raises:
            RepositoryFolderError: It is missing, or not what was signed.
        """
        path = self.target_path(target)
        try:
            content = path.read_bytes()
            target.verify_length_and_hashes(content)
        except (OSError, RepositoryError) as error:
            raise RepositoryFolderError(f"{path} is not what was signed: {error}") from error
        return content

    def add_target(self, name: str, content: bytes) -> TargetFile:
        """Return a target whose file is written; without a signature about it, nobody asks for it."""
        target = TargetFile.from_data(name, content, ["sha256"])
        path = self.target_path(target)
        if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != target.hashes["sha256"]:
            write_whole(path, content)
        return target

    def releases(self, targets: Targets) -> dict[str, Release]:
        """Return what each ring runs.

        Raises:
            RepositoryFolderError: A pointer is not what was signed.
            ReleaseError: It is no release.
        """
        return {
            path.removeprefix(_RINGS).removesuffix(".json"): release_from_json(self.target_bytes(target).decode())
            for path, target in sorted(targets.targets.items())
            if path.startswith(_RINGS)
        }

    def bundle_files(self, targets: Targets, bundle_id: str) -> dict[str, bytes] | None:
        """Return the files of a bundle that the repository holds; None without it.

        Raises:
            RepositoryFolderError: A file is not what was signed.
        """
        prefix = bundle_target(bundle_id, "")
        files = {
            path.removeprefix(prefix): self.target_bytes(target)
            for path, target in targets.targets.items()
            if path.startswith(prefix)
        }
        return files or None

    def surplus_files(self, targets: Targets) -> list[Path]:
        """Return files of targets/ that nothing signed is about any more."""
        signed_for = {self.target_path(target) for target in targets.targets.values()}
        return [path for path in sorted(self.targets_folder.rglob("*")) if path.is_file() and path not in signed_for]

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep a second command from changing the repository at the same time."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / ".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield


def bundle_ids(targets: Targets) -> list[str]:
    """Return the bundles that a repository holds."""
    return sorted({path.split("/")[1] for path in targets.targets if path.startswith(_BUNDLES)})


def read_metadata(path: Path, kind: type[_Signed]) -> Metadata[_Signed]:
    """Return signed metadata; who signed it is not asked here.

    Raises:
        RepositoryFolderError: The file is missing, or holds something else.
    """
    try:
        metadata: Metadata[_Signed] = Metadata.from_bytes(path.read_bytes())
    except (OSError, DeserializationError) as error:
        raise RepositoryFolderError(f"{path} cannot be read: {error}") from error
    if not isinstance(metadata.signed, kind):
        raise RepositoryFolderError(f"{path} holds {metadata.signed.type}, not {kind.type}")
    return metadata


def check_signed(root: Root, metadata: Metadata[_Signed], where: Path) -> None:
    """Do nothing if enough keys that a root names for a role have signed.

    Raises:
        RepositoryFolderError: They have not.
    """
    try:
        root.verify_delegate(metadata.signed.type, metadata.signed_bytes, metadata.signatures)
    except UnsignedMetadataError as error:
        raise RepositoryFolderError(f"{where} must not be trusted: {error}") from error


def expiry(root: Root, role: str, *, now_unix_s: float) -> datetime:
    """Return when metadata that is signed now expires."""
    days = int(root.unrecognized_fields[PERIODS_FIELD][role])
    return datetime.fromtimestamp(int(now_unix_s), tz=UTC) + timedelta(days=days)


def periods_of(root: Root) -> Mapping[str, int]:
    """Return how many days the metadata of each role lasts."""
    return {role: int(root.unrecognized_fields[PERIODS_FIELD][role]) for role in ROLES}


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that whoever reads finds the old one or the new one, even after a power cut."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.partial")
    with partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)

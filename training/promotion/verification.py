"""What a unit would say to a repository: read by the client that units use, from a root that the unit trusts.

Besides, every other file of the folder is looked at: a unit would never ask for one that is not signed for, but a
person who carries the folder wants to know of it.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

from tuf.api.exceptions import DownloadError, DownloadHTTPError, RepositoryError
from tuf.api.metadata import Metadata, Root, Targets
from tuf.api.serialization import DeserializationError
from tuf.ngclient import FetcherInterface, Updater

from roadgrip.errors import RoadgripError
from roadgrip.release import Release, bundle_target, release_from_json
from training.promotion.publication import checked_bundle
from training.promotion.repository import Repository, RepositoryFolderError, bundle_ids, read_metadata

NOT_FOUND = 404
_CHUNK_BYTES = 1 << 16
_RINGS = "rings/"


@dataclass(frozen=True, slots=True)
class Verification:
    """What came of it.

    Attributes:
        releases: What the units of each ring would run.
        problems: A line each; a unit would refuse, or a person should look.
    """

    releases: Mapping[str, Release]
    problems: tuple[str, ...]


class FolderFetcher(FetcherInterface):
    """Reads files as a web server would give them out."""

    def _fetch(self, url: str) -> Iterator[bytes]:
        path = Path(url2pathname(urlsplit(url).path))
        if not path.is_file():
            raise DownloadHTTPError(f"there is no {path}", NOT_FOUND)
        return _chunks(path)


class DatedUpdater(Updater):
    """The client of units, at a time of somebody's choice.

    Args:
        repository: To visit.
        memory_folder: What the unit remembers between visits; it believes the trusted root no less for that.
        trusted_root: What it was given by hand.
        now_unix_s: When it visits.
    """

    def __init__(self, repository: Repository, *, memory_folder: Path, trusted_root: bytes, now_unix_s: float) -> None:
        super().__init__(
            str(memory_folder),
            repository.metadata_folder.resolve().as_uri(),
            target_dir=str(memory_folder),
            target_base_url=repository.targets_folder.resolve().as_uri(),
            fetcher=FolderFetcher(),
            bootstrap=trusted_root,
        )
        # The library asks the clock by itself, here and nowhere else.
        self._trusted_set.reference_time = datetime.fromtimestamp(int(now_unix_s), tz=UTC)


def verify(repository: Repository, trusted_root: bytes, *, now_unix_s: float) -> Verification:
    """Return what units that trust a root would get from a repository, and everything that is wrong with it.

    Args:
        repository: As it lies there.
        trusted_root: The root that units were given by hand.
        now_unix_s: When they look.
    """
    with tempfile.TemporaryDirectory() as name:
        memory = Path(name)
        try:
            unit = DatedUpdater(repository, memory_folder=memory, trusted_root=trusted_root, now_unix_s=now_unix_s)
            unit.refresh()
        except (RepositoryError, DownloadError) as error:
            return Verification({}, (f"a unit would refuse the repository: {_words(error)}",))
        targets = read_metadata(memory / "targets.json", Targets).signed
        contents, problems = _downloaded(unit, targets)
    releases, wrong = _releases(contents)
    problems += wrong
    for bundle_id in bundle_ids(targets):
        problems += _bundle_problems(bundle_id, contents)
    problems += _idle_problems(repository, targets)
    return Verification(releases, tuple(problems))


def _downloaded(unit: Updater, targets: Targets) -> tuple[dict[str, bytes], list[str]]:
    contents, problems = {}, []
    for name in sorted(targets.targets):
        info = unit.get_targetinfo(name)
        try:
            if info is not None:
                contents[name] = Path(unit.download_target(info)).read_bytes()
        except (RepositoryError, DownloadError) as error:
            problems.append(f"a unit would refuse {name}: {_words(error)}")
    return contents, problems


def _releases(contents: Mapping[str, bytes]) -> tuple[dict[str, Release], list[str]]:
    releases, problems = {}, []
    for name, content in contents.items():
        if not name.startswith(_RINGS):
            continue
        ring = name.removeprefix(_RINGS).removesuffix(".json")
        try:
            release = release_from_json(content.decode())
        except (RoadgripError, UnicodeDecodeError) as error:
            problems.append(f"ring {ring}: {error}")
            continue
        if release.ring != ring:
            problems.append(f"ring {ring}: the release in it is for ring {release.ring}")
            continue
        lacking = sorted(
            file
            for file, digest in release.files_sha256.items()
            if hashlib.sha256(contents.get(bundle_target(release.bundle_id, file), b"")).hexdigest() != digest
        )
        if lacking:
            problems.append(f"ring {ring}: bundle {release.bundle_id} lacks {', '.join(lacking)}")
        else:
            releases[ring] = release
    return releases, problems


def _bundle_problems(bundle_id: str, contents: Mapping[str, bytes]) -> Iterator[str]:
    prefix = bundle_target(bundle_id, "")
    files = {name.removeprefix(prefix): content for name, content in contents.items() if name.startswith(prefix)}
    try:
        named = checked_bundle(files, where=prefix).manifest.bundle_id
    except (RoadgripError, UnicodeDecodeError) as error:
        yield f"bundle {bundle_id}: {error}"
    else:
        if named != bundle_id:
            yield f"bundle {bundle_id}: its manifest calls it {named}"


def _idle_problems(repository: Repository, targets: Targets) -> Iterator[str]:
    """Name what is wrong with files that no unit would ask for: old versions, and what nothing is signed about."""
    for path in repository.surplus_files(targets):
        digest = path.name.split(".", 1)[0]
        if hashlib.sha256(path.read_bytes()).hexdigest() != digest:
            yield f"{path.relative_to(repository.folder)} is not signed for, nor what its name says"
    try:
        roots = repository.roots()
    except RepositoryFolderError as error:
        yield str(error)
        return
    if not repository.trusted_root_path.is_file() or (
        repository.trusted_root_path.read_bytes() != repository.root_path(1).read_bytes()
    ):
        yield f"{repository.trusted_root_path.name} is not the first root"
    for path in sorted(repository.metadata_folder.iterdir()):
        number, _, role = path.name.removesuffix(".json").rpartition(".")
        if path.name.startswith(".") or path.name == "timestamp.json":
            continue
        if role == "root" and number.isdigit() and 1 <= int(number) <= len(roots):
            continue
        if role not in {"targets", "snapshot"} or not number.isdigit():
            yield f"{path.relative_to(repository.folder)} does not belong there"
        elif not _signed_once(path, int(number), role, roots):
            yield f"{path.relative_to(repository.folder)} was not signed by anybody who ever might"


def _signed_once(path: Path, version: int, role: str, roots: list[Metadata[Root]]) -> bool:
    try:
        metadata: Metadata[Any] = Metadata.from_bytes(path.read_bytes())
    except DeserializationError:
        return False
    if (metadata.signed.type, metadata.signed.version) != (role, version):
        return False
    content, signatures = metadata.signed_bytes, metadata.signatures
    return any(root.signed.get_verification_result(role, content, signatures) for root in roots)


def _chunks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            yield chunk


def _words(error: Exception) -> str:
    return str(error) or type(error).__name__

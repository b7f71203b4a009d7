"""Signed repositories for tests: keys in memory, one file in a folder after another, and every way to be wrong.

The layout is the laboratory's: consistent snapshots, targets with their SHA-256 in front of their names.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

from securesystemslib.signer import CryptoSigner
from tuf.api.metadata import Metadata, MetaFile, Root, Snapshot, TargetFile, Targets, Timestamp

from roadgrip.bundle import MANIFEST_NAME, BundleManifest
from roadgrip.bundle_json import manifest_from_json, manifest_to_json
from roadgrip.release import METADATA_FOLDER, TARGETS_FOLDER, Release, bundle_target, release_to_json, ring_target
from tests.bundles import MODEL_NAME, make_manifest

ROLES = ("root", "targets", "snapshot", "timestamp")
LIFETIME = timedelta(days=30)
EXPIRED = datetime(2024, 2, 1, tzinfo=UTC)


def make_small_bundle(folder: Path, *, bias_mu: float = 0.5) -> BundleManifest:
    """Write a bundle whose files hold together, with a model that is only bytes: nothing here is meant to run."""
    manifest, files = _small_bundle(bias_mu)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return manifest


@cache
def _small_bundle(bias_mu: float) -> tuple[BundleManifest, Mapping[str, bytes]]:
    content = b"a model that answers %f" % bias_mu
    manifest = make_manifest(model=content, bias_mu=bias_mu)
    return manifest, {MODEL_NAME: content, MANIFEST_NAME: manifest_to_json(manifest).encode()}


def release_of(
    bundle_id: str, files: Mapping[str, bytes], *, sequence_number: int = 1, ring: str = "canary"
) -> Release:
    return Release(
        ring=ring,
        sequence_number=sequence_number,
        bundle_id=bundle_id,
        files_sha256={name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
        released_unix_s=1_760_000_000,
        released_by="a test",
        reason="to see what comes of it",
        gate="passed",
        ledger_hash=hashlib.sha256(b"%d" % sequence_number).hexdigest(),
    )


class SignedRepository:
    """A repository that is published with every change, one version after another.

    Args:
        folder: Where; made if missing.
        thresholds: How many keys each role has and needs, by role; one where it is not said.
        expires: When the metadata of a role expires, by role; in a month where it is not said.
        with_hashes: Whether timestamp and snapshot say digests of what they name, and not versions alone.
    """

    def __init__(
        self,
        folder: Path,
        *,
        thresholds: Mapping[str, int] | None = None,
        expires: Mapping[str, datetime] | None = None,
        with_hashes: bool = False,
    ) -> None:
        self.folder = folder
        self.expires = dict(expires or {})
        self.targets = Targets(expires=self._expiry("targets"))
        self._with_hashes = with_hashes
        self._keys = {
            role: [CryptoSigner.generate_ed25519() for _ in range((thresholds or {}).get(role, 1))] for role in ROLES
        }
        self._root = Root(expires=self._expiry("root"))
        self._name_keys()
        self._version = 0
        self.trusted_root = self._write_root(self._keys["root"])
        self.publish()

    @property
    def metadata_folder(self) -> Path:
        return self.folder / METADATA_FOLDER

    @property
    def targets_folder(self) -> Path:
        return self.folder / TARGETS_FOLDER

    @property
    def version(self) -> int:
        """Of timestamp, snapshot and targets, which go together here."""
        return self._version

    def add(self, path: str, content: bytes) -> TargetFile:
        """Add a target; it is signed with the next publication."""
        target = TargetFile.from_data(path, content, ["sha256"])
        place = self.targets_folder / target.get_prefixed_paths()[0]
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
        self.targets.targets[path] = target
        return target

    def place_of(self, path: str) -> Path:
        """Return where the file of a target lies."""
        return self.targets_folder / self.targets.targets[path].get_prefixed_paths()[0]

    def release(
        self, bundle_folder: Path, *, sequence_number: int, ring: str = "canary", publish: bool = True
    ) -> Release:
        """Publish a bundle's files and a pointer of a ring to them, and return what the pointer says."""
        files = {path.name: path.read_bytes() for path in bundle_folder.iterdir()}
        bundle_id = manifest_from_json(files[MANIFEST_NAME].decode()).bundle_id
        for name, content in files.items():
            self.add(bundle_target(bundle_id, name), content)
        release = release_of(bundle_id, files, sequence_number=sequence_number, ring=ring)
        self.point(release, publish=publish)
        return release

    def point(self, release: Release, *, at_ring: str = "", publish: bool = True) -> None:
        """Publish a pointer, if wanted at the place of another ring."""
        self.add(ring_target(at_ring or release.ring), release_to_json(release).encode())
        if publish:
            self.publish()

    def rotate(self, *roles: str, publish: bool = True) -> None:
        """Give roles new keys; the new root is signed with the old and the new ones."""
        old = self._keys["root"]
        for role in roles:
            self._keys[role] = [CryptoSigner.generate_ed25519() for _ in self._keys[role]]
        self._root.version += 1
        self._root.expires = self._expiry("root")
        self._root.roles = Root().roles
        self._root.keys = {}
        self._name_keys()
        self._write_root([*old, *(key for key in self._keys["root"] if key not in old)])
        if publish:
            self.publish()

    def publish(self, *, signatures: Mapping[str, int] | None = None) -> None:
        """Sign and write the next version of everything but the root.

        Args:
            signatures: How many of its keys sign for a role, by role; all where it is not said.
        """
        self._version += 1
        self.targets.version = self._version
        self.targets.expires = self._expiry("targets")
        counts = {role: (signatures or {}).get(role, len(self._keys[role])) for role in ROLES}
        content = self._write(self.targets, f"{self._version}.targets.json", counts["targets"])
        self._publish_snapshot(self._named(self._version, content), counts)

    def publish_older_targets(self) -> None:
        """Sign a snapshot and a timestamp as new as any, for the targets of the version before."""
        content = (self.metadata_folder / f"{self._version - 1}.targets.json").read_bytes()
        self._version += 1
        self._publish_snapshot(self._named(self._version - 2, content), {role: len(self._keys[role]) for role in ROLES})

    def _publish_snapshot(self, targets: MetaFile, keys_counts: Mapping[str, int]) -> None:
        snapshot = Snapshot(self._version, expires=self._expiry("snapshot"), meta={"targets.json": targets})
        content = self._write(snapshot, f"{self._version}.snapshot.json", keys_counts["snapshot"])
        named = self._named(self._version, content)
        timestamp = Timestamp(self._version, expires=self._expiry("timestamp"), snapshot_meta=named)
        self._write(timestamp, "timestamp.json", keys_counts["timestamp"])

    def _named(self, version: int, content: bytes) -> MetaFile:
        return MetaFile.from_data(version, content, ["sha256"]) if self._with_hashes else MetaFile(version)

    def _expiry(self, role: str) -> datetime:
        return self.expires.get(role, datetime.now(UTC).replace(microsecond=0) + LIFETIME)

    def _name_keys(self) -> None:
        for role, keys in self._keys.items():
            for key in keys:
                self._root.add_key(key.public_key, role)
            self._root.roles[role].threshold = len(keys)

    def _write_root(self, keys: list[CryptoSigner]) -> bytes:
        metadata = Metadata(self._root)
        for key in keys:
            metadata.sign(key, append=True)
        return self._written(f"{self._root.version}.root.json", metadata.to_bytes())

    def _write(self, signed: Targets | Snapshot | Timestamp, name: str, keys_count: int) -> bytes:
        metadata: Metadata[Any] = Metadata(signed)
        for key in self._keys[signed.type][:keys_count]:
            metadata.sign(key, append=True)
        return self._written(name, metadata.to_bytes())

    def _written(self, name: str, content: bytes) -> bytes:
        self.metadata_folder.mkdir(parents=True, exist_ok=True)
        (self.metadata_folder / name).write_bytes(content)
        return content

"""A laboratory with keys and a repository, bundles whose models nobody runs, and a unit that visits."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from roadgrip.bundle import MANIFEST_NAME
from roadgrip.bundle_json import manifest_to_json
from roadgrip.release import Release
from tests.bundles import MODEL_NAME, make_model, manifest_of
from training.laboratory import Laboratory
from training.promotion.ceremony import DEFAULT_ROLE_KEYS, NewKey, RoleKeys, begin_repository
from training.promotion.keys import SigningKeys
from training.promotion.publication import publish_release
from training.promotion.repository import Repository
from training.promotion.verification import Verification, verify

NOW_UNIX_S = 1_800_000_000.0
DAY_S = 86_400.0
BY = "kari"


def bundle_files(number: int, *, note: str = "") -> dict[str, bytes]:
    """A bundle's files; the number changes the model, the note only what the manifest says of its making."""
    files = {MODEL_NAME: f"model {number}".encode()}
    manifest = manifest_of([make_model(bias_mu=0.01 * number)], files, name=f"linear{note}")
    return {**files, MANIFEST_NAME: manifest_to_json(manifest).encode()}


def bundle_id(number: int) -> str:
    return str(json.loads(bundle_files(number)[MANIFEST_NAME])["bundle_id"])


def bundle_folder(folder: Path, number: int, *, note: str = "") -> Path:
    made = folder / f"bundle-{number}{note}"
    made.mkdir(parents=True, exist_ok=True)
    for name, content in bundle_files(number, note=note).items():
        (made / name).write_bytes(content)
    return made


@dataclass(frozen=True)
class Site:
    """A laboratory in a folder, with each key in a folder of its own, as if all had different holders."""

    folder: Path
    lab: Laboratory
    made: tuple[NewKey, ...]

    @property
    def repository(self) -> Repository:
        return Repository(self.lab.repository_folder)

    @property
    def trusted_root(self) -> bytes:
        return (self.folder / "trusted-root.json").read_bytes()

    def keys(self, *names: str) -> SigningKeys:
        """The keys of some holders, such as root-1; those of all without a name."""
        holders = names or tuple(sorted(path.name for path in (self.folder / "keys").iterdir()))
        return SigningKeys(tuple(self.folder / "keys" / name for name in holders))

    def key_id(self, name: str) -> str:
        return next(key.key_id for key in self.made if key.path.stem == name)

    def release(self, number: int, ring: str = "canary", *, keys: SigningKeys | None = None, **said) -> Release:
        return publish_release(
            self.lab,
            keys or self.keys(),
            bundle_folder=bundle_folder(self.folder, number),
            ring=ring,
            gate=said.get("gate", "passed"),
            verdict_digest=said.get("verdict_digest"),
            reason=said.get("reason", "better in the wet"),
            by=BY,
            now_unix_s=said.get("now_unix_s", NOW_UNIX_S),
        )

    def seen_by_units(self, *, now_unix_s: float = NOW_UNIX_S) -> Verification:
        return verify(self.repository, self.trusted_root, now_unix_s=now_unix_s)

    def snapshot_of_folder(self) -> dict[str, bytes]:
        """Every file that units can read."""
        folder = self.lab.repository_folder
        paths = [*folder.glob("metadata/*"), *folder.glob("targets/**/*")]
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths if path.is_file()}

    def metadata(self) -> dict[str, bytes]:
        """Everything that is signed."""
        return {name: content for name, content in self.snapshot_of_folder().items() if name.startswith("metadata/")}


def make_site(folder: Path, *, now_unix_s: float = NOW_UNIX_S, **role_keys: RoleKeys) -> Site:
    lab = Laboratory(folder / "lab")
    made = begin_repository(
        lab,
        folder / "all-keys",
        role_keys={**DEFAULT_ROLE_KEYS, **role_keys},
        by=BY,
        now_unix_s=now_unix_s,
    )
    (folder / "trusted-root.json").write_bytes((lab.repository_folder / "trusted-root.json").read_bytes())
    for key in made:
        holder = folder / "keys" / key.path.stem
        holder.mkdir(parents=True)
        key.path.rename(holder / key.path.name)
    return Site(folder, lab, made)

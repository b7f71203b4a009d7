"""The register of models of a laboratory: which bundles there are, where each came from, and what they are called.

Its versions are bundles. Names point to them: `challenger` is the newest that was trained, `canary` and `champion` are
those that the gate and people let out to the units. The records are mlflow's: by default in the laboratory's folder,
else wherever `--tracking` or MLFLOW_TRACKING_URI says.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit, urlunsplit

from roadgrip.bundle import MANIFEST_NAME, BundleManifest, check_files
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError, RoadgripError
from training.laboratory import Laboratory
from training.tracking import ModelRegister, RegisteredVersion, local_address

MODEL_NAME = "roadgrip-global"
ADDRESS_VARIABLE = "MLFLOW_TRACKING_URI"
CHALLENGER, CANARY, CHAMPION = "challenger", "canary", "champion"
BUNDLE_FOLDER_NAME, TREES_FOLDER_NAME, ATTACHED_FOLDER_NAME = "bundle", "trees", "verdicts"
"""Of the files of a run: the bundle, the trees it was exported from, and what was said of it later."""
BUNDLE_WORD = "bundle_id"
"""Under this name a version says which bundle it is."""
_BUNDLE_ID = re.compile(r"[0-9a-f]{16}")


class RegisterError(RoadgripError):
    """A model that the register does not have, or not as it should be; the message says which."""


@dataclass(frozen=True, slots=True)
class RegisteredBundle:
    """A bundle of the register, with its files on this machine.

    Attributes:
        version: Its number in the register.
        bundle_id: See `roadgrip.bundle.bundle_id_of`.
        run_id: The run of mlflow that made it.
        folder: The bundle.
        trees_folder: What it was exported from (`training.retraining.tree_files`); None if that was not kept.
        aliases: What it is called, in order.
    """

    version: int
    bundle_id: str
    run_id: str
    folder: Path
    trees_folder: Path | None
    aliases: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RegisteredModel:
    """A bundle of the register, as far as the register itself tells.

    Attributes:
        version: Its number.
        bundle_id: Of the bundle.
        run_id: The run of mlflow that made it.
        made_unix_s: When it was registered.
        aliases: What it is called, in order.
        words: What was said of it, such as the gate's verdict.
    """

    version: int
    bundle_id: str
    run_id: str
    made_unix_s: float
    aliases: tuple[str, ...]
    words: Mapping[str, str]


def address_of(lab: Laboratory, address: str | None = None) -> str:
    """Return where the records are: as told, else as MLFLOW_TRACKING_URI says, else in the laboratory's folder."""
    return address or os.environ.get(ADDRESS_VARIABLE) or local_address(lab.folder)


def shown_address(address: str) -> str:
    """Return an address without the password it may hold."""
    parts = urlsplit(address)
    if "@" not in parts.netloc:
        return address
    return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))


def models(lab: Laboratory, *, address: str | None = None) -> list[RegisteredModel]:
    """Return what the register holds, the newest first."""
    return _models(ModelRegister(address=address_of(lab, address)))


def registered(lab: Laboratory, ref: str, *, address: str | None = None) -> RegisteredBundle:
    """Return a bundle of the register; its files are fetched once, and held against its manifest every time.

    Args:
        lab: Whose register, and where the files go.
        ref: An alias, the number of a version, or the id of a bundle, whose newest version is meant.
        address: Of the records, if not the laboratory's.

    Raises:
        RegisterError: There is no such model, or what the register keeps of it is not what it registered.
    """
    register = ModelRegister(address=address_of(lab, address))
    found = _chosen(_models(register), ref)
    place = lab.bundles_folder / found.bundle_id
    if not _is_whole(place / BUNDLE_FOLDER_NAME, found):
        _fetch(register, found, place)
    trees = place / TREES_FOLDER_NAME
    return RegisteredBundle(
        version=found.version,
        bundle_id=found.bundle_id,
        run_id=found.run_id,
        folder=place / BUNDLE_FOLDER_NAME,
        trees_folder=trees if trees.is_dir() else None,
        aliases=found.aliases,
    )


def aliases(lab: Laboratory, *, address: str | None = None) -> dict[str, int]:
    """Return which version each alias points to."""
    return ModelRegister(address=address_of(lab, address)).aliases(MODEL_NAME)


def set_alias(lab: Laboratory, alias: str, version: int, *, address: str | None = None) -> None:
    """Let an alias point to a version.

    Raises:
        RegisterError: There is no such version.
    """
    register = ModelRegister(address=address_of(lab, address))
    _chosen(_models(register), str(version))
    register.set_alias(MODEL_NAME, alias, version)


def attach(
    lab: Laboratory,
    version: int,
    files: Sequence[Path],
    words: Mapping[str, str],
    *,
    address: str | None = None,
) -> None:
    """Keep files with the run that made a version, such as the gate's verdict, and say something of both.

    Args:
        lab: Whose register.
        version: Of which model.
        files: To be kept in `ATTACHED_FOLDER_NAME`; one of the same name is replaced.
        words: To be said, by name.
        address: Of the records, if not the laboratory's.

    Raises:
        RegisterError: There is no such version.
    """
    register = ModelRegister(address=address_of(lab, address))
    found = _chosen(_models(register), str(version))
    run = register.run(found.run_id)
    for path in files:
        run.file(path, folder=ATTACHED_FOLDER_NAME)
    for name, value in words.items():
        run.word(name, value)
    register.say(MODEL_NAME, version, words)


def _models(register: ModelRegister) -> list[RegisteredModel]:
    named: dict[int, list[str]] = {}
    for alias, version in register.aliases(MODEL_NAME).items():
        named.setdefault(version, []).append(alias)
    return [_model(version, tuple(sorted(named.get(version.version, [])))) for version in register.versions(MODEL_NAME)]


def _model(version: RegisteredVersion, names: tuple[str, ...]) -> RegisteredModel:
    words = dict(version.words)
    return RegisteredModel(
        version=version.version,
        bundle_id=words.pop(BUNDLE_WORD, ""),
        run_id=version.run_id,
        made_unix_s=version.made_unix_s,
        aliases=names,
        words=words,
    )


def _chosen(held: Sequence[RegisteredModel], ref: str) -> RegisteredModel:
    """Return the model that is meant; the newest of several with one bundle."""
    for model in held:
        meant = ref == model.bundle_id if _BUNDLE_ID.fullmatch(ref) else ref in {str(model.version), *model.aliases}
        if meant:
            return model
    known = "; ".join(f"version {model.version} ({', '.join((model.bundle_id, *model.aliases))})" for model in held)
    raise RegisterError(f"no model {ref!r:.80} in the register; it holds {known or 'none'}")


def _fetch(register: ModelRegister, found: RegisteredModel, place: Path) -> None:
    """Put the files of a model in their place, whole or not at all."""
    place.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{found.bundle_id}.", dir=place.parent))
    try:
        if not register.fetch(found.run_id, BUNDLE_FOLDER_NAME, partial):
            raise RegisterError(f"version {found.version}: its run {found.run_id} keeps no bundle")
        register.fetch(found.run_id, TREES_FOLDER_NAME, partial)
        _check(partial / BUNDLE_FOLDER_NAME, found)
        shutil.rmtree(place, ignore_errors=True)
        partial.chmod(0o755)
        partial.rename(place)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _is_whole(folder: Path, found: RegisteredModel) -> bool:
    if not folder.is_dir():
        return False
    try:
        _check(folder, found)
    except RegisterError:
        return False
    return True


def _check(folder: Path, found: RegisteredModel) -> BundleManifest:
    """Return the manifest of a folder that holds the bundle of a model, byte for byte.

    Raises:
        RegisterError: It does not.
    """
    try:
        contents = {path.name: path.read_bytes() for path in folder.iterdir()}
        manifest = manifest_from_json(contents.pop(MANIFEST_NAME, b"").decode())
        check_files(manifest, contents)
        if manifest.bundle_id != found.bundle_id:
            raise BundleError(f"it is bundle {manifest.bundle_id}, registered as {found.bundle_id or 'no bundle'}")
    except (RoadgripError, OSError, UnicodeDecodeError) as error:
        raise RegisterError(f"version {found.version} of the register is not what was registered: {error}") from error
    return manifest

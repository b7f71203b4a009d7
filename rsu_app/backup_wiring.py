"""The part of the composition root that knows what a unit is made of: put into a backup, and taken out of one again.

A backup holds the passages and the ledger, the shelf of bundles with what it is for, and, to be read by a person, the
settings and maps. It holds no keys: a stick that is lost must not let somebody speak as the unit.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version as distribution_version
from pathlib import Path

from roadgrip.errors import StoreError
from rsu_app.backup_archive import (
    DATABASE_NAME,
    SETTINGS_NAME,
    SHELF_NAME,
    BackupError,
    BackupManifest,
    digest_of,
    read_manifest,
    unpack,
    write_archive,
)
from rsu_app.control_client import ControlError, ask
from rsu_app.rollout_wiring import SOCKET_NAME, shelf_folder, socket_path
from rsu_app.settings import Settings, is_packaged_name

LOOKS_COUNT = 3
"""How often the shelf is looked at before a backup gives up: a rollout takes a step once in hours."""
SHELF_STATE_NAME = "state.json"
UNSHELVED = shutil.ignore_patterns(SOCKET_NAME, "incoming", "discarded", "*.tmp", "*.damaged")
"""What lies on a shelf and is worth nothing elsewhere."""
ANSWER_S = 5.0
"""A unit that is silent for so long runs all the same."""
ROOM_RATIO = 1.1
"""Room that a restored unit needs, against what the backup holds: the log of a migration comes on top."""

Progress = Callable[[str, int, int], None]
"""Is told what is being done, how many bytes of it are done, and of how many."""


@dataclass(frozen=True, slots=True)
class Restored:
    """What came of a restore.

    Attributes:
        manifest: What the backup says of itself.
        revision: Of the database now.
        set_aside: Where lies what was there before.
    """

    manifest: BackupManifest
    revision: str
    set_aside: tuple[Path, ...]


def make_backup(
    settings: Settings,
    path: Path,
    *,
    config_file: Path | None,
    now_unix_s: float,
    on_progress: Progress = lambda _doing, _done, _of: None,
) -> BackupManifest:
    """Return what a new backup says of itself; it is on the disk, whole, or not there. The unit may run meanwhile.

    Args:
        settings: Say where everything is.
        path: Of the backup; nothing may be there.
        config_file: The file of settings, if there is one.
        now_unix_s: The wall clock.
        on_progress: Is told how far it is.

    Raises:
        BackupError: It cannot be made.
        StoreError: There is no database, or it is damaged.
    """
    if path.exists():
        raise BackupError(f"{path} is there already; a backup replaces nothing")
    try:
        # Beside the backup: the unit's own disk may have no room for a second database.
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as work:
            folder = Path(work)
            _gather(settings, folder, config_file=config_file, on_progress=on_progress)
            manifest = _manifest_of(settings, folder, now_unix_s=now_unix_s)
            packed = folder / "packed"
            with packed.open("xb") as file:
                packed.chmod(0o600)
                write_archive(
                    file, manifest, folder, on_packed=lambda done: on_progress("packing", done, manifest.size_bytes)
                )
                file.flush()
                os.fsync(file.fileno())
            if path.exists():
                raise BackupError(f"{path} came to be meanwhile; a backup replaces nothing")
            packed.rename(path)
    except OSError as error:
        raise BackupError(f"cannot write {path}: {error.strerror or error}") from error
    return manifest


def _gather(settings: Settings, folder: Path, *, config_file: Path | None, on_progress: Progress) -> None:
    """Copy everything into a folder: database and shelf as they were between the same two steps of a rollout."""
    from rsu_app.adapters.store import copy_database

    shelf, copied_shelf, copied = shelf_folder(settings), folder / SHELF_NAME, folder / DATABASE_NAME
    for _ in range(LOOKS_COUNT):
        shutil.rmtree(copied_shelf, ignore_errors=True)
        copied.unlink(missing_ok=True)
        state = _state_of(shelf)
        with suppress(FileNotFoundError, shutil.Error):  # a folder that went meanwhile; the state tells
            if shelf.is_dir():
                shutil.copytree(shelf, copied_shelf, ignore=UNSHELVED)
            copy_database(
                settings.database.path,
                copied,
                on_copied=lambda done, of: on_progress("copying the database", done, of),
            )
            if _state_of(copied_shelf) == state == _state_of(shelf):
                break
    else:
        raise BackupError(f"{shelf} changed while it was copied; try again")
    on_progress("examining the copy", 0, 0)
    _refuse_damage(copied, meaning=f"{settings.database.path} is damaged, a backup of it would be worth nothing")
    if config_file is not None:
        maps = folder / SETTINGS_NAME / "sections"
        maps.mkdir(parents=True)
        shutil.copyfile(config_file, folder / SETTINGS_NAME / "rsu.toml")
        for number, section in enumerate(settings.sections, start=1):
            if not is_packaged_name(section.file):
                shutil.copyfile(section.file, maps / f"{number}.json")


def _state_of(shelf: Path) -> bytes:
    try:
        return (shelf / SHELF_STATE_NAME).read_bytes()
    except FileNotFoundError:
        return b""


def _manifest_of(settings: Settings, folder: Path, *, now_unix_s: float) -> BackupManifest:
    from rsu_app.adapters.store import check

    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return BackupManifest(
        made_unix_s=now_unix_s,
        software=distribution_version("roadgrip"),
        revision=str(check(folder / DATABASE_NAME).current),
        unit=settings.export.unit_name.strip(),
        files=tuple(digest_of(folder, name) for name in names),
    )


def restore_backup(
    settings: Settings,
    path: Path,
    *,
    actor: str,
    although_running: bool,
    now_unix_s: float,
    on_progress: Progress = lambda _doing, _done, _of: None,
) -> Restored:
    """Return what came of putting a backup in the place of what the unit has.

    All of it is unpacked, held against its digests, examined and migrated before anything of the unit is touched; then
    what was there is renamed. Settings and keys stay as they are.

    Args:
        settings: Say where everything goes.
        path: The backup.
        actor: Who wants it, for the ledger.
        although_running: Do it beside a running unit, which goes on with what was set aside until it is started anew.
        now_unix_s: The wall clock.
        on_progress: Is told how far it is.

    Raises:
        BackupError: It must not be restored, or a unit runs.
        StoreError: Its database is damaged, or newer than this software.
    """
    from rsu_app.adapters.store import check, note_restored, upgrade

    if not although_running:
        _refuse_beside_a_unit(settings)
    database, shelf = settings.database.path, shelf_folder(settings)
    try:
        database.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=database.parent, prefix=".restore-") as work:
            folder = Path(work)
            manifest = _unpacked(path, folder, on_progress=on_progress)
            staged = folder / DATABASE_NAME
            on_progress("migrating", 0, 0)
            if not check(staged).up_to_date:
                upgrade(staged)
            revision = str(check(staged).current)
            note_restored(
                staged,
                at_unix_s=now_unix_s,
                actor=actor,
                made_unix_s=manifest.made_unix_s,
                software=manifest.software,
            )
            staged_shelf = folder / SHELF_NAME
            if staged_shelf.is_dir():
                shelf.parent.mkdir(parents=True, exist_ok=True)
            _hand_over(folder, like=database.parent)
            os.sync()  # everything is on the disk before the first name changes
            aside = _put_in_place(((staged_shelf, shelf), (staged, database)), now_unix_s=now_unix_s)
            os.sync()
    except OSError as error:
        raise BackupError(f"cannot restore {path}: {error}") from error
    return Restored(manifest=manifest, revision=revision, set_aside=aside)


def _unpacked(path: Path, folder: Path, *, on_progress: Progress) -> BackupManifest:
    wanted_bytes, free_bytes = int(ROOM_RATIO * read_manifest(path).size_bytes), shutil.disk_usage(folder).free
    if wanted_bytes > free_bytes:
        raise BackupError(f"{path} needs {wanted_bytes} bytes at {folder.parent}, where {free_bytes} are free")
    total_bytes = max(wanted_bytes, 1)
    manifest = unpack(path, folder, on_unpacked=lambda done: on_progress("unpacking", done, total_bytes))
    on_progress("examining the database", 0, 0)
    _refuse_damage(folder / DATABASE_NAME, meaning=f"the database in {path} is damaged")
    return manifest


def _refuse_damage(database: Path, *, meaning: str) -> None:
    from rsu_app.adapters.store import integrity_problems

    try:
        problems = integrity_problems(database)
    except StoreError as error:  # so damaged that it cannot even be examined
        problems = [str(error.__cause__)]
    if problems:
        raise StoreError(f"{meaning}: {' '.join(problems[0].split())}")


def _refuse_beside_a_unit(settings: Settings) -> None:
    from rsu_app.adapters.store import in_use

    try:
        answers = ask(socket_path(settings), "/status", timeout_s=ANSWER_S) is not None
    except ControlError:
        answers = True  # something is there that is no good listener
    if answers or in_use(settings.database.path):
        raise BackupError(f"a unit uses {settings.database.path}; stop it first: systemctl stop roadgrip-rsu")


def _hand_over(folder: Path, *, like: Path) -> None:
    """Give everything in a folder to the owner of another; only root can, and only root has to."""
    if os.geteuid() != 0:
        return
    owner = like.stat()
    for path in folder.rglob("*"):
        os.chown(path, owner.st_uid, owner.st_gid, follow_symlinks=False)


def _put_in_place(moves: tuple[tuple[Path, Path], ...], *, now_unix_s: float) -> tuple[Path, ...]:
    """Return where lies what was in the way; if a move fails all is as it was before.

    Args:
        moves: From where, which may be missing, and to where.
        now_unix_s: The wall clock, for names.
    """
    from rsu_app.adapters.store import set_aside

    undo: list[tuple[Path, Path]] = []
    aside: list[Path] = []
    try:
        for source, target in moves:
            if target.exists():
                aside.append(set_aside(target, label="before-restore", now_unix_s=now_unix_s))
                undo.append((aside[-1], target))
            if source.exists():
                shutil.move(source, target)
                undo.append((target, source))
    except (OSError, StoreError):
        for now, before in reversed(undo):
            with suppress(OSError):
                shutil.move(now, before)
        raise
    return tuple(aside)

"""Bundles on disk, and the small file that says which is for what.

shelf/
  state.json                  what the shelf is for; written whole or not at all
  state.json.damaged          the last one that could not be read, for whoever wants to look
  bundles/<id>-<digest>/      whole bundles; eight characters of the manifest's SHA-256 tell two of one id apart
  incoming/                   files on their way; worth nothing
  discarded/                  on its way out; worth nothing

A file is on the disk before the name that makes it count is, and a name is on the disk before the caller goes on. So a
power cut at any step leaves what was there before or what comes after, and perhaps litter that `clear` removes.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from roadgrip.bundle import MANIFEST_NAME, check_files
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError, FeatureTableError, StoreError, StoreFullError
from roadgrip.release import Release
from rsu_app.adapters.updates.state_file import StateFileError, state_from_json, state_to_json
from rsu_app.domain.rollout import RolloutState, ShelvedBundle

STATE_LIMIT_BYTES = 64 * 1024
"""A larger state file is not ours."""
FILE_LIMIT_BYTES = 256 * 1024 * 1024
"""A larger file is no part of a bundle; reading it could take the unit's memory."""
NO_ROOM_ERRNOS = frozenset({errno.ENOSPC, errno.EDQUOT})


class FolderShelf:
    """A shelf in a folder; see `rsu_app.rollout_ports.BundleShelf` for what it promises.

    One process at a time may write to it.

    Args:
        folder: Made when something is first put there.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._state_path = folder / "state.json"
        self._written_path = folder / "state.json.tmp"
        self._bundles_folder = folder / "bundles"
        self._discarded_folder = folder / "discarded"
        self._notes: tuple[str, ...] = ()

    @property
    def incoming_folder(self) -> Path:
        """A place on the shelf's own file system for files on their way."""
        return self._folder / "incoming"

    @property
    def notes(self) -> tuple[str, ...]:
        """What the last look at the state found wrong, for the log and the operator; nothing if all was well."""
        return self._notes

    def state(self) -> RolloutState:
        """Return what the shelf is for; the factory's bundle alone if there is no shelf yet or its file is damaged.

        A damaged file is moved aside, and `notes` tells of it.
        """
        self._notes = ()
        try:
            with self._state_path.open("rb") as file:
                # What is longer is not ours, and no JSON when it is cut.
                return state_from_json(file.read(STATE_LIMIT_BYTES).decode())
        except FileNotFoundError:
            return RolloutState()
        except (StateFileError, UnicodeDecodeError, IsADirectoryError) as error:
            self._notes = (f"{self._state_path} is damaged ({error}); {self._moved_aside()}",)
        except OSError as error:
            # Perhaps only the rights are wrong, and tomorrow it reads well again: it stays where it is.
            self._notes = (f"{self._state_path} cannot be read ({error.strerror}); the factory's bundle runs",)
        return RolloutState()

    def _moved_aside(self) -> str:
        aside = self._state_path.with_name("state.json.damaged")
        try:
            _remove(aside)
            self._state_path.rename(aside)
        except OSError as error:
            return f"it could not be moved aside ({error.strerror}); the factory's bundle runs"
        return f"it was moved to {aside.name}; the factory's bundle runs"

    def keep_state(self, state: RolloutState) -> None:
        """Return once the state is on the disk, whole; the old one stays if that fails.

        Raises:
            StoreError: It cannot be written.
        """
        with _disk_errors(f"writing {self._state_path}"):
            make_folder(self._folder)
            with self._written_path.open("wb") as file:
                file.write(state_to_json(state).encode())
                file.flush()
                os.fsync(file.fileno())
            self._written_path.replace(self._state_path)
            _sync(self._folder)

    def put(self, release: Release, folder: Path) -> ShelvedBundle:
        """Move a fetched bundle onto the shelf and return it; on the disk when this returns. Changes no state.

        One that is there already and whole stays; one that is there and damaged is replaced.

        Args:
            release: What brought it.
            folder: Its files, on the shelf's own file system; gone afterwards.

        Raises:
            StoreError: There is no room, or it cannot be written.
            BundleError: Its files are not the release's.
        """
        bundle = ShelvedBundle(
            bundle_id=release.bundle_id,
            manifest_sha256=release.files_sha256.get(MANIFEST_NAME, ""),
            sequence_number=release.sequence_number,
            ledger_hash=release.ledger_hash,
            gate=release.gate,
        )
        _check_release(release, _files_of(folder))
        _check_bundle(bundle, folder)
        place = self._place_of(bundle)
        with _disk_errors(f"putting bundle {bundle.bundle_id} on the shelf"):
            if self._is_whole(bundle):
                # It may have been written by a process that was killed before it had made sure of the disk.
                _sync_bundle(place)
                shutil.rmtree(folder)
            else:
                make_folder(self._bundles_folder)
                _sync_bundle(folder)
                self._discard(place)
                folder.rename(place)
            _sync(self._bundles_folder)
        return bundle

    def folder_of(self, bundle: ShelvedBundle) -> Path:
        """Return where a bundle lies, after its files were held against its manifest and that against its digest.

        Raises:
            BundleError: It is not there, or not what was put there.
        """
        if bundle.from_factory:
            raise BundleError("the factory's bundle is not on the shelf")
        place = self._place_of(bundle)
        _check_bundle(bundle, place)
        return place

    def clear(self, state: RolloutState) -> None:
        """Remove what a state does not need, interrupted work among it. Never raises for the disk's sake."""
        held = (state.live, state.previous, state.candidate)
        needed = {self._place_of(each) for each in held if each is not None}
        with suppress(OSError):
            for path in sorted(self._bundles_folder.iterdir()):
                if path not in needed:
                    with suppress(OSError):
                        _remove(path)
        for path in (self.incoming_folder, self._discarded_folder, self._written_path):
            with suppress(OSError):
                _remove(path)

    def _place_of(self, bundle: ShelvedBundle) -> Path:
        return self._bundles_folder / f"{bundle.bundle_id}-{bundle.manifest_sha256[:8]}"

    def _is_whole(self, bundle: ShelvedBundle) -> bool:
        try:
            self.folder_of(bundle)
        except BundleError:
            return False
        return True

    def _discard(self, place: Path) -> None:
        """Make room for a folder: what has its name is moved away first, since removing it takes many steps."""
        if os.path.lexists(place):
            _remove(self._discarded_folder)
            place.rename(self._discarded_folder)
            _remove(self._discarded_folder)


def make_folder(folder: Path) -> None:
    """Make a folder and those above it that are missing, each on the disk before the next."""
    if not folder.is_dir():
        make_folder(folder.parent)
        folder.mkdir(exist_ok=True)
        _sync(folder.parent)


def _check_release(release: Release, files: Mapping[str, bytes]) -> None:
    subject = f"bundle {release.bundle_id} of release {release.sequence_number}"
    if set(files) != set(release.files_sha256):
        raise BundleError(f"{subject} holds {sorted(files)}, its release names {sorted(release.files_sha256)}")
    for name, content in files.items():
        if hashlib.sha256(content).hexdigest() != release.files_sha256[name]:
            raise BundleError(f"{subject}: {name} differs from its digest in the release")


def _check_bundle(bundle: ShelvedBundle, folder: Path) -> None:
    """Do nothing if a folder holds exactly a bundle.

    Raises:
        BundleError: It does not; the message says what differs.
    """
    files = _files_of(folder)
    text = files.pop(MANIFEST_NAME, b"")
    if hashlib.sha256(text).hexdigest() != bundle.manifest_sha256:
        raise BundleError(f"{folder}: {MANIFEST_NAME} is not the one that was signed for bundle {bundle.bundle_id}")
    try:
        manifest = manifest_from_json(text.decode())
        check_files(manifest, files)
    except (BundleError, FeatureTableError, UnicodeDecodeError) as error:
        raise BundleError(f"{folder}: {error}") from error
    if manifest.bundle_id != bundle.bundle_id:
        raise BundleError(f"{folder} holds bundle {manifest.bundle_id}, not {bundle.bundle_id}")


def _files_of(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder by name.

    Raises:
        BundleError: It holds something else, or cannot be read.
    """
    try:
        paths = sorted(folder.iterdir())
        strange = [path for path in paths if not path.is_file() or path.stat().st_size > FILE_LIMIT_BYTES]
        if strange:
            raise BundleError(f"{strange[0]} is no file that belongs into a bundle")
        return {path.name: path.read_bytes() for path in paths}
    except OSError as error:
        raise BundleError(f"cannot read {folder} as a bundle: {error.strerror or error}") from error


def _sync_bundle(folder: Path) -> None:
    for path in folder.iterdir():
        _sync(path)
    _sync(folder)


def _sync(path: Path) -> None:
    """Return once a file's content, or a folder's names, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove(path: Path) -> None:
    """Remove whatever has this name; nothing is fine, too."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def _disk_errors(doing: str) -> Iterator[None]:
    """Turn what a disk cannot do into the words of the error tree."""
    try:
        yield
    except OSError as error:
        if error.errno in NO_ROOM_ERRNOS:
            raise StoreFullError(f"{doing}: the disk is full") from error
        raise StoreError(f"{doing}: {error}") from error

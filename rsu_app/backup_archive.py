"""The file that a backup is: a packed tar archive whose first member names all others with size and digest.

The digests find what a worn stick or a broken line did to it. They keep nobody from making a backup of his own: whoever
can restore one could as well replace the unit.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import re
import tarfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from roadgrip.errors import RoadgripError

FORMAT = "roadgrip-backup-1"
MANIFEST_NAME = "manifest.json"
DATABASE_NAME = "database.sqlite3"
SHELF_NAME = "shelf"
SETTINGS_NAME = "settings"
MANIFEST_LIMIT_BYTES = 1024 * 1024
FILES_LIMIT_COUNT = 2_000
"""A shelf holds three bundles of a few files each, and what is known of a repository."""
PIECE_BYTES = 1024 * 1024
# Ours alone, and none that leads elsewhere: no part begins with a dot.
_PART = r"(/[A-Za-z0-9_][\w.@+-]{0,120})"
_NAME = re.compile(rf"{re.escape(DATABASE_NAME)}|({SHELF_NAME}|{SETTINGS_NAME}){_PART}{{1,6}}", re.ASCII)


class BackupError(RoadgripError):
    """A backup that cannot be made, or must not be restored; the message says why."""


@dataclass(frozen=True, slots=True)
class BackupFile:
    """One file in a backup.

    Attributes:
        name: Its path inside.
        size_bytes: How long it is.
        sha256: The digest of its content.
    """

    name: str
    size_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class BackupManifest:
    """What a backup says of itself.

    Attributes:
        made_unix_s: When it was made, by the unit's wall clock.
        software: Version of the software that made it.
        revision: Of the database's schema.
        unit: The unit's name, if it has one.
        files: What is inside, in the order of the archive.
    """

    made_unix_s: float
    software: str
    revision: str
    unit: str
    files: tuple[BackupFile, ...]

    @property
    def size_bytes(self) -> int:
        """What all files take unpacked."""
        return sum(file.size_bytes for file in self.files)


def digest_of(folder: Path, name: str) -> BackupFile:
    """Return a file as a manifest names it.

    Raises:
        BackupError: Its name cannot be in a backup.
        OSError: It cannot be read.
    """
    if not _NAME.fullmatch(name):
        raise BackupError(f"{name!r} cannot be part of a backup: only letters, digits and ._@+- in names")
    with (folder / name).open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        return BackupFile(name=name, size_bytes=file.tell(), sha256=digest)


def write_archive(
    file: IO[bytes], manifest: BackupManifest, folder: Path, *, on_packed: Callable[[int], None] = lambda _: None
) -> None:
    """Return once an archive is written.

    Args:
        file: Where to.
        manifest: Names what goes in.
        folder: Where that lies.
        on_packed: Is told how many bytes of the files were packed so far.

    Raises:
        OSError: Something cannot be read or written.
    """
    packed_bytes = 0
    with (
        gzip.GzipFile(filename="", mode="wb", fileobj=file, mtime=0, compresslevel=6) as packed,
        tarfile.open(fileobj=packed, mode="w|", format=tarfile.PAX_FORMAT) as archive,
    ):
        text = json.dumps({"format": FORMAT, **asdict(manifest)}, indent=1).encode()
        archive.addfile(_member(MANIFEST_NAME, len(text), manifest), io.BytesIO(text))
        for each in manifest.files:
            with (folder / each.name).open("rb") as content:
                archive.addfile(_member(each.name, each.size_bytes, manifest), content)
            packed_bytes += each.size_bytes
            on_packed(packed_bytes)


def _member(name: str, size_bytes: int, manifest: BackupManifest) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.size, member.mode, member.mtime = size_bytes, 0o600, int(manifest.made_unix_s)
    return member


def read_manifest(path: Path) -> BackupManifest:
    """Return what a backup says of itself.

    Raises:
        BackupError: It is none, or damaged.
    """
    with _archive(path) as archive:
        return _manifest(path, archive)


def unpack(path: Path, folder: Path, *, on_unpacked: Callable[[int], None] = lambda _: None) -> BackupManifest:
    """Return what a backup says of itself after all of it was unpacked and held against that.

    Args:
        path: The backup.
        folder: An empty folder; worthless if this raises.
        on_unpacked: Is told how many bytes were unpacked so far.

    Raises:
        BackupError: It is no backup, or damaged, or holds something that it does not name.
        OSError: It cannot be unpacked there.
    """
    unpacked_bytes = 0
    with _archive(path) as archive:
        manifest = _manifest(path, archive)
        for each in manifest.files:
            member = archive.next()
            if member is None or member.name != each.name or not member.isreg() or member.size != each.size_bytes:
                raise BackupError(f"{path} is damaged: {each.name} is not where it should be")
            content = archive.extractfile(member)
            target = folder / each.name
            target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            digest = hashlib.sha256()
            with target.open("xb") as file:
                target.chmod(0o600)
                while content is not None and (piece := content.read(PIECE_BYTES)):
                    digest.update(piece)
                    file.write(piece)
                    unpacked_bytes += len(piece)
                    on_unpacked(unpacked_bytes)
            if digest.hexdigest() != each.sha256:
                raise BackupError(f"{path} is damaged: {each.name} differs from its digest")
        if archive.next() is not None:
            raise BackupError(f"{path} holds more than it names")
    return manifest


@contextmanager
def _archive(path: Path) -> Iterator[tarfile.TarFile]:
    """Give an archive that is read once, from its beginning to its end."""
    try:
        with path.open("rb") as file, tarfile.open(fileobj=file, mode="r|gz") as archive:
            yield archive
    except (FileNotFoundError, IsADirectoryError, PermissionError) as error:
        if error.filename not in {path, str(path)}:
            raise
        raise BackupError(f"cannot read {path}: {error.strerror}") from error
    except (tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise BackupError(f"{path} is no backup, or damaged: {error}") from error


def _manifest(path: Path, archive: tarfile.TarFile) -> BackupManifest:
    member = archive.next()
    if member is None or member.name != MANIFEST_NAME or not member.isreg() or member.size > MANIFEST_LIMIT_BYTES:
        raise BackupError(f"{path} is no backup of a road side unit: it does not begin with {MANIFEST_NAME}")
    content = archive.extractfile(member)
    try:
        told = json.loads(content.read() if content is not None else b"")
        if told.pop("format") != FORMAT:
            raise BackupError(f"{path} is of a kind that this software does not know; it knows {FORMAT}")
        manifest = _manifest_of(told)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise BackupError(f"{path}: its {MANIFEST_NAME} cannot be: {error}") from error
    names = [file.name for file in manifest.files]
    if DATABASE_NAME not in names or len(set(names)) != len(names) or len(names) > FILES_LIMIT_COUNT:
        raise BackupError(f"{path}: its {MANIFEST_NAME} names no database, or a file twice, or too many")
    return manifest


def _manifest_of(told: dict[str, Any]) -> BackupManifest:
    files = tuple(BackupFile(str(each["name"]), int(each["size_bytes"]), str(each["sha256"])) for each in told["files"])
    for file in files:
        if not _NAME.fullmatch(file.name) or file.size_bytes < 0:
            raise ValueError(f"{file.name[:80]!r} is no name of a file in a backup")
    return BackupManifest(
        made_unix_s=float(told["made_unix_s"]),
        software=str(told["software"]),
        revision=str(told["revision"]),
        unit=str(told["unit"]),
        files=files,
    )

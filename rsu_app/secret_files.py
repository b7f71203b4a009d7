"""Files that strangers on the machine must not see or change, and files that may be replaced while the unit runs."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from roadgrip.errors import ConfigurationError

_FORBIDDEN_MODE = stat.S_IWGRP | stat.S_IRWXO


def read_secret(path: Path, *, setting: str) -> bytes:
    """Return what a file holds that nobody but its owner may write, and nobody but owner and group may read.

    Args:
        path: Of the file.
        setting: Which names it, for the message.

    Raises:
        ConfigurationError: It cannot be read, or others may read or write it.
    """
    content, mode = _read(path, setting=setting)
    if mode & _FORBIDDEN_MODE:
        raise ConfigurationError(
            f"{setting}: others may read or write {path} (mode {stat.S_IMODE(mode):04o}); chmod 640 {path}"
        )
    return content


def read_public(path: Path, *, setting: str) -> bytes:
    """Return what a file holds.

    Raises:
        ConfigurationError: It cannot be read; the message names the setting.
    """
    return _read(path, setting=setting)[0]


def _read(path: Path, *, setting: str) -> tuple[bytes, int]:
    try:
        with path.open("rb") as file:  # asked of the open file, so that it cannot be exchanged in between
            return file.read(), os.fstat(file.fileno()).st_mode
    except OSError as error:
        raise ConfigurationError(f"{setting}: cannot read {path}: {error.strerror}") from error


class FileWatch:
    """Says whether files were replaced since the last look.

    Args:
        paths: Of the files.
    """

    def __init__(self, *paths: Path) -> None:
        self._paths = paths
        self._seen = self._look()

    def changed(self) -> bool:
        """Return whether any of them is another than at the last look, or is there now and was not, or is gone."""
        before, self._seen = self._seen, self._look()
        return self._seen != before

    def _look(self) -> list[tuple[int, int, int] | None]:
        return [_identity(path) for path in self._paths]


def _identity(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_mode

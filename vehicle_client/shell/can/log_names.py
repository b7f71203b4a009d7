"""Which files are CAN logs, by their names."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

LOG_SUFFIXES = (".blf", ".asc", ".log", ".mf4")


def is_log(path: Path) -> bool:
    """Return whether a file is called like a CAN log."""
    return log_suffix(path) in LOG_SUFFIXES


def log_suffix(path: Path) -> str:
    """Return what kind of log a file is by its name, in small letters and without the .gz that text logs may have."""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    return suffixes[-2] if len(suffixes) > 1 and suffixes[-1] == ".gz" else "".join(suffixes[-1:])

"""Files that appear whole or not at all: written beside, flushed to the disk, renamed."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

PART_SUFFIX = ".part"
"""Of what a process that was killed left unfinished."""


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it outlives this process and the machine's power, or leave what was there.

    Raises:
        OSError: The disk takes nothing.
    """
    beside = path.with_name(path.name + PART_SUFFIX)
    try:
        with beside.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except OSError:
        beside.unlink(missing_ok=True)
        raise
    # The new name is on the disk only when the folder is.
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)

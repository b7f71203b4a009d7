"""The file in which a car keeps what it has learned of itself: whole or not at all, small, and never in the way.

A file that is damaged, or of other constants, is moved aside and told of: a car that starts anew learns within some
fifteen passages what it had forgotten.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from roadgrip.errors import ConfigurationError
from vehicle_client.estimation.grip.memory import CarMemory, memory_of_json, memory_to_json
from vehicle_client.shell.whole_file import write_whole

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

LIMIT_BYTES = 100_000
"""More than any memory takes."""
ASIDE_SUFFIX = ".unreadable"


def kept_memory(path: Path, *, otherwise: CarMemory, on_damage: Callable[[str], None]) -> CarMemory:
    """Return the memory that a file holds, or another one where there is no such file or it is no memory.

    Args:
        path: The file.
        otherwise: The memory of a car that has not been driven.
        on_damage: Is told what was wrong with a file that was moved aside.

    Raises:
        OSError: The file cannot be read.
    """
    try:
        with path.open("rb") as file:
            data = file.read(LIMIT_BYTES)
    except FileNotFoundError:
        return otherwise
    try:
        # Cut where it is too long, it is no memory either.
        return memory_of_json(data.decode("utf-8", errors="replace"))
    except ConfigurationError as error:
        path.replace(path.with_name(path.name + ASIDE_SUFFIX))
        on_damage(f"{path} was moved aside: {error}")
        return otherwise


def keep_memory(path: Path, memory: CarMemory) -> None:
    """Write a memory into its file.

    Raises:
        OSError: The disk takes nothing; the file is as it was.
    """
    write_whole(path, memory_to_json(memory))

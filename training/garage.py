"""What the cars of a design's garage have learned of themselves, one file for each group that was driven.

As with designs, what is there already is not driven again, and files of other code are driven anew.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, as_completed
from functools import cache
from pathlib import Path
from types import MappingProxyType

from roadgrip.errors import ConfigurationError
from training.cars import CARS_COUNT, Lives, cars_of
from training.code_identity import code_digest
from training.everyday import EVERYDAY_COUNT, schooled
from training.scenarios import Terms
from vehicle_client.estimation.grip.memory import CarMemory, memory_of_json, memory_to_json

SCHOOLING_MODULES = ("training.everyday",)
"""Modules from which all that shapes a memory is reached by imports."""
GROUP_DRIVES_COUNT = CARS_COUNT * EVERYDAY_COUNT
"""Drives of a group before it has learned."""


def remembering_groups_count(terms: Terms) -> int:
    """Return how many groups of cars have learned before they drive a design."""
    return 0 if terms.garage is None else terms.garage.remembering_count


def school(terms: Terms, folder: Path, pool: Executor, *, on_group: Callable[[], None]) -> None:
    """Let the cars of a design learn, as far as they have not.

    Args:
        terms: Of the design.
        folder: Where memories lie; made if missing.
        pool: Drives.
        on_group: Called after every group.
    """
    lives = terms.cars
    if lives is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    running = []
    for group in range(remembering_groups_count(terms)):
        path = _path(lives, folder, group)
        if _read(path) is None:
            running.append(pool.submit(_school_and_write, lives, group, path))
        else:
            on_group()
    for done in as_completed(running):
        done.result()
        on_group()


@cache
def memories(terms: Terms, folder: Path) -> Mapping[int, CarMemory]:
    """Return what the cars of a design have learned, by the seeds of what their sensors get wrong.

    Args:
        terms: Of the design.
        folder: Where memories lie.

    Raises:
        ConfigurationError: Cars that should have learned have not.
    """
    found: dict[int, CarMemory] = {}
    lives = terms.cars
    if lives is None:
        return MappingProxyType(found)
    for group in range(remembering_groups_count(terms)):
        learned = _read(_path(lives, folder, group))
        if learned is None:
            raise ConfigurationError(f"group {group} of the cars in {folder} has not learned yet")
        found |= dict(zip((car.sensor_seed for car in cars_of(lives, group)), learned, strict=True))
    return MappingProxyType(found)


def _path(lives: Lives, folder: Path, group: int) -> Path:
    return folder / f"{lives.identity}-{group:04d}.json"


def _read(path: Path) -> tuple[CarMemory, ...] | None:
    """Return what a file holds; None if it is not there, of other code, or cut short by a power failure."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if document["code_digest"] != code_digest(*SCHOOLING_MODULES):
        return None
    return tuple(memory_of_json(text) for text in document["memories"])


def _school_and_write(lives: Lives, group: int, path: Path) -> None:
    document = {
        "code_digest": code_digest(*SCHOOLING_MODULES),
        "memories": [memory_to_json(memory) for memory in schooled(lives, group)],
    }
    # Of this process alone: both parts of a study may be run side by side.
    draft = path.with_suffix(f".{os.getpid()}")
    draft.write_text(json.dumps(document), encoding="utf-8")
    draft.replace(path)

"""The file in which a car keeps what it has learned of itself: whole or not at all, small, and one per vehicle.

A memory tells by how much a car differs from what its vehicle file declares, so the file says which vehicle that was;
beside another vehicle's constants it would be wrong. Who starts anew learns within some fifteen passages what was lost.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from roadgrip.errors import ConfigurationError
from roadgrip.features import TABLES
from vehicle_client.estimation.grip.memory import CarMemory, memory_of_json, memory_to_json, new_memory
from vehicle_client.pipeline import grip_features, memory_after
from vehicle_client.shell.whole_file import PART_SUFFIX, write_whole
from vehicle_client.vehicle_profile import vehicle_digest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from vehicle_client.pipeline import Summarised
    from vehicle_client.vehicle_profile import VehicleProfile

LIMIT_BYTES = 100_000
"""More than any memory takes."""
ASIDE_SUFFIX = ".unreadable"
FOREIGN_SUFFIX = ".foreign"
_WHAT = "memory of a car"


@dataclass(frozen=True, slots=True)
class KeptMemory:
    """What a file holds.

    Attributes:
        vehicle_name: What people call the vehicle.
        vehicle_digest: Of what was declared of it.
        memory: What it has learned.
    """

    vehicle_name: str
    vehicle_digest: str
    memory: CarMemory

    def belongs_to(self, vehicle: VehicleProfile) -> bool:
        """Return whether it was learned beside what this vehicle declares."""
        same_start = self.memory.first_std == first_memory(vehicle).first_std
        return same_start and self.vehicle_digest == vehicle_digest(vehicle)


def first_memory(vehicle: VehicleProfile) -> CarMemory:
    """Return the memory of a car that has not been driven."""
    return new_memory(handling_std_ratio=vehicle.handling_std_ratio)


def read_kept(path: Path) -> KeptMemory | None:
    """Return what a file holds; None where there is no file.

    Raises:
        ConfigurationError: It is no memory of a car.
        OSError: The file cannot be read.
    """
    try:
        with path.open("rb") as file:
            # Cut where it is too long, it is no memory either.
            text = file.read(LIMIT_BYTES).decode("utf-8", errors="replace")
    except FileNotFoundError:
        return None
    try:
        document: dict[str, Any] = json.loads(text)
        if document["what"] != _WHAT:
            raise ConfigurationError(f"{path} is no {_WHAT}")
        name, digest = str(document["vehicle_name"]), str(document["vehicle_digest"])
        learned = json.dumps(document["memory"])
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise ConfigurationError(f"{path} is no {_WHAT}: {type(error).__name__} {error}") from error
    try:
        return KeptMemory(name, digest, memory_of_json(learned))
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error


def memory_of(path: Path, vehicle: VehicleProfile) -> CarMemory:
    """Return the memory that a file holds, or that of a car that has not been driven where there is no file.

    Raises:
        ConfigurationError: It is damaged, another vehicle's, or cannot be read. The file is left as it is.
    """
    try:
        kept = read_kept(path)
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror or error}") from error
    if kept is None:
        return first_memory(vehicle)
    if not kept.belongs_to(vehicle):
        raise ConfigurationError(_foreign_text(path, kept, vehicle))
    return kept.memory


def memory_or_new(path: Path, vehicle: VehicleProfile, *, on_moved: Callable[[str], None]) -> CarMemory:
    """Return the same, but a file that is damaged or another vehicle's is moved aside: never in the way.

    What was moved aside before under the same name is lost.

    Args:
        path: The file.
        vehicle: The own car.
        on_moved: Is told what was wrong with a file that was moved aside.

    Raises:
        OSError: The file cannot be read or moved.
    """
    try:
        kept = read_kept(path)
    except ConfigurationError as error:
        _move_aside(path, ASIDE_SUFFIX)
        on_moved(f"{error}; it was moved aside")
        return first_memory(vehicle)
    if kept is None:
        return first_memory(vehicle)
    if not kept.belongs_to(vehicle):
        _move_aside(path, FOREIGN_SUFFIX)
        on_moved(f"{_foreign_text(path, kept, vehicle)}; it was moved aside")
        return first_memory(vehicle)
    return kept.memory


def keep_memory(path: Path, memory: CarMemory, vehicle: VehicleProfile) -> None:
    """Write a memory into its file.

    Raises:
        OSError: The disk takes nothing; the file is as it was.
    """
    document = {
        "what": _WHAT,
        "vehicle_name": vehicle.name,
        "vehicle_digest": vehicle_digest(vehicle),
        "memory": json.loads(memory_to_json(memory)),
    }
    write_whole(path, json.dumps(document, indent=1))


def forget_memory(path: Path) -> bool:
    """Return whether there was a memory; it is gone now, and what was moved aside of it.

    Raises:
        ConfigurationError: The file is no memory; it is left as it is.
        OSError: A file cannot be removed.
    """
    was_there = read_kept(path) is not None
    for suffix in ("", ASIDE_SUFFIX, FOREIGN_SUFFIX, PART_SUFFIX):
        path.with_name(path.name + suffix).unlink(missing_ok=True)
    return was_there


def learned(made: Summarised, vehicle: VehicleProfile, *, memory: CarMemory, seen_with: CarMemory) -> CarMemory:
    """Return the memory after a passage; the same one if the passage taught nothing.

    The friction of the passage is what the car itself finds best, never what a unit says: a memory that believed
    others would be told by them what its own tyres are like.

    Args:
        made: What the pipeline made of the passage.
        vehicle: The own car.
        memory: Of the car now.
        seen_with: Of the car when the passage was summarised; another one if two passages overlapped.
    """
    column = TABLES[made.summary.table_digest].index("grip_all_best_mu")
    friction_mu = made.summary.values[column]
    if seen_with is not memory:
        # The best friction comes first of what the inverse tells.
        friction_mu = float(
            grip_features(
                made.sensed, vehicle=vehicle.geometry, handling=vehicle.handling, noise=vehicle.noise, memory=memory
            )[0]
        )
    try:
        after = memory_after(
            made.sensed,
            memory,
            friction_mu=friction_mu,
            vehicle=vehicle.geometry,
            handling=vehicle.handling,
            noise=vehicle.noise,
        )
        # What could not be read again is no memory to go on with.
        return after if after is memory else memory_of_json(memory_to_json(after))
    except (np.linalg.LinAlgError, ConfigurationError):
        return memory


def _move_aside(path: Path, suffix: str) -> None:
    path.replace(path.with_name(path.name + suffix))


def _foreign_text(path: Path, kept: KeptMemory, vehicle: VehicleProfile) -> str:
    return (
        f"{path} is the memory of {kept.vehicle_name!r} ({kept.vehicle_digest}), declared otherwise than "
        f"{vehicle.name!r} ({vehicle_digest(vehicle)})"
    )

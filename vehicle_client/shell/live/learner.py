"""What the live client's car learns of itself, and the file it keeps that in; whatever fails leaves it driving."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from vehicle_client.shell.car_memory import keep_memory, learned, memory_or_new

if TYPE_CHECKING:
    from pathlib import Path

    from vehicle_client.estimation.grip.memory import CarMemory
    from vehicle_client.pipeline import Summarised
    from vehicle_client.vehicle_profile import VehicleProfile


class Learner:
    """One car's memory while it drives.

    Attributes:
        memory: What the car knows of itself now; None if it learns nothing.
        notes: What was wrong with the file, as entries for the log.
    """

    def __init__(self, path: Path | None, vehicle: VehicleProfile) -> None:
        """Read the file; one that is damaged or another vehicle's is moved aside, one that cannot be used is left.

        Args:
            path: The file; None learns nothing.
            vehicle: The own car.
        """
        self._path = path
        self._vehicle = vehicle
        self.memory: CarMemory | None = None
        self.notes: list[dict[str, Any]] = []
        if path is None:
            return
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self.memory = memory_or_new(path, vehicle, on_moved=lambda what: self._note("memory_moved_aside", what))
        except OSError as error:
            # Written over, a memory that may only not be read now would be lost.
            self._note("memory_off", f"cannot use {path}: {error.strerror or error}")

    def learn(self, made: Summarised, seen_with: CarMemory) -> bool:
        """Return whether a passage taught something; what it taught is in the file then. Runs in the worker.

        Args:
            made: What the pipeline made of the passage.
            seen_with: The memory that it was made with.

        Raises:
            OSError: The disk takes nothing; the car knows what it learned until it is switched off.
        """
        before = self.memory
        if before is None or self._path is None:
            return False
        after = learned(made, self._vehicle, memory=before, seen_with=seen_with)
        if after is before:
            return False
        self.memory = after
        keep_memory(self._path, after, self._vehicle)
        return True

    def state(self) -> dict[str, int]:
        """Return from how many passages the car has learned; nothing where it does not."""
        return {} if self.memory is None else {"memory_passages": self.memory.passages_count}

    def _note(self, event: str, what: str) -> None:
        self.notes.append({"event": event, "what": what})

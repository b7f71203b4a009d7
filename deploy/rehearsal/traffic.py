"""Traffic for the rehearsal: drives that were simulated beforehand, sent to a unit one after another.

Each waits for its receipt. What was acknowledged is remembered, to be counted again in the unit's database.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from roadgrip.sections import read_section
from training.dataset import Runs, read_runs

SECTION = "long-turn"
PATIENCE_S = 30.0
BREATH_S = 0.3
"""Between two vehicles: a unit beside a road has other things to do, too."""


@dataclass(frozen=True, slots=True)
class Drive:
    """One vehicle's pass, ready to be sent.

    Attributes:
        content: The passage as JSON, without its id.
        base_mu: What the road offered, which nobody tells the unit.
    """

    content: dict[str, Any]
    base_mu: float


def drives_of(folder: Path) -> list[Drive]:
    """Return the drives of a design that gave a summary, in its order."""
    runs: Runs = read_runs(folder)
    section = read_section(SECTION)
    kinematic_count = len(runs.table.kinematic)
    drives = []
    for row in np.flatnonzero(runs.usable & (np.array(runs.section_id) == SECTION)).tolist():
        values = runs.features[row, :kinematic_count].astype(np.float32)
        drives.append(
            Drive(
                content={
                    "map_version": section.version,
                    "table_digest": runs.table.digest,
                    "duration_s": float(runs.labels["duration_s"][row]),
                    "age_s": 0.0,
                    "quality": 0,
                    "values": [float(value) for value in values],
                },
                base_mu=float(runs.labels["base_friction_mu"][row]),
            )
        )
    return drives


class Traffic:
    """Sends drives to one unit.

    Args:
        url: Of the unit.
        rng: Names passages.
    """

    def __init__(self, url: str, *, rng: np.random.Generator) -> None:
        self.acknowledged: list[bytes] = []
        self.lost: list[str] = []
        self._url = f"{url}/v1/sections/{SECTION}/passages"
        self._rng = rng
        self._stop = threading.Event()

    def send(self, drives: Iterable[Drive]) -> int:
        """Return how many of some drives were acknowledged; they follow close upon each other."""
        before = len(self.acknowledged)
        with httpx.Client(timeout=PATIENCE_S) as client:
            for drive in drives:
                self._send_one(client, drive)
        return len(self.acknowledged) - before

    @contextmanager
    def flowing(self, drives: Iterator[Drive]) -> Iterator[None]:
        """Send drives until the context ends, or there are no more."""
        self._stop.clear()

        def flow() -> None:
            with httpx.Client(timeout=PATIENCE_S) as client:
                for drive in drives:
                    self._send_one(client, drive)
                    if self._stop.wait(BREATH_S):
                        return

        thread = threading.Thread(target=flow)
        thread.start()
        try:
            yield
        finally:
            self._stop.set()
            thread.join()

    def _send_one(self, client: httpx.Client, drive: Drive) -> None:
        passage_id = self._rng.bytes(16)
        answer = client.post(self._url, json={**drive.content, "passage_id": passage_id.hex()})
        if answer.is_success:
            self.acknowledged.append(passage_id)
        else:
            self.lost.append(answer.text)

"""The newest passages of a section with all their features: what drift is told from."""

from __future__ import annotations

import struct
from bisect import bisect_left, insort
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, nan

import numpy as np
from numpy.typing import NDArray

from roadgrip.records import NotCounted
from roadgrip.units import FloatArray

CAPACITY_COUNT = 256
"""Passages per feature table: enough to tell a major shift of a feature from chance."""
_KNOWN = struct.Struct("<ff")
_MU, _FLAGS, _VALUES = 0, 1, 2
"""Where a passage's numbers stand in its line."""


@dataclass(frozen=True, slots=True, eq=False)
class FeatureRows:
    """The passages of one feature table, oldest first.

    Attributes:
        values: Their kinematic features. (n, features)
        mu: The live model's estimates; NaN where it gave no number. (n,)
        flags: Why they do not count, as `roadgrip.records.NotCounted`. (n,)
    """

    values: NDArray[np.float32]
    mu: FloatArray
    flags: NDArray[np.int64]

    @property
    def out_of_envelope_count(self) -> int:
        """How many lie outside the live model's envelope."""
        return int(((self.flags & NotCounted.OUT_OF_ENVELOPE.value) != 0).sum())


class FeatureWindow:
    """Passages that left the section at most `window_s` ago, at most so many of each feature table, the newest.

    What the window holds depends on which passages were added and on the time, never on the order in which they
    arrived. It takes no memory before its first passage: a unit in a data centre serves thousands of sections. A full
    table of 114 features takes some 150 kB. Remembering a passage is one move within a list of references.

    All times are seconds of one monotonic clock that the caller names.

    Args:
        window_s: How long a passage is remembered.
        capacity_count: Passages of each feature table that are remembered at most.
    """

    def __init__(self, *, window_s: float, capacity_count: int = CAPACITY_COUNT) -> None:
        if not (window_s > 0.0 and capacity_count > 0):
            raise ValueError(f"a window of {window_s} s and {capacity_count} passages holds nothing")
        self._window_s = window_s
        self._capacity_count = capacity_count
        # Per table: the moment, and the passage as bytes, which can be ordered where moments are equal.
        self._by_time: dict[str, list[tuple[float, bytes]]] = {}

    def __len__(self) -> int:
        """Return how many passages are held; those that grew too old count until `rows` is asked."""
        return sum(map(len, self._by_time.values()))

    @property
    def table_digests(self) -> tuple[str, ...]:
        """The feature tables that passages are held of, in alphabetical order."""
        return tuple(sorted(self._by_time))

    def add(
        self,
        *,
        left_at_s: float,
        table_digest: str,
        values: Sequence[float] | NDArray[np.float32],
        mu: float | None,
        flags: NotCounted = NotCounted.NONE,
    ) -> None:
        """Remember a passage; the oldest of its table goes if there is no room.

        Args:
            left_at_s: When the vehicle left the section.
            table_digest: The feature table of the values, one that is served: the window holds as many tables as there
                are.
            values: The kinematic features, as many for every passage of a table.
            mu: The live model's estimate; None when it gave no number.
            flags: Why the passage does not count.

        Raises:
            ValueError: The time cannot be ordered.
        """
        if not isfinite(left_at_s):
            raise ValueError(f"a passage at {left_at_s} s does not belong in a window")
        line = _KNOWN.pack(nan if mu is None else mu, flags.value) + np.asarray(values, dtype="<f4").tobytes()
        held = self._by_time.setdefault(table_digest, [])
        insort(held, (left_at_s, line))
        if len(held) > self._capacity_count:
            held.pop(0)

    def rows(self, table_digest: str, *, now_s: float) -> FeatureRows | None:
        """Return the passages of one feature table, None without any.

        Args:
            table_digest: Which table.
            now_s: By the clock of the passages; what is too old is forgotten, of all tables.
        """
        self._evict(now_s)
        held = self._by_time.get(table_digest)
        if held is None:
            return None
        lines = np.frombuffer(b"".join(content for _, content in held), dtype="<f4").reshape(len(held), -1)
        return FeatureRows(
            values=lines[:, _VALUES:],
            mu=lines[:, _MU].astype(np.float64),
            flags=lines[:, _FLAGS].astype(np.int64),
        )

    def forget(self) -> None:
        """Forget all: after a switch of the model its estimates and flags are another's."""
        self._by_time.clear()

    def _evict(self, now_s: float) -> None:
        for digest, held in list(self._by_time.items()):
            del held[: bisect_left(held, (now_s - self._window_s,))]
            if not held:
                del self._by_time[digest]

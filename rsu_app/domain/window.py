"""The rolling hour of estimates of one section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import inf, isfinite, nan
from typing import cast

import numpy as np
from sortedcontainers import SortedList

from roadgrip.units import WINDOW_S, BoolArray, FloatArray
from rsu_app.domain.sorted_rows import SortedRows

CAPACITY_COUNT = 100_000
"""Estimates a window may hold, some 12 MB: four lanes at saturation give fewer than 10,000 vehicles an hour."""


@dataclass(frozen=True, slots=True)
class WindowRows:
    """Estimates of a window as arrays, in the order of their times, equal times by friction. Each (n,)

    Attributes:
        left_at_s: When the vehicle left the section.
        mu: The estimate, always there, however doubtful.
        at_least: The estimate is doubtful: the passage only says that the friction is at least `mu_low`.
        mu_low: Below this the friction hardly is, with the coverage the model promises; NaN when the model says
            nothing about its error.
        expected_error_ratio: Size of the error to expect, relative to the estimate; NaN when the model says nothing.
        slowest_mps: How slowly the vehicle drove where it was slowest; NaN when that is not known.
    """

    left_at_s: FloatArray
    mu: FloatArray
    at_least: BoolArray
    mu_low: FloatArray
    expected_error_ratio: FloatArray
    slowest_mps: FloatArray


class FrictionWindow:
    """Estimates that left the section at most `window_s` ago, ready for order statistics at any moment.

    What the window holds depends on which estimates were added and on the time, never on the order in which they
    arrived: vehicles report over radio at once and over cellular tens of minutes later. At its capacity it keeps the
    estimates that left last.

    All times are seconds of one monotonic clock that the caller names; a step of the wall clock does not touch it.

    The estimates are kept twice, in the order of friction and in that of time: order statistics are an index away,
    and the next to leave comes first. An estimate costs as much in a full window as in an empty one.

    Args:
        window_s: How long an estimate counts.
        capacity_count: Estimates that may be held at once.
    """

    def __init__(self, *, window_s: float = WINDOW_S, capacity_count: int = CAPACITY_COUNT) -> None:
        if not (window_s > 0.0 and capacity_count > 0):
            raise ValueError(f"a window of {window_s} s and {capacity_count} estimates holds nothing")
        self.window_s = window_s
        self.capacity_count = capacity_count
        self._ordered_mu: SortedList = SortedList()
        self._by_time = SortedRows(_COLUMNS_COUNT)
        self._rows: WindowRows | None = None
        self._newest: tuple[int, WindowRows] | None = None

    def __len__(self) -> int:
        """Return how many estimates are held; those that grew too old count until `evict`."""
        return len(self._ordered_mu)

    @property
    def ordered_mu(self) -> Sequence[float]:
        """The estimates from smallest to largest; to be read, not changed."""
        return cast("Sequence[float]", self._ordered_mu)

    @property
    def newest_left_at_s(self) -> float:
        """When the last vehicle of the window left the section; minus infinity when the window is empty."""
        return float(self._by_time.last[0]) if self._by_time else -inf

    @property
    def oldest_left_at_s(self) -> float:
        """When the first vehicle of the window left the section; infinity when the window is empty."""
        return self._by_time.first_number if self._by_time else inf

    @property
    def rows(self) -> WindowRows:
        """All entries, oldest first; to be read, not changed. Made once after each change of the window."""
        if self._rows is None:
            self._rows = _rows(self._by_time.newest(len(self)))
        return self._rows

    def newest_rows(self, limit_count: int) -> WindowRows:
        """Return the newest entries, oldest first, at most so many; to be read, not changed.

        Made once after each change of the window, in a time that the limit bounds and the window does not.

        Args:
            limit_count: Entries that are wanted at most, above zero.
        """
        if self._newest is None or self._newest[0] != limit_count:
            self._newest = limit_count, _rows(self._by_time.newest(limit_count))
        return self._newest[1]

    def add(
        self,
        *,
        left_at_s: float,
        mu: float,
        at_least: bool = False,
        mu_low: float = nan,
        expected_error_ratio: float = nan,
        slowest_mps: float = nan,
    ) -> None:
        """Hold an estimate; the oldest goes if there is no room.

        Args:
            left_at_s: When the vehicle left the section.
            mu: Its estimate, finite and above zero.
            at_least: Whether the passage only says that the friction is at least `mu_low`.
            mu_low: Below this the friction hardly is; NaN when the model says nothing about its error.
            expected_error_ratio: Size of the error to expect, relative to `mu`; NaN when the model says nothing.
            slowest_mps: How slowly the vehicle drove where it was slowest; NaN when that is not known.

        Raises:
            ValueError: The time or the estimate is not a number that can be ordered; or an estimate that says "at
                least" does not say what.
        """
        if not (isfinite(left_at_s) and isfinite(mu) and mu > 0.0):
            raise ValueError(f"estimate {mu} at {left_at_s} s does not belong in a window")
        if at_least and not mu_low > 0.0:
            raise ValueError(f"estimate {mu} at {left_at_s} s says that friction is at least {mu_low}")
        self._by_time.add((left_at_s, mu, at_least, mu_low, expected_error_ratio, slowest_mps))
        self._ordered_mu.add(mu)
        self._rows = self._newest = None
        if len(self._by_time) > self.capacity_count:
            self._drop_oldest()

    def evict(self, *, now_s: float) -> int:
        """Forget what left the section more than the window ago, and return how many that were.

        An estimate exactly as old as the window still counts.
        """
        horizon_s = now_s - self.window_s
        dropped_count = 0
        while self._by_time and self._by_time.first_number < horizon_s:
            self._drop_oldest()
            dropped_count += 1
        return dropped_count

    def _drop_oldest(self) -> None:
        self._ordered_mu.remove(float(self._by_time.pop_first()[1]))
        self._rows = self._newest = None


_COLUMNS_COUNT = len(fields(WindowRows))


def _rows(table: FloatArray) -> WindowRows:
    left_at_s, mu, at_least, mu_low, expected_error_ratio, slowest_mps = np.ascontiguousarray(table.T)
    return WindowRows(
        left_at_s=left_at_s,
        mu=mu,
        at_least=at_least == 1.0,
        mu_low=mu_low,
        expected_error_ratio=expected_error_ratio,
        slowest_mps=slowest_mps,
    )

"""The rolling hour of estimates of one section."""

from __future__ import annotations

import heapq
from bisect import bisect_left, insort
from collections.abc import Sequence
from math import inf, isfinite

from roadgrip.units import WINDOW_S

CAPACITY_COUNT = 20_000
"""Estimates a window may hold: four lanes at saturation give fewer than 10,000 vehicles an hour."""


class FrictionWindow:
    """Estimates that left the section at most `window_s` ago, ready for order statistics at any moment.

    What the window holds depends on which estimates were added and on the time, never on the order in which they
    arrived: vehicles report over radio at once and over cellular tens of minutes later. At its capacity it keeps the
    estimates that left last.

    All times are seconds of one monotonic clock that the caller names; a step of the wall clock does not touch it.

    Two structures hold the same estimates: a list sorted by friction, in which a place is found by bisection and
    order statistics are an index away, and a heap by time, whose top is the next to leave.

    Args:
        window_s: How long an estimate counts.
        capacity_count: Estimates that may be held at once.
    """

    def __init__(self, *, window_s: float = WINDOW_S, capacity_count: int = CAPACITY_COUNT) -> None:
        if not (window_s > 0.0 and capacity_count > 0):
            raise ValueError(f"a window of {window_s} s and {capacity_count} estimates holds nothing")
        self.window_s = window_s
        self.capacity_count = capacity_count
        self._ordered_mu: list[float] = []
        self._by_time: list[tuple[float, float]] = []
        self._newest_left_at_s = -inf

    def __len__(self) -> int:
        """Return how many estimates are held; those that grew too old count until `evict`."""
        return len(self._ordered_mu)

    @property
    def ordered_mu(self) -> Sequence[float]:
        """The estimates from smallest to largest; to be read, not changed."""
        return self._ordered_mu

    @property
    def newest_left_at_s(self) -> float:
        """When the last vehicle of the window left the section; minus infinity when the window is empty."""
        return self._newest_left_at_s

    def add(self, *, left_at_s: float, mu: float) -> None:
        """Hold an estimate; the oldest goes if there is no room.

        Args:
            left_at_s: When the vehicle left the section.
            mu: Its estimate, finite and above zero.

        Raises:
            ValueError: The time or the estimate is not a number that can be ordered.
        """
        if not (isfinite(left_at_s) and isfinite(mu) and mu > 0.0):
            raise ValueError(f"estimate {mu} at {left_at_s} s does not belong in a window")
        heapq.heappush(self._by_time, (left_at_s, mu))
        insort(self._ordered_mu, mu)
        self._newest_left_at_s = max(self._newest_left_at_s, left_at_s)
        if len(self._by_time) > self.capacity_count:
            self._drop_oldest()

    def evict(self, *, now_s: float) -> int:
        """Forget what left the section more than the window ago, and return how many that were.

        An estimate exactly as old as the window still counts.
        """
        horizon_s = now_s - self.window_s
        dropped_count = 0
        while self._by_time and self._by_time[0][0] < horizon_s:
            self._drop_oldest()
            dropped_count += 1
        return dropped_count

    def _drop_oldest(self) -> None:
        _, mu = heapq.heappop(self._by_time)
        del self._ordered_mu[bisect_left(self._ordered_mu, mu)]
        if not self._by_time:
            self._newest_left_at_s = -inf

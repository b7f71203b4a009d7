"""Clocks: the machine's own, and one that runs faster for demonstrations."""

from __future__ import annotations

import time


class SystemClock:
    """The machine's clocks."""

    def monotonic_s(self) -> float:
        """Return seconds since an arbitrary moment; never goes back, never jumps."""
        return time.monotonic()

    def unix_s(self) -> float:
        """Return seconds since 1970 by the wall clock."""
        return time.time()


class AcceleratedClock:
    """Both clocks at a multiple of their pace, starting from now; an hour of traffic in minutes.

    Args:
        speedup_ratio: Seconds that pass here per second of the machine; above zero.
        not_before_unix_s: Where the wall clock starts at the earliest: a unit that runs ahead of the world must not
            fall behind what it has stored when it is started again.
    """

    def __init__(self, speedup_ratio: float, *, not_before_unix_s: float = 0.0) -> None:
        if not speedup_ratio > 0.0:
            raise ValueError(f"a clock cannot run at {speedup_ratio} times its pace")
        self._speedup_ratio = speedup_ratio
        self._start_monotonic_s = time.monotonic()
        self._start_unix_s = max(time.time(), not_before_unix_s)

    def monotonic_s(self) -> float:
        """Return seconds since an arbitrary moment; never goes back, never jumps."""
        return self._start_monotonic_s + self._speedup_ratio * (time.monotonic() - self._start_monotonic_s)

    def unix_s(self) -> float:
        """Return seconds since 1970, as if they had passed at this pace since the clock was made.

        Follows the monotonic clock, so that both stay together even if the machine's wall clock steps.
        """
        return self._start_unix_s + self._speedup_ratio * (time.monotonic() - self._start_monotonic_s)

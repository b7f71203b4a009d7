"""The watch for changes of one section: it remembers longer than the window does, and says since when estimates count.

Few vehicles an hour tell of no change within an hour, so the memory reaches over several windows. It is bounded by the
number of vehicles that the detector looks at, whatever the traffic.
"""

from __future__ import annotations

from math import inf

import numpy as np

from rsu_app.domain.change import ChangePolicy, changes
from rsu_app.domain.window import FrictionWindow, WindowRows

MEMORY_WINDOWS_COUNT = 3
"""So many windows are remembered; what is older than one of them still does not count."""


class ChangeWatch:
    """Knows since when the road is as it is.

    Estimates may come late: the detector folds anew over what is remembered, in the order of time. Only in traffic so
    dense that the memory no longer reaches back to a change that was found does it stay found without being seen.

    Args:
        policy: When the road is held to have changed.
        window_s: Length of the window that is cut.
    """

    def __init__(self, *, policy: ChangePolicy, window_s: float) -> None:
        self._policy = policy
        self._memory = FrictionWindow(window_s=MEMORY_WINDOWS_COUNT * window_s, capacity_count=policy.watched_count)
        self._seen: WindowRows | None = None
        self._unseen_count = 0
        self._since_s = -inf

    @property
    def memory_s(self) -> float:
        """How far back estimates are remembered."""
        return self._memory.window_s

    def add(self, *, left_at_s: float, mu: float) -> None:
        """Remember an estimate that names a friction.

        Args:
            left_at_s: When the vehicle left the section.
            mu: What it found; above zero. One that only says "at least" has no place here: it falls short of nothing.
        """
        self._memory.add(left_at_s=left_at_s, mu=mu)
        self._unseen_count += 1
        # Before the dense traffic of a restart pushes a change out of the memory that nobody has asked for yet.
        if 2 * self._unseen_count >= self._policy.watched_count:
            self._look()

    def since_s(self, *, now_s: float) -> float:
        """Return when the first vehicle that found the present friction left the section, minus infinity if all did.

        The work is bounded by the vehicles that the policy watches, and done once after each of them.

        Args:
            now_s: By the clock of the estimates.
        """
        self._memory.evict(now_s=now_s)
        self._look()
        return self._since_s

    def counted_from_s(self, window: FrictionWindow, *, now_s: float) -> float:
        """Return from when on the entries of a window count; minus infinity when all do.

        The newest few of them count in any case, as many as the policy keeps.

        Args:
            window: What is cut; nothing in it is older than it may be.
            now_s: By the clock of the estimates.
        """
        since_s = self.since_s(now_s=now_s)
        if since_s <= window.oldest_left_at_s:
            return -inf
        newest = window.newest_rows(self._policy.watched_count).left_at_s
        return min(since_s, float(newest[-self._policy.kept_count :][0]))

    def _look(self) -> None:
        rows = self._memory.rows
        if rows is self._seen:
            return
        self._seen, self._unseen_count = rows, 0
        found = changes(rows.left_at_s, rows.mu, policy=self._policy)
        if found:
            self._since_s = found[-1].since_s
        elif not self._hidden(rows):
            self._since_s = -inf

    def _hidden(self, rows: WindowRows) -> bool:
        """Return whether the change that was found last is too long ago for the memory to show it."""
        needed_count = self._policy.reference_count + self._policy.lag_count
        before_count = int(np.searchsorted(rows.left_at_s, self._since_s))
        return len(rows.left_at_s) == self._policy.watched_count and before_count < needed_count

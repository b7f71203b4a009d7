"""What the passages of a section say about every friction, remembered as long as they count.

Where hardly any vehicle can name a friction, all of them together may still know it: shallow likelihoods add up. This
memory answers that question only; what is published does not rest on it.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

import numpy as np

from roadgrip.features import PROFILE_FRICTIONS_MU
from roadgrip.units import FloatArray
from rsu_app.domain.pooling import RefinedInterval
from rsu_app.domain.profiles import ProfilePolicy, evidence_of_profiles, interval_of_evidence, says_something

LIKELIHOODS_COUNT = 200
"""Passages that are remembered at most, the newest: what is asked of them grows with their number, as what they share
does, so more would know no more."""
_GRID_MU = np.array(PROFILE_FRICTIONS_MU)


@dataclass(slots=True)
class _Told:
    profile_ratio: FloatArray
    evidence_values: FloatArray | None = None
    """None until somebody asks: most sections know their friction without, and it costs as much as a model's answer."""


class _Moment(NamedTuple):
    left_at_s: float
    order: int
    told: _Told


class LikelihoodWindow:
    """The likelihoods of the last hour; whatever the order in which they came.

    Args:
        window_s: How long a passage counts.
        policy: How far they are believed.
        capacity_count: Passages that are remembered at most.
    """

    def __init__(
        self, *, window_s: float, policy: ProfilePolicy | None = None, capacity_count: int = LIKELIHOODS_COUNT
    ) -> None:
        self._window_s = window_s
        self._policy = policy or ProfilePolicy()
        self._capacity_count = capacity_count
        self._by_time: list[_Moment] = []
        self._added_count = 0

    def __len__(self) -> int:
        """Return how many passages are remembered."""
        return len(self._by_time)

    def add(self, *, left_at_s: float, profile_ratio: FloatArray) -> None:
        """Remember what a passage says.

        Args:
            left_at_s: When the vehicle left the section.
            profile_ratio: Its log likelihood at `roadgrip.features.PROFILE_FRICTIONS_MU`, finite. (k,)
        """
        # The running number keeps equal times from being ordered by what was told.
        self._added_count += 1
        insort(self._by_time, _Moment(left_at_s, self._added_count, _Told(profile_ratio)))
        if len(self._by_time) > self._capacity_count:
            self._by_time.pop(0)

    def placed(self, *, now_s: float, counted_from_s: float = -inf) -> RefinedInterval | None:
        """Return the interval that those place who count, None without any.

        Args:
            now_s: By the clock of the passages; what is too old is forgotten.
            counted_from_s: Only these count: since the friction changed.
        """
        del self._by_time[: bisect_left(self._by_time, (now_s - self._window_s,))]
        counted = [moment.told for moment in self._by_time[bisect_left(self._by_time, (counted_from_s,)) :]]
        if not counted:
            return None
        profiles_ratio = np.array([told.profile_ratio for told in counted])
        informative_count = int(np.count_nonzero(says_something(profiles_ratio, policy=self._policy)))
        return interval_of_evidence(
            np.sum([self._evidence_values(told) for told in counted], axis=0),
            grid_mu=_GRID_MU,
            informative_count=informative_count,
            flat_count=len(counted) - informative_count,
            policy=self._policy,
        )

    def _evidence_values(self, told: _Told) -> FloatArray:
        if told.evidence_values is None:
            line = told.profile_ratio[None, :]
            told.evidence_values = evidence_of_profiles(line, grid_mu=_GRID_MU, policy=self._policy)[0]
        return told.evidence_values

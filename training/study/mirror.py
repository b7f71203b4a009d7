"""The same drive on the mirrored road, feature by feature: left and right are alike to tyres, not to a road at hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadgrip.units import FloatArray
from training.study.paper_features import signal_of, statistic_of

TURNING_SIGNALS = frozenset({"steer", "sideslip", "sideslip_rate", "yaw_rate_excess"})
"""Positive to the left. The speed has no side, and the grip features tell magnitudes."""
_OTHER_STATISTIC = {"q20": "q80", "q80": "q20", "q40": "q60", "q60": "q40", "min": "max", "max": "min"}
"""Which statistic of a signal becomes which when its sign turns; the others keep their place."""
_EVEN_STATISTICS = frozenset({"std", "kurtosis"})


@dataclass(frozen=True, slots=True)
class Mirror:
    """What mirroring does to features: row[partner] * sign_ratio.

    Attributes:
        partner: Which column each takes its value from; twice is once around. (d,)
        sign_ratio: 1 or -1. (d,)
    """

    partner: NDArray[np.intp]
    sign_ratio: FloatArray

    def of(self, rows: FloatArray) -> FloatArray:
        """Return the same drives on mirrored roads. (n, d)"""
        mirrored: FloatArray = rows[:, self.partner] * self.sign_ratio
        return mirrored

    def to_one_side(self, rows: FloatArray) -> FloatArray:
        """Return each drive or its mirror image, so that the first feature that only turns its sign is not negative."""
        turning = np.flatnonzero((self.partner == np.arange(len(self.partner))) & (self.sign_ratio < 0.0))
        if len(turning) == 0:
            return rows
        return np.where((rows[:, turning[0]] < 0.0)[:, None], self.of(rows), rows)


def mirror_of(names: Sequence[str]) -> Mirror:
    """Return what mirroring does to some features of the vehicle; those of a road have no mirror here.

    Raises:
        ValueError: A feature becomes one that is not among them.
    """
    place = {(signal_of(name), statistic_of(name)): column for column, name in enumerate(names)}
    partner, sign = np.arange(len(names)), np.ones(len(names))
    for (signal, statistic), column in place.items():
        if signal not in TURNING_SIGNALS or not statistic:
            continue
        other = (signal, _OTHER_STATISTIC.get(statistic, statistic))
        if other not in place:
            raise ValueError(f"mirrored, {names[column]} becomes a feature that is not there")
        partner[column] = place[other]
        sign[column] = 1.0 if statistic in _EVEN_STATISTICS else -1.0
    return Mirror(partner, sign)

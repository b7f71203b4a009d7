"""A log-likelihood of friction about its top: where it peaks, and how far away it has fallen by so much."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

_TIE = 1e-3
"""Frictions whose log-likelihoods differ by less are equally good: such a difference is no evidence."""


@dataclass(frozen=True, slots=True)
class Peak:
    """A log-likelihood about its top, told as the root of how far it falls: a line where the likelihood is a Gaussian.

    Attributes:
        log_mu: Frictions in rising order, that of the top among them. (k,)
        deviation_ratio: Root of the fall, negative below the top. (k,)
        top: Where the top stands among them.
        height_ratio: Log-likelihood of the top.
    """

    log_mu: FloatArray
    deviation_ratio: FloatArray
    top: int
    height_ratio: float

    @property
    def best_log_mu(self) -> float:
        """Where the top is."""
        return float(self.log_mu[self.top])

    def below(self, drop_ratio: float) -> float:
        """Return how far below its top the likelihood has fallen by so much; the end of the grid if it never does."""
        return _distance(self.log_mu[self.top :: -1], -self.deviation_ratio[self.top :: -1], drop_ratio)

    def above(self, drop_ratio: float) -> float:
        """Return the same above its top."""
        return _distance(self.log_mu[self.top :], self.deviation_ratio[self.top :], drop_ratio)


def top_of(log_mu: FloatArray, told_ratio: FloatArray) -> int:
    """Return where a log-likelihood is highest; the middle of all such places if there are several.

    Args:
        log_mu: Frictions in rising order. (k,)
        told_ratio: The log-likelihood there. (k,)
    """
    best = np.flatnonzero(told_ratio >= told_ratio.max() - _TIE)
    middle = 0.5 * (log_mu[best[0]] + log_mu[best[-1]])
    return int(best[np.argmin(np.abs(log_mu[best] - middle))])


def peak_of(log_mu: FloatArray, told_ratio: FloatArray) -> Peak:
    """Return a log-likelihood about its top: of a parabola through the highest place and its neighbours.

    Args:
        log_mu: Frictions in rising order. (k,)
        told_ratio: The log-likelihood there. (k,)
    """
    top = top_of(log_mu, told_ratio)
    at, height = float(log_mu[top]), float(told_ratio[top])
    if 0 < top < len(told_ratio) - 1:
        before, after = log_mu[top - 1] - at, log_mu[top + 1] - at
        rise, fall = (told_ratio[top - 1] - height) / before, (told_ratio[top + 1] - height) / after
        bend = (fall - rise) / (after - before)
        slope = rise - bend * before
        away = -0.5 * slope / bend if bend < 0.0 else 0.0
        if before < away < after:
            at, height = at + away, height + 0.5 * slope * away
    deviation = np.sqrt(np.maximum(height - told_ratio, 0.0))
    deviation[log_mu < at] *= -1.0
    place = int(np.searchsorted(log_mu, at))
    return Peak(_with(log_mu, place, at), _with(deviation, place, 0.0), place, height)


def _with(values: FloatArray, place: int, value: float) -> FloatArray:
    """Return values with one more at a place; `numpy.insert` takes ten times as long."""
    return np.concatenate([values[:place], [value], values[place:]])


def _distance(log_mu: FloatArray, deviation: FloatArray, drop_ratio: float) -> float:
    """Return how far from the first place on the likelihood has fallen by so much."""
    limit = drop_ratio**0.5
    beyond = np.flatnonzero(deviation >= limit)
    if len(beyond) == 0:
        return abs(float(log_mu[-1] - log_mu[0]))
    place = int(beyond[0])
    share = (limit - deviation[place - 1]) / (deviation[place] - deviation[place - 1])
    return abs(float(log_mu[place - 1] + share * (log_mu[place] - log_mu[place - 1]) - log_mu[0]))

"""Undoing what a regressor does to passages that say little: it answers with what is usual.

A regressor that errs least on the average draws every doubtful estimate towards the middle of what it was taught. That
is right for one passage and wrong for fifty on the same road, which are all drawn the same way. What adds up is not the
estimate but its likelihood: how probable it was to come out so if the friction were this or that. Learned from drives
on roads that the regressor had not seen, it is a line and a spread for every size of the expected error.

In the words of Bayes: the estimate with its error is a posterior; divided by what was usual in training, it is the
likelihood that many vehicles may be multiplied with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadgrip.units import FloatArray


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """What a regressor makes of a friction, by the error it expects of itself.

    For passages of one expected error, the mean of ln(estimate / usual_estimate_mu) is slope_ratio times
    ln(friction / usual_mu), and noise_ratio its standard deviation about that. Between the levels of the expected error
    everything is interpolated over its logarithm, beyond them it is as at the last one.

    Attributes:
        expected_error_ratio: The levels, ascending and above zero. (k,)
        usual_mu: About the middle of what such passages found. (k,)
        usual_estimate_mu: What they were answered there. (k,)
        slope_ratio: 1 where nothing is drawn anywhere, above 0. (k,)
        noise_ratio: Above zero. (k,)
    """

    expected_error_ratio: tuple[float, ...]
    usual_mu: tuple[float, ...]
    usual_estimate_mu: tuple[float, ...]
    slope_ratio: tuple[float, ...]
    noise_ratio: tuple[float, ...]

    def __post_init__(self) -> None:
        columns = (
            self.expected_error_ratio,
            self.usual_mu,
            self.usual_estimate_mu,
            self.slope_ratio,
            self.noise_ratio,
        )
        if len({len(column) for column in columns}) != 1 or not self.expected_error_ratio:
            raise ValueError("a shrinkage needs as many figures of each kind, and one level at least")
        if not all(np.isfinite(column).all() and min(column) > 0.0 for column in columns):
            raise ValueError("the figures of a shrinkage are finite and above zero")
        if not (np.diff(self.expected_error_ratio) > 0.0).all():
            raise ValueError("the levels of the expected error ascend")


@dataclass(frozen=True, slots=True)
class Unshrunk:
    """Estimates that are not drawn anywhere, each with the noise that this costs.

    Attributes:
        mu: The friction under which the answer is the usual one. (n,)
        noise_ratio: Standard deviation of ln mu about the friction. (n,)
    """

    mu: FloatArray
    noise_ratio: FloatArray


def unshrunk(mu: FloatArray, *, expected_error_ratio: FloatArray, shrinkage: Shrinkage) -> Unshrunk:
    """Return estimates of which the mean over many vehicles is the friction they found.

    Where the regressor hardly follows the friction, the noise is large: such a passage says little, and says it without
    a bias. NaN in, NaN out.

    Args:
        mu: The regressor's answers, above zero. (n,)
        expected_error_ratio: The error to expect of each, above zero. (n,)
        shrinkage: What the regressor makes of a friction.
    """
    level, at = np.log(shrinkage.expected_error_ratio), np.log(expected_error_ratio)
    slope = np.interp(at, level, shrinkage.slope_ratio)
    usual = np.interp(at, level, np.log(shrinkage.usual_mu))
    usual_estimate = np.interp(at, level, np.log(shrinkage.usual_estimate_mu))
    log_mu = usual + (np.log(mu) - usual_estimate) / slope
    return Unshrunk(mu=np.exp(log_mu), noise_ratio=np.interp(at, level, shrinkage.noise_ratio) / slope)

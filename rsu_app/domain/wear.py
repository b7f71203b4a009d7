"""What tyres of unknown wear make of one road: the distribution of a vehicle's estimate when the road is given.

A worn-out tyre finds `WORN_TYRE_RATIO` of what a new one finds; wear is spread evenly in between; the estimate of what
this tyre found is off by its own noise. All of it depends only on the ratio of the estimate to the friction of a new
tyre, so everything here is a function of the logarithm of that ratio.
"""

from __future__ import annotations

from math import erfc, log, sqrt

import numpy as np

from roadgrip.units import FloatArray
from rsu_app.domain.interval import WORN_TYRE_RATIO

_LOG_WORN = log(WORN_TYRE_RATIO)
_WEAR_DENSITY = 1.0 / (1.0 - WORN_TYRE_RATIO)

NOISE_PER_EXPECTED_ERROR_RATIO = sqrt(np.pi / 2.0)
"""Standard deviation of a normal error over its mean magnitude, which is what an expected error is."""


def estimate_density(log_ratio: FloatArray, *, noise_ratio: float) -> FloatArray:
    """Return the density of ln(estimate / mu_new) for one vehicle of unknown wear.

    With u the logarithm of the wear, of density 5 exp(u) between ln 0.8 and 0, and a normal error e of standard
    deviation s in the logarithm, it is the density of u + e at z:
    `5 exp(z + s^2/2) [Phi((-z - s^2)/s) - Phi((ln 0.8 - z - s^2)/s)]`.

    Args:
        log_ratio: z, where the density is asked for. (n,)
        noise_ratio: s, standard deviation of the relative error, above zero.

    Returns:
        The density, integrating to one over z. (n,)
    """
    z, s = log_ratio, noise_ratio
    inside = _normal_cdf((-z - s**2) / s) - _normal_cdf((_LOG_WORN - z - s**2) / s)
    return _WEAR_DENSITY * np.exp(z + s**2 / 2.0) * np.maximum(inside, 0.0)


def estimate_survival(log_ratio: FloatArray, *, noise_ratio: float) -> FloatArray:
    """Return the probability that ln(estimate / mu_new) of one vehicle lies above some values.

    The integral of `estimate_density` from z upwards, by parts:
    `5 [Phi(-z/s) - 0.8 Phi((ln 0.8 - z)/s)] - f(z)`.

    Args:
        log_ratio: z. (n,)
        noise_ratio: s, standard deviation of the relative error, above zero.

    Returns:
        The probability, falling with z from one to zero. (n,)
    """
    z, s = log_ratio, noise_ratio
    boundary = _normal_cdf(-z / s) - WORN_TYRE_RATIO * _normal_cdf((_LOG_WORN - z) / s)
    return np.clip(_WEAR_DENSITY * boundary - estimate_density(z, noise_ratio=s), 0.0, 1.0)


def noise_of_expected_error(
    expected_error_ratio: FloatArray, *, typical_ratio: float, lowest_ratio: float, highest_ratio: float
) -> FloatArray:
    """Return the standard deviation that an expected relative error stands for, within limits.

    Args:
        expected_error_ratio: Mean magnitude of the relative error a model expects of each estimate; NaN where it
            says nothing. (n,)
        typical_ratio: Expected error that stands in for NaN.
        lowest_ratio: Smallest standard deviation: nobody is believed to be surer.
        highest_ratio: Largest one; beyond, an estimate says hardly anything anyway.
    """
    said = np.where(np.isnan(expected_error_ratio), typical_ratio, expected_error_ratio)
    return np.clip(NOISE_PER_EXPECTED_ERROR_RATIO * said, lowest_ratio, highest_ratio)


def _normal_cdf(x: FloatArray) -> FloatArray:
    """Return the normal distribution function; numpy has none, and this is asked for once per table."""
    return np.array([0.5 * erfc(-value / sqrt(2.0)) for value in x.ravel().tolist()]).reshape(x.shape)

"""What an expected error means: split conformal prediction on the logarithm of friction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roadgrip.bundle import Conformal
from roadgrip.errors import RoadgripError
from roadgrip.units import FloatArray

GROUP_SHORTFALL_FRAC = 0.03
"""So much more seldom than among all passages what is said may hold within a group of them."""
FEWEST_OF_GROUP_COUNT = 200
"""A smaller group says too little about its next passage."""


def nonconformity_ratio(truth_mu: FloatArray, estimate_mu: FloatArray, expected_error_ratio: FloatArray) -> FloatArray:
    """Return how many expected errors each estimate is off, on the logarithm. (n,)

    Args:
        truth_mu: Positive. (n,)
        estimate_mu: Positive. (n,)
        expected_error_ratio: Positive. (n,)
    """
    return np.abs(np.log(truth_mu / estimate_mu)) / expected_error_ratio


def stated_nonconformity_ratio(
    truth_mu: FloatArray, estimate_mu: FloatArray, expected_error_ratio: FloatArray, *, doubtful_above_ratio: float
) -> FloatArray:
    """Return how many expected errors each statement is off: an "at least" only where there is less than it says. (n,)

    Args:
        truth_mu: Positive. (n,)
        estimate_mu: Positive. (n,)
        expected_error_ratio: Positive; above `doubtful_above_ratio` the statement is "at least". (n,)
        doubtful_above_ratio: See `roadgrip.bundle.Conformal`.
    """
    only_at_least = expected_error_ratio > doubtful_above_ratio
    judged_mu = np.where(only_at_least, np.minimum(truth_mu, estimate_mu), truth_mu)
    return nonconformity_ratio(judged_mu, estimate_mu, expected_error_ratio)


def conformal_of(
    truth_mu: FloatArray,
    estimate_mu: FloatArray,
    expected_error_ratio: FloatArray,
    *,
    coverage_frac: float,
    doubtful_above_ratio: float,
    groupings: Sequence[NDArray[np.intp]] = (),
) -> Conformal:
    """Return what turns expected errors into intervals that hold the truth as often as asked.

    Over new passages that are exchangeable with these, the interval holds the truth with a probability of at least
    `coverage_frac` (and at most 1/(n + 1) more). Passages of one road are not exchangeable with those of the next: give
    rows of roads of which neither model learned anything, and many of them.

    That is so among all of them. A model that knows little leans to the middle of what it learned, and is surest where
    it errs most: at both ends. So the interval becomes as wide as the worst of some groups needs it, to hold there
    at most `GROUP_SHORTFALL_FRAC` more seldom. The groups may go by the truth: no one has to tell them on the road.

    Args:
        truth_mu: Friction of the calibration's passages, of which neither model learned anything. (n,)
        estimate_mu: What the friction model says of them. (n,)
        expected_error_ratio: What the model of the error says of them. (n,)
        coverage_frac: How often the interval shall hold the truth.
        doubtful_above_ratio: See `roadgrip.bundle.Conformal`; within groups an "at least" is judged as one.
        groupings: For each way to group the passages, the number of each one's group; groups of fewer than
            `FEWEST_OF_GROUP_COUNT` count for nothing. Each (n,)

    Raises:
        RoadgripError: There are too few passages for so high a coverage, or a figure is not positive.

    References:
        Papadopoulos, Proedrou, Vovk, Gammerman, Inductive confidence machines for regression, 2002.
        Lei, G'Sell, Rinaldo, Tibshirani, Wasserman, Distribution-free predictive inference for regression, 2018,
        sections 2.2 and 5.2.
        Vovk, Conditional validity of inductive conformal predictors, 2012 (groups by the truth).
    """
    figures = np.concatenate([truth_mu, estimate_mu, expected_error_ratio])
    if not (np.isfinite(figures).all() and (figures > 0.0).all()):
        message = "friction, estimates and expected errors of a calibration must be positive"
        raise RoadgripError(message)
    scores = nonconformity_ratio(truth_mu, estimate_mu, expected_error_ratio)
    stated = stated_nonconformity_ratio(
        truth_mu, estimate_mu, expected_error_ratio, doubtful_above_ratio=doubtful_above_ratio
    )
    needed = [_quantile(scores, coverage_frac=coverage_frac)]
    for group in groupings:
        numbers, counts = np.unique(group, return_counts=True)
        needed += [
            _quantile(stated[group == number], coverage_frac=coverage_frac - GROUP_SHORTFALL_FRAC)
            for number in numbers[counts >= FEWEST_OF_GROUP_COUNT].tolist()
        ]
    return Conformal(coverage_frac=coverage_frac, quantile=max(needed), doubtful_above_ratio=doubtful_above_ratio)


def _quantile(scores: FloatArray, *, coverage_frac: float) -> float:
    # The rank among n + 1 exchangeable scores, the new one included; hence not the plain quantile of n.
    rank = int(np.ceil(coverage_frac * (len(scores) + 1)))
    if not 0 < rank <= len(scores):
        message = f"{len(scores)} passages are too few for a coverage of {coverage_frac:g}"
        raise RoadgripError(message)
    return float(np.sort(scores)[rank - 1])

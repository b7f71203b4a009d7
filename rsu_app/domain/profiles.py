"""Pooling what passages say about every friction, not only which one each likes best.

A passage that uses little of the grip leaves the friction open; its single best estimate is then drawn towards what is
usual, and a hundred such estimates are drawn the same way. Their likelihoods are not: a flat one adds nothing, and many
shallow ones add up to a sharp one. So the unit may sum the likelihood profiles of a window before it asks for a number.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import hypot, inf, log

import numpy as np

from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.interval import WORN_TYRE_RATIO
from rsu_app.domain.pooling import RefinedInterval, placement

_WEAR_STEPS = 22
_LOG_STEP_RATIO = -log(WORN_TYRE_RATIO) / _WEAR_STEPS
"""Step of the fine grid of ln mu, one per cent: a new and a worn tyre lie 22 steps apart."""
_FEWEST_POINTS = 4
"""Of a profile: a cubic has four coefficients."""
_OPEN_LOG_RATIO = 1.92
"""Half the 95 % quantile of chi-square: by so little below its peak, a log likelihood excludes nothing."""


@dataclass(frozen=True, slots=True)
class ProfilePolicy:
    """How far the profiles are believed.

    Attributes:
        temper_exponent: Each log likelihood is multiplied by this before pooling, above 0 and at most 1: a model of the
            vehicle that is somewhat wrong is surer than it should be.
        outlier_frac: Share of passages whose profile has nothing to do with the road.
        flat_log_ratio: Profiles whose log likelihood varies by less are counted as saying nothing.
        shared_log_ratio: A friction is excluded only where the summed log likelihood lies below its peak by what chance
            allows and by this for each passage besides. A model of the vehicle that is somewhat wrong is wrong for all
            of them alike, and what they share adds up as their number does.
        road_bias_ratio: Standard deviation of the error that all vehicles on one road share.
        confidence_frac: Probability asked of the half-width.
    """

    temper_exponent: float = 0.5
    outlier_frac: float = 0.05
    flat_log_ratio: float = 2.0
    shared_log_ratio: float = 0.1
    road_bias_ratio: float = 0.03
    confidence_frac: float = 0.95

    def __post_init__(self) -> None:
        if not 0.0 < self.temper_exponent <= 1.0:
            raise ValueError(f"a likelihood to the power {self.temper_exponent} is not a careful one")
        if not (0.0 < self.outlier_frac < 1.0 and 0.0 < self.confidence_frac < 1.0):
            raise ValueError("shares of outliers and confidence lie between 0 and 1")
        if min(self.flat_log_ratio, self.shared_log_ratio, self.road_bias_ratio) < 0.0:
            raise ValueError("a range and a bias are no less than zero")


def pooled_profile(
    log_likelihood_values: FloatArray, *, grid_mu: FloatArray, policy: ProfilePolicy
) -> RefinedInterval | None:
    """Return the interval that the profiles of a window place together, None without any.

    `at_least` is set when the sum does not exclude the upper end of the grid: then nothing bounds the friction from
    above, and `mu_new` is the least friction that is not excluded. Profiles that say nothing are counted as censored.

    Args:
        log_likelihood_values: One profile per line, each up to a constant of its own; finite. (n, k)
        grid_mu: Friction of the points, the tyre's own, ascending; at least four, from top to bottom a factor of
            more than 1.25. (k,)
        policy: How far the profiles are believed.
    """
    if len(log_likelihood_values) == 0:
        return None
    evidence_values = evidence_of_profiles(log_likelihood_values, grid_mu=grid_mu, policy=policy).sum(axis=0)
    informative_count = int(np.count_nonzero(says_something(log_likelihood_values, policy=policy)))
    return interval_of_evidence(
        evidence_values,
        grid_mu=grid_mu,
        informative_count=informative_count,
        flat_count=len(log_likelihood_values) - informative_count,
        policy=policy,
    )


def says_something(log_likelihood_values: FloatArray, *, policy: ProfilePolicy) -> BoolArray:
    """Return which profiles prefer some frictions to others. (n, k) in, (n,) out"""
    wide: BoolArray = np.ptp(log_likelihood_values, axis=1) >= policy.flat_log_ratio
    return wide


def evidence_of_profiles(
    log_likelihood_values: FloatArray, *, grid_mu: FloatArray, policy: ProfilePolicy
) -> FloatArray:
    """Return what each passage says about the friction of a new tyre, as logarithms that may simply be added up.

    The profile, to the power of the policy, is carried from the friction its tyre found to that of a new tyre by the
    mean over wear even in [0.8, 1], and mixed with the policy's share of outliers, for which every friction is alike.
    A unit may do this once when a passage comes, and keep the line.

    Between the points the log likelihood is a cubic spline in ln mu, which gives a parabola back exactly: points may
    be several times farther apart than a peak is wide, as long as its flanks are not cut off.

    Args:
        log_likelihood_values: One profile per line, each up to a constant of its own; finite. (n, k)
        grid_mu: Friction of the points, the tyre's own, ascending. (k,)
        policy: How far the profiles are believed.

    Returns:
        One line per passage, on the grid `new_tyre_grid_mu`. (n, m)
    """
    spline, log_tyre_mu = _spline(tuple(grid_mu.tolist()))
    fine = log_likelihood_values @ spline.T
    tempered = np.exp(policy.temper_exponent * (fine - fine.max(axis=1, keepdims=True)))
    tempered /= tempered.mean(axis=1, keepdims=True)
    # The density of ln wear grows as the wear itself. So the mean over wear is a moving sum of likelihood times
    # friction, by the trapezoidal rule, over the friction of the new tyre.
    tyre_mu = np.exp(log_tyre_mu)
    weighted = tempered * tyre_mu
    summed = np.cumsum(weighted, axis=1)
    last, first = summed[:, _WEAR_STEPS:], summed[:, :-_WEAR_STEPS]
    half_ends = (weighted[:, :-_WEAR_STEPS] - weighted[:, _WEAR_STEPS:]) / 2.0
    unit = np.cumsum(tyre_mu)
    norm = unit[_WEAR_STEPS:] - unit[:-_WEAR_STEPS] + (tyre_mu[:-_WEAR_STEPS] - tyre_mu[_WEAR_STEPS:]) / 2.0
    of_new = np.maximum(last - first + half_ends, 0.0) / norm
    evidence_values: FloatArray = np.log((1.0 - policy.outlier_frac) * of_new + policy.outlier_frac)
    return evidence_values


def new_tyre_grid_mu(grid_mu: FloatArray) -> FloatArray:
    """Return the frictions of a new tyre that can be judged: those all of whose worn ones lie on the grid. (m,)"""
    _, log_tyre_mu = _spline(tuple(grid_mu.tolist()))
    return np.exp(log_tyre_mu[_WEAR_STEPS:])


def interval_of_evidence(
    evidence_values: FloatArray,
    *,
    grid_mu: FloatArray,
    informative_count: int,
    flat_count: int,
    policy: ProfilePolicy,
) -> RefinedInterval:
    """Return the interval that the summed evidence of passages places, with an even prior in ln mu_new.

    Args:
        evidence_values: Sum of lines of `evidence_of_profiles`. (m,)
        grid_mu: The grid of the profiles. (k,)
        informative_count: Passages that said something.
        flat_count: Passages that did not.
        policy: How far the profiles are believed.
    """
    log_new_mu = np.log(new_tyre_grid_mu(grid_mu))
    placed = placement(evidence_values, log_mu=log_new_mu, confidence_frac=policy.confidence_frac)
    excluded_below = _OPEN_LOG_RATIO + policy.shared_log_ratio * (informative_count + flat_count)
    possible = evidence_values > evidence_values.max() - excluded_below
    open_above = bool(possible[-1])
    least_mu = float(np.exp(log_new_mu[int(np.argmax(possible))]))
    mu_new = min(least_mu, placed.low_mu) if open_above else placed.mu_new
    reach_mu = inf if open_above else max(placed.mu_new - placed.low_mu, placed.high_mu - placed.mu_new)
    return RefinedInterval(
        mu_low=WORN_TYRE_RATIO * mu_new,
        mu_new=mu_new,
        half_width_mu=hypot(reach_mu, 1.96 * policy.road_bias_ratio * mu_new),
        informative_count=informative_count,
        censored_count=flat_count,
        clipped=False,
        at_least=open_above,
    )


@lru_cache(maxsize=4)
def _spline(grid_mu: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the matrix from a profile's points to its cubic spline on an even grid of ln mu, and that grid.

    The third derivative is continuous at the second and the last but one point ("not a knot").

    References:
        de Boor, A Practical Guide to Splines, chapter IV.
    """
    knots: FloatArray = np.log(np.array(grid_mu, dtype=np.float64))
    count = len(knots)
    if count < _FEWEST_POINTS or not (np.diff(knots) > 0.0).all() or knots[-1] - knots[0] <= -log(WORN_TYRE_RATIO):
        raise ValueError("a profile needs four ascending frictions or more, the last above 1.25 times the first")
    h = np.diff(knots)
    # curvature = solve(left, right @ values): the tridiagonal system of the second derivatives.
    left, right = np.zeros((count, count)), np.zeros((count, count))
    for i in range(1, count - 1):
        left[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
        right[i, i - 1 : i + 2] = 6.0 / h[i - 1], -6.0 / h[i - 1] - 6.0 / h[i], 6.0 / h[i]
    left[0, :3] = -1.0 / h[0], 1.0 / h[0] + 1.0 / h[1], -1.0 / h[1]
    left[-1, -3:] = -1.0 / h[-2], 1.0 / h[-2] + 1.0 / h[-1], -1.0 / h[-1]
    curvature = np.linalg.solve(left, right)
    fine: FloatArray = knots[0] + _LOG_STEP_RATIO * np.arange(int((knots[-1] - knots[0]) / _LOG_STEP_RATIO + 1e-9) + 1)
    piece = np.clip(np.searchsorted(knots, fine, side="right") - 1, 0, count - 2)
    width = h[piece][:, None]
    right_share = (fine - knots[piece])[:, None] / width
    left_share = 1.0 - right_share
    values, at = np.eye(count), piece
    matrix: FloatArray = (
        left_share * values[at]
        + right_share * values[at + 1]
        + (left_share**3 - left_share) * width**2 / 6.0 * curvature[at]
        + (right_share**3 - right_share) * width**2 / 6.0 * curvature[at + 1]
    )
    return matrix, fine

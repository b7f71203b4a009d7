"""A second opinion beside the published median: what the window's estimates say when all that is known of them is used.

The median asks nothing of the estimates but their order. Here each enters with its own expected error; one that says
"at least" enters as that; and the shape of the interval, wear spread over [0.8, 1] mu_new, sharpens what they say
together. That wins about a third of the error from honest vehicles and loses to liars what the median keeps, so the
result is held within a few per cent of the median: the best of the one at nearly the price of the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, hypot, inf, log, nan

import numpy as np

from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.interval import (
    MEDIAN_TYRE_RATIO,
    WORN_TYRE_RATIO,
    median_ranks,
    mu_low_of_median,
    ranks_despite_liars,
)
from rsu_app.domain.wear import estimate_density, estimate_survival, noise_of_expected_error
from rsu_app.domain.window import WindowRows

LOG_STEP_RATIO = 0.005
"""Step of the grid of ln mu: a quarter of the smallest noise that is believed."""
_HALF_BINS = 300
"""Estimates are binned from exp(-1.5) to exp(1.5) times their median; what lies beyond is an outlier either way."""
_HALF_GRID = 80
"""mu_new is looked for from exp(-0.4) to exp(0.4) times what the median places."""
_NOISE_LEVELS = 14
_OUTLIER_DENSITY = 0.3
"""An outlier lies anywhere between 0.05 and 1.5, evenly in ln mu."""
_HALF_IS_REACHED = 1e-9
"""Rounding of a product of a window's ratios."""


@dataclass(frozen=True, slots=True)
class PoolingPolicy:
    """What is assumed about the estimates of a window.

    Attributes:
        typical_error_ratio: Mean relative error of an estimate whose model expects none.
        lowest_noise_ratio: No passage is believed to be more exact than this standard deviation.
        highest_noise_ratio: None is taken to be less exact.
        named_frac: Share of passages that must name a friction; with fewer, only a lower bound is placed. Those few are
            not like the rest, or they would not be the only ones that know.
        outlier_frac: Share of estimates that have nothing to do with the road.
        clip_frac: How far the result may lie from what the median places.
        lead_frac: How far a window's result may lie above the plain median of all its estimates. Where most honest
            vehicles only know a bound, the few that name a friction decide alone; three liars in ten could then claim
            dry asphalt on ice, and would be believed. Honest windows lead by more than this one time in twenty.
        road_bias_ratio: Standard deviation of the error that all vehicles on one road share, at least.
        shared_error_frac: The same as a share of the mean error that the estimates expect of themselves: where a
            regressor is unsure of one vehicle, it is for reasons that the next one on this road has, too.
        liars_frac: Share of vehicles against which the half-width must hold whatever they say, below a half.
        confidence_frac: Probability asked of the half-width.
    """

    typical_error_ratio: float = 0.05
    lowest_noise_ratio: float = 0.02
    highest_noise_ratio: float = 0.4
    named_frac: float = 0.4
    outlier_frac: float = 0.05
    clip_frac: float = 0.02
    lead_frac: float = 0.05
    road_bias_ratio: float = 0.03
    shared_error_frac: float = 0.75
    liars_frac: float = 0.0
    confidence_frac: float = 0.95

    def __post_init__(self) -> None:
        if not 0.0 < self.lowest_noise_ratio < self.highest_noise_ratio:
            raise ValueError("the smallest noise must lie above zero and below the largest")
        if not self.typical_error_ratio > 0.0:
            raise ValueError(f"a typical error of {self.typical_error_ratio} is none")
        if not (0.0 < self.outlier_frac < 1.0 and 0.0 < self.confidence_frac < 1.0):
            raise ValueError("shares of outliers and confidence lie between 0 and 1")
        if not 0.0 < self.named_frac <= 1.0:
            raise ValueError("nobody places nothing, and no more than all can name a friction")
        if min(self.clip_frac, self.lead_frac, self.road_bias_ratio, self.shared_error_frac) < 0.0:
            raise ValueError("a clip, a lead and a bias are no less than zero")
        if not 0.0 <= self.liars_frac < 0.5:
            raise ValueError("no rule holds against half of the vehicles")


@dataclass(frozen=True, slots=True)
class RefinedInterval:
    """A friction interval that uses more than the order of the estimates; it stands beside the published one.

    Attributes:
        mu_low: Lower end, 0.8 mu_new.
        mu_new: Upper end, what a new tyre finds.
        half_width_mu: mu_new lies this near with the probability asked for, an error that all vehicles share
            included; infinite if nothing bounds it from above.
        informative_count: Estimates that name a friction.
        censored_count: Passages that only said "at least".
        clipped: Whether a median held the result back; often so means liars, or a wrong idea of their errors.
        at_least: Whether too few passages name a friction, so that `mu_new` and `mu_low` are lower bounds.
    """

    mu_low: float
    mu_new: float
    half_width_mu: float
    informative_count: int
    censored_count: int
    clipped: bool
    at_least: bool = False


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a posterior places mu_new: its middle and the ends of its credible interval."""

    mu_new: float
    low_mu: float
    high_mu: float


def kaplan_meier_median_mu(mu: FloatArray, at_least: BoolArray) -> float | None:
    """Return the median of what the vehicles found when some only know a lower bound, None if the bounds hide it.

    Without bounds it is the plain median, the mean of the middle two for an even number. A bound counts for every
    friction below it and says nothing about what lies above; where a friction and a bound are equal, the friction
    comes first. Right as long as what a vehicle found does not decide by itself whether it only gives a bound.

    Args:
        mu: Estimates, and bounds where `at_least`; above zero. (n,)
        at_least: Which of them are bounds. (n,)

    References:
        Kaplan and Meier, Nonparametric estimation from incomplete observations, JASA 53 (1958) 457-481.
    """
    order = np.lexsort((at_least, mu))
    values, named = mu[order], ~at_least[order]
    at_risk = np.arange(len(values), 0, -1)
    above = np.cumprod(np.where(named, 1.0 - 1.0 / at_risk, 1.0))
    reached = np.flatnonzero(named & (above <= 0.5 + _HALF_IS_REACHED))
    if not len(reached):
        return None
    first = reached[0]
    if above[first] < 0.5 - _HALF_IS_REACHED or len(reached) == 1:
        return float(values[first])
    return float((values[first] + values[reached[1]]) / 2.0)


def placing_median_mu(mu: FloatArray, at_least: BoolArray) -> tuple[float, bool]:
    """Return the median that places the interval, and whether it is a lower bound only.

    If the bounds hide the median, the median of all values is a bound for it: each vehicle found at least its value.

    Args:
        mu: Estimates, and bounds where `at_least`, at least one. (n,)
        at_least: Which of them are bounds. (n,)
    """
    median_mu = kaplan_meier_median_mu(mu, at_least)
    return (float(np.median(mu)), True) if median_mu is None else (median_mu, False)


@dataclass(frozen=True, slots=True)
class Support:
    """How far the vehicles of a window know the friction.

    Attributes:
        named_count: Those that name one.
        censored_count: Those that only say "at least".
        at_least: Whether so few name a friction that the window only gives a lower bound.
        bound_mu: What the median tyre finds, at least so much where `at_least`.
        median_mu: Median of all, bounds taken for what they say. The median tyre finds at least this, too, and no few
            vehicles can raise it, whatever they say.
        named_mu: Median of those that name one; NaN without any.
    """

    named_count: int
    censored_count: int
    at_least: bool
    bound_mu: float
    median_mu: float
    named_mu: float

    @property
    def least_mu_low(self) -> float:
        """What a worn tyre finds at least by the median of all."""
        return mu_low_of_median(self.median_mu)

    @property
    def named_mu_low(self) -> float:
        """What a worn tyre finds by those that name a friction; NaN without any."""
        return mu_low_of_median(self.named_mu)


def support(mu: FloatArray, at_least: BoolArray, *, policy: PoolingPolicy) -> Support | None:
    """Return how far some vehicles know the friction, None without any.

    The bound is the larger of two. Each vehicle found at least its value, so the median of all values is one. The
    lower end of the confidence interval that those give who name a friction is another: they are not those on the best
    tyres, and no number of vehicles that know nothing can lower it.

    Args:
        mu: Estimates, and bounds where `at_least`; finite, above zero. (n,)
        at_least: Which of them are bounds. (n,)
        policy: What is assumed.
    """
    if len(mu) == 0:
        return None
    named = np.sort(mu[~at_least])
    bound_mu, hidden = placing_median_mu(mu, at_least)
    doubtful = hidden or len(named) < policy.named_frac * len(mu)
    median_mu = float(np.median(mu))
    if doubtful:
        bound_mu = median_mu
        if len(named):
            ranks = median_ranks(len(named), confidence_frac=policy.confidence_frac)
            sure = ranks.coverage_frac >= policy.confidence_frac
            bound_mu = max(bound_mu, float(named[ranks.low_rank - 1])) if sure else bound_mu
    return Support(
        named_count=len(named),
        censored_count=len(mu) - len(named),
        at_least=doubtful,
        bound_mu=bound_mu,
        median_mu=median_mu,
        named_mu=float(np.median(named)) if len(named) else nan,
    )


def posterior_placement(
    mu: FloatArray, *, expected_error_ratio: FloatArray, at_least: BoolArray, median_mu: float, policy: PoolingPolicy
) -> Placement:
    """Return where the estimates place mu_new if they are what the policy assumes.

    Even in ln mu_new before, and with each estimate y of noise s multiplied by
    `(1 - q) f(ln y - ln mu_new; s) + q * 0.3`, or for a bound by `(1 - q) S(ln y - ln mu_new; s) + q`, where f and S
    are `rsu_app.domain.wear` and q is the share of outliers. So one absurd value weighs at most as much as its being
    an outlier is worth. The middle is the posterior's median.

    The estimates are sorted into bins of half a per cent about their median and 14 levels of noise, each shared by its
    four neighbours; whatever their number, the rest is one correlation per level.

    Args:
        mu: Estimates, and bounds where `at_least`; at least one, above zero. (n,)
        expected_error_ratio: What the model expects of each; NaN where it says nothing. (n,)
        at_least: Which of them are bounds. (n,)
        median_mu: About which the grid is laid: mu_new is looked for within a third of what it places.
        policy: What is assumed.
    """
    tables = _tables(policy.lowest_noise_ratio, policy.highest_noise_ratio, policy.outlier_frac)
    noise_ratio = noise_of_expected_error(
        expected_error_ratio,
        typical_ratio=policy.typical_error_ratio,
        lowest_ratio=policy.lowest_noise_ratio,
        highest_ratio=policy.highest_noise_ratio,
    )
    level_span = log(policy.highest_noise_ratio / policy.lowest_noise_ratio) / (_NOISE_LEVELS - 1)
    level = np.log(noise_ratio / policy.lowest_noise_ratio) / level_span
    place = np.clip(np.log(mu / median_mu) / LOG_STEP_RATIO, -_HALF_BINS, _HALF_BINS) + _HALF_BINS
    log_posterior_weights: FloatArray = np.zeros(2 * _HALF_GRID + 1)
    for kind in np.unique(at_least).tolist():
        chosen = at_least == kind
        counts = _binned(level[chosen], place[chosen])
        for row in np.flatnonzero(counts.any(axis=1)):
            # Correlation runs from the largest mu_new to the smallest.
            log_posterior_weights += np.correlate(tables[int(kind), row], counts[row], mode="valid")[::-1]
    log_mu = _GRID_LOG_RATIO + log(median_mu / MEDIAN_TYRE_RATIO)
    return placement(log_posterior_weights, log_mu=log_mu, confidence_frac=policy.confidence_frac)


def placement(log_posterior_weights: FloatArray, *, log_mu: FloatArray, confidence_frac: float) -> Placement:
    """Return the middle and the credible ends of a posterior on an even grid of ln mu_new.

    Args:
        log_posterior_weights: Logarithm of the posterior, up to a constant. (k,)
        log_mu: The grid, ascending in even steps. (k,)
        confidence_frac: Probability between the ends.
    """
    mass = np.exp(log_posterior_weights - log_posterior_weights.max())
    mass /= mass.sum()
    # Each mass fills its cell evenly, so quantiles move smoothly with the data.
    edges = np.concatenate([log_mu - (log_mu[1] - log_mu[0]) / 2.0, [log_mu[-1] + (log_mu[1] - log_mu[0]) / 2.0]])
    below = np.concatenate([[0.0], np.cumsum(mass)])
    beyond = (1.0 - confidence_frac) / 2.0
    low, middle, high = np.exp(np.interp([beyond, 0.5, 1.0 - beyond], below, edges)).tolist()
    return Placement(mu_new=middle, low_mu=low, high_mu=high)


def refined_interval(
    mu: FloatArray, *, expected_error_ratio: FloatArray, at_least: BoolArray, policy: PoolingPolicy
) -> RefinedInterval | None:
    """Return the interval that the estimates place when all that is known of them is used, None without any.

    Whatever the order of the estimates. Scaling them all scales the interval. A further "at least" never lowers it.

    Args:
        mu: Estimates, and bounds where `at_least`; finite, above zero. (n,)
        expected_error_ratio: What the model expects of each; NaN where it says nothing. (n,)
        at_least: Which of them are bounds. (n,)
        policy: What is assumed.
    """
    known = support(mu, at_least, policy=policy)
    if known is None:
        return None
    placed_mu = known.bound_mu / MEDIAN_TYRE_RATIO
    if known.at_least:
        return RefinedInterval(
            mu_low=WORN_TYRE_RATIO * placed_mu,
            mu_new=placed_mu,
            half_width_mu=inf,
            informative_count=known.named_count,
            censored_count=known.censored_count,
            clipped=False,
            at_least=True,
        )
    free = posterior_placement(
        mu, expected_error_ratio=expected_error_ratio, at_least=at_least, median_mu=known.bound_mu, policy=policy
    )
    lowest_mu, highest_mu = placed_mu * (1.0 - policy.clip_frac), placed_mu * (1.0 + policy.clip_frac)
    mu_new = min(max(free.mu_new, lowest_mu), highest_mu)
    # Held back, mu_new no longer is the middle of what is credible: the half-width reaches the farther end.
    reach_mu = max(mu_new - free.low_mu, free.high_mu - mu_new)
    if policy.liars_frac > 0.0:
        low_mu, high_mu = bounds_despite_liars(mu, at_least, policy=policy)
        reach_mu = max(reach_mu, mu_new - low_mu / MEDIAN_TYRE_RATIO, high_mu / MEDIAN_TYRE_RATIO - mu_new)
    return RefinedInterval(
        mu_low=WORN_TYRE_RATIO * mu_new,
        mu_new=mu_new,
        half_width_mu=hypot(reach_mu, 1.96 * _shared_ratio(expected_error_ratio[~at_least], policy) * mu_new),
        informative_count=known.named_count,
        censored_count=known.censored_count,
        clipped=mu_new != free.mu_new,
    )


def _shared_ratio(expected_error_ratio: FloatArray, policy: PoolingPolicy) -> float:
    """Return the standard deviation of the error that all vehicles share, by what those that name a friction expect."""
    said = np.where(np.isnan(expected_error_ratio), policy.typical_error_ratio, expected_error_ratio)
    return max(policy.road_bias_ratio, policy.shared_error_frac * float(said.mean()))


def refined_interval_of_window(rows: WindowRows, *, policy: PoolingPolicy) -> RefinedInterval | None:
    """Return the refined interval of what a window holds, None without any.

    A doubtful entry counts with its bound. That bound holds with the coverage the model promises, so its error is in
    it already, and none is added. The result is never far above the plain median of all estimates, doubtful ones
    included: that is what liars can move least, and too high is the dangerous side.

    Args:
        rows: The window's entries.
        policy: What is assumed.
    """
    free = refined_interval(
        np.where(rows.at_least, rows.mu_low, rows.mu),
        expected_error_ratio=np.where(rows.at_least, 0.0, rows.expected_error_ratio),
        at_least=rows.at_least,
        policy=policy,
    )
    if free is None:
        return None
    highest_mu = (1.0 + policy.lead_frac) * float(np.median(rows.mu)) / MEDIAN_TYRE_RATIO
    if free.mu_new <= highest_mu:
        return free
    # What is held back still is in the half-width.
    return replace(
        free,
        mu_low=WORN_TYRE_RATIO * highest_mu,
        mu_new=highest_mu,
        half_width_mu=free.half_width_mu + free.mu_new - highest_mu,
        clipped=True,
    )


def support_of_window(rows: WindowRows, *, policy: PoolingPolicy) -> Support | None:
    """Return how far the vehicles of a window know the friction, None without any; a doubtful one by its bound."""
    return support(np.where(rows.at_least, rows.mu_low, rows.mu), rows.at_least, policy=policy)


def bounds_despite_liars(mu: FloatArray, at_least: BoolArray, *, policy: PoolingPolicy) -> tuple[float, float]:
    """Return values that enclose the honest median whatever a share of the vehicles says; maybe 0 and infinity.

    The ranks are those of the honest ones alone, on the sample of all. A bound stands for itself at the lower end and
    for infinity at the upper.

    Args:
        mu: Estimates, and bounds where `at_least`, at least one. (n,)
        at_least: Which of them are bounds. (n,)
        policy: The share of liars and the probability asked for.
    """
    liars_count = ceil(policy.liars_frac * len(mu))
    if liars_count >= len(mu):
        return 0.0, inf
    ranks = ranks_despite_liars(len(mu), liars_count=liars_count, confidence_frac=policy.confidence_frac)
    highest = np.sort(np.where(at_least, inf, mu))
    return float(np.sort(mu)[ranks.low_rank - 1]), float(highest[ranks.high_rank - 1])


_GRID_LOG_RATIO: FloatArray = LOG_STEP_RATIO * np.arange(-_HALF_GRID, _HALF_GRID + 1, dtype=np.float64)


def _binned(level: FloatArray, place: FloatArray) -> FloatArray:
    """Return how many estimates lie at each level and place, each shared by its four neighbours. (levels, bins)"""
    bins = 2 * _HALF_BINS + 1
    row = np.minimum(level.astype(np.intp), _NOISE_LEVELS - 2)
    column = np.minimum(place.astype(np.intp), bins - 2)
    up, right = level - row, place - column
    corners = ((0, 0, (1 - up) * (1 - right)), (0, 1, (1 - up) * right), (1, 0, up * (1 - right)), (1, 1, up * right))
    index = np.concatenate([(row + i) * bins + column + j for i, j, _ in corners])
    shares = np.concatenate([share for _, _, share in corners])
    counts: FloatArray = np.bincount(index, weights=shares, minlength=_NOISE_LEVELS * bins).astype(np.float64)
    return counts.reshape(_NOISE_LEVELS, bins)


@lru_cache(maxsize=4)
def _tables(lowest_noise_ratio: float, highest_noise_ratio: float, outlier_frac: float) -> FloatArray:
    """Return the log likelihoods of an estimate and of a bound: (2, levels, differences of bin and grid)."""
    steps = np.arange(-_HALF_BINS - _HALF_GRID, _HALF_BINS + _HALF_GRID + 1, dtype=np.float64)
    log_ratio: FloatArray = LOG_STEP_RATIO * steps + log(MEDIAN_TYRE_RATIO)
    levels = np.geomspace(lowest_noise_ratio, highest_noise_ratio, _NOISE_LEVELS).tolist()
    named = [estimate_density(log_ratio, noise_ratio=noise_ratio) for noise_ratio in levels]
    bounds = [estimate_survival(log_ratio, noise_ratio=noise_ratio) for noise_ratio in levels]
    named_log = np.log((1.0 - outlier_frac) * np.array(named) + outlier_frac * _OUTLIER_DENSITY)
    return np.array([named_log, np.log((1.0 - outlier_frac) * np.array(bounds) + outlier_frac)])

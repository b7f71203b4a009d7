"""From a window of estimates to the friction interval of a section.

The road has one friction, tyres differ: a worn-out tyre finds about 0.8 of what a new one finds. So the unit
publishes the interval [0.8 mu_new, mu_new], and places it by the median of the vehicles that passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from roadgrip.records import Confidence, FrictionInterval

WORN_TYRE_RATIO = 0.8
"""Friction of a badly worn tyre over that of a new one of the same type (the paper, "interval of friction")."""
MEDIAN_TYRE_RATIO = (1.0 + WORN_TYRE_RATIO) / 2.0
"""The median vehicle sits in the middle of the interval if wear is spread symmetrically over it."""


@dataclass(frozen=True, slots=True)
class IntervalPolicy:
    """What the operator decides about the interval.

    Attributes:
        provisional_from_count: Vehicles from which the interval is provisional; below it is insufficient.
        recommended_from_count: Vehicles from which it is recommended; the paper states its accuracy for fifty.
        confidence_frac: Probability asked of the confidence interval of the median.
        stale_after_s: Age of the newest vehicle from which nothing is known about the road as it is now.
        valid_at_most_s: Longest time an interval may be used after it was read.
    """

    provisional_from_count: int = 10
    recommended_from_count: int = 50
    confidence_frac: float = 0.95
    stale_after_s: float = 1800.0
    valid_at_most_s: float = 300.0

    def __post_init__(self) -> None:
        if not 0 < self.provisional_from_count <= self.recommended_from_count:
            raise ValueError("an interval becomes provisional before it is recommended, and never without a vehicle")
        if not 0.0 < self.confidence_frac < 1.0:
            raise ValueError(f"a confidence of {self.confidence_frac} is not between 0 and 1")
        if not (self.stale_after_s > 0.0 and self.valid_at_most_s > 0.0):
            raise ValueError("an interval must be valid for some time")


@dataclass(frozen=True, slots=True)
class MedianRanks:
    """Which order statistics enclose the true median, and how surely.

    Attributes:
        low_rank: Rank of the lower end, counted from 1.
        high_rank: Rank of the upper end, n + 1 - low_rank.
        coverage_frac: Probability that they enclose the median of the population.
    """

    low_rank: int
    high_rank: int
    coverage_frac: float


@lru_cache(maxsize=1024)
def median_ranks(count: int, *, confidence_frac: float) -> MedianRanks:
    """Return the narrowest symmetric pair of ranks that encloses the true median with at least a given probability.

    Whatever the distribution, as long as it is continuous and the values are independent: the number of values below
    the true median is binomial(n, 1/2), so ranks j and n + 1 - j enclose it with probability
    1 - 2 P(B <= j - 1). With too few values even the extremes fall short; then they are returned with the coverage
    they have, down to 0 for a single value.

    Args:
        count: Number of values, at least 1.
        confidence_frac: Probability asked for, between 0 and 1.

    References:
        David and Nagaraja, Order Statistics, 3rd edition, section 7.1.
    """
    if count < 1:
        raise ValueError("no values have no ranks")
    # Binomial probabilities up to n/2 by their recurrence, as logarithms: 2^-n underflows beyond a thousand.
    k = np.arange(count // 2)
    log_pmf = np.concatenate([[0.0], np.cumsum(np.log((count - k) / (k + 1.0)))]) - count * np.log(2.0)
    tail = np.cumsum(np.exp(log_pmf))
    low_rank = max(1, int(np.searchsorted(tail, (1.0 - confidence_frac) / 2.0, side="right")))
    low_rank = min(low_rank, (count + 1) // 2)
    coverage_frac = max(0.0, 1.0 - 2.0 * float(tail[low_rank - 1]))
    return MedianRanks(low_rank=low_rank, high_rank=count + 1 - low_rank, coverage_frac=coverage_frac)


def ranks_despite_liars(count: int, *, liars_count: int, confidence_frac: float) -> MedianRanks:
    """Return ranks of the whole sample that enclose the median of the honest whatever the others say.

    Of n values k are arbitrary and n - k independent draws. The j-th of the honest lies between the j-th and the
    (j + k)-th of all; so if ranks j and n - k + 1 - j enclose the true median among the honest alone, ranks j and
    n + 1 - j do so among all.

    Args:
        count: Number of values, honest and not.
        liars_count: k, how many may be arbitrary, fewer than all.
        confidence_frac: Probability asked for, between 0 and 1.
    """
    if not 0 <= liars_count < count:
        raise ValueError(f"{liars_count} liars among {count} leave nobody to believe")
    honest = median_ranks(count - liars_count, confidence_frac=confidence_frac)
    return MedianRanks(
        low_rank=honest.low_rank, high_rank=count + 1 - honest.low_rank, coverage_frac=honest.coverage_frac
    )


def median_of_ordered(ordered_mu: Sequence[float]) -> float:
    """Return the median of values that are sorted already, at least one."""
    middle = len(ordered_mu) // 2
    if len(ordered_mu) % 2:
        return ordered_mu[middle]
    return (ordered_mu[middle - 1] + ordered_mu[middle]) / 2.0


def mu_low_of_median(median_mu: float) -> float:
    """Return the lower end of the interval that a median places: what a worn tyre finds."""
    return WORN_TYRE_RATIO * median_mu / MEDIAN_TYRE_RATIO


def confidence_of(count: int, *, policy: IntervalPolicy) -> Confidence:
    """Return how far an interval may be trusted that rests on so many vehicles."""
    if count >= policy.recommended_from_count:
        return Confidence.RECOMMENDED
    if count >= policy.provisional_from_count:
        return Confidence.PROVISIONAL
    return Confidence.INSUFFICIENT


def friction_interval(
    ordered_mu: Sequence[float], *, newest_age_s: float, policy: IntervalPolicy
) -> FrictionInterval | None:
    """Return the friction interval that estimates place, or None without any.

    It is valid until its newest vehicle would be stale, and never longer than the policy says; a stale one is
    returned with `valid_for_s` zero, for the record.

    Args:
        ordered_mu: Counted estimates of the window from smallest to largest.
        newest_age_s: Time since the last of those vehicles left the section.
        policy: What the operator decides.

    References:
        Langstrand and Rabi, Learning to cooperatively estimate road surface friction, section "Combining": the
        median places the midpoint of [0.8 mu_new, mu_new], hence mu_new = median / 0.9.
    """
    count = len(ordered_mu)
    if count == 0:
        return None
    median_mu = median_of_ordered(ordered_mu)
    ranks = median_ranks(count, confidence_frac=policy.confidence_frac)
    return FrictionInterval(
        mu_low=mu_low_of_median(median_mu),
        mu_new=median_mu / MEDIAN_TYRE_RATIO,
        median_mu=median_mu,
        median_low_mu=ordered_mu[ranks.low_rank - 1],
        median_high_mu=ordered_mu[ranks.high_rank - 1],
        coverage_frac=ranks.coverage_frac,
        passages_count=count,
        confidence=confidence_of(count, policy=policy),
        newest_age_s=newest_age_s,
        valid_for_s=min(policy.valid_at_most_s, max(0.0, policy.stale_after_s - newest_age_s)),
    )

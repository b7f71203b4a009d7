"""The rules for a friction interval that are compared: from what vehicles said to the middle of the interval."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import nan
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from roadgrip.units import FloatArray
from rsu_app.domain.interval import MEDIAN_TYRE_RATIO, WORN_TYRE_RATIO, median_of_ordered
from rsu_app.domain.pooling import PoolingPolicy, RefinedInterval, placing_median_mu, refined_interval
from rsu_app.domain.wear import NOISE_PER_EXPECTED_ERROR_RATIO
from training.regressor import RowIndices
from training.study.batches import Rule
from training.study.generalise.passages import Passages

PassageRule: TypeAlias = Callable[[Passages], float]
"""From what vehicles said, at least one, to the middle of the friction interval."""

POLICY = PoolingPolicy()
"""As a unit would have it."""
FREE_POLICY = replace(POLICY, clip_frac=10.0)
"""Without the median that holds it."""
LOOSE_POLICY = replace(POLICY, clip_frac=0.04)

MEDIAN = "median (published)"
KAPLAN_MEIER = "Kaplan-Meier median"
WEIGHTED = "mean by expected error"
POSTERIOR = "posterior"
LOOSE = "posterior within 4 % of the median"
REFINED = "posterior within 2 % of the median"

# The spread of wear that is even in [0.8, 1], relative to its middle.
_WEAR_SPREAD_RATIO = (1.0 - WORN_TYRE_RATIO) / np.sqrt(12.0) / MEDIAN_TYRE_RATIO


def median_mu(passages: Passages) -> float:
    """Return the plain median, as it is published: bounds pass for estimates."""
    return median_of_ordered(np.sort(passages.mu).tolist())


def kaplan_meier_mu(passages: Passages) -> float:
    """Return the median that knows a bound for what it is; without enough estimates, the median of all values."""
    return placing_median_mu(passages.mu, passages.at_least)[0]


def weighted_mean_mu(passages: Passages) -> float:
    """Return the mean of ln mu, each estimate weighing by what wear and its own error spread it; bounds are left out.

    Without any estimate, the median of the bounds.
    """
    named = ~passages.at_least
    if not named.any():
        return median_mu(passages)
    noise = NOISE_PER_EXPECTED_ERROR_RATIO * passages.expected_error_ratio[named]
    weight = 1.0 / (_WEAR_SPREAD_RATIO**2 + noise**2)
    return float(np.exp(np.average(np.log(passages.mu[named]), weights=weight)))


def posterior_mu(passages: Passages) -> float:
    """Return where the posterior of known wear and known errors places the middle, whatever the median says."""
    return MEDIAN_TYRE_RATIO * interval_of(passages, policy=FREE_POLICY).mu_new


def loose_mu(passages: Passages) -> float:
    """Return the same, held within 4 % of the median."""
    return MEDIAN_TYRE_RATIO * interval_of(passages, policy=LOOSE_POLICY).mu_new


def refined_mu(passages: Passages) -> float:
    """Return the same, held within 2 % of the median: what a unit would show beside the published interval."""
    return MEDIAN_TYRE_RATIO * interval_of(passages, policy=POLICY).mu_new


def refined_or_nothing_mu(passages: Passages) -> float:
    """Return the same, NaN where so few name a friction that it would only be a bound."""
    interval = interval_of(passages, policy=POLICY)
    return nan if interval.at_least else MEDIAN_TYRE_RATIO * interval.mu_new


RULES: Mapping[str, PassageRule] = MappingProxyType(
    {
        MEDIAN: median_mu,
        KAPLAN_MEIER: kaplan_meier_mu,
        WEIGHTED: weighted_mean_mu,
        POSTERIOR: posterior_mu,
        LOOSE: loose_mu,
        REFINED: refined_mu,
    }
)


def interval_of(passages: Passages, *, policy: PoolingPolicy) -> RefinedInterval:
    """Return the refined interval of some passages, at least one."""
    interval = refined_interval(
        passages.mu, expected_error_ratio=passages.expected_error_ratio, at_least=passages.at_least, policy=policy
    )
    if interval is None:
        raise ValueError("no passages, no interval")
    return interval


def rule_on_rows(rule: PassageRule, passages: Passages) -> Rule:
    """Return a rule that answers for rows of a table, as batches are drawn from it.

    Args:
        rule: The rule.
        passages: One for every row of the table.
    """
    return lambda rows: rule(passages.rows(rows))


def relative_errors(
    rule: PassageRule, drawn: Callable[[np.random.Generator], Passages], *, mu_new: float, seeds: RowIndices
) -> FloatArray:
    """Return the signed errors of a rule, relative to the true middle; every rule sees the same draws. (seeds,)

    Args:
        rule: What answers.
        drawn: Draws a window.
        mu_new: The truth: what a new tyre finds.
        seeds: One window each. (seeds,)
    """
    middle_mu = MEDIAN_TYRE_RATIO * mu_new
    return np.array([rule(drawn(np.random.default_rng(seed))) / middle_mu - 1.0 for seed in seeds.tolist()])

"""Has traffic moved away from what a model was trained on, or from what a section saw before?

Every value is first told as a level: which share of the reference lies below it. Traffic like the reference then has
levels that are spread evenly from 0 to 1, whatever the feature, so that features of any unit are compared alike, and
rows that are held against different references can be judged together. That is how weather is kept out of it: rain
moves nearly every feature of a drive, and to measure that is what the system is for. A section's own earlier traffic
is therefore kept by bands of friction (`rsu_app.domain.section_baseline`), and a passage is held against those alone
that found about as much grip. docs/drift.md says what raises an alarm and what is only reported, with figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isnan, sqrt
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from roadgrip.bundle import TrainingReference
from roadgrip.units import FloatArray

BINS_COUNT = 10
"""Equally likely bins of the population stability index, as is usual for it."""
_CHI_SQUARE_99 = 21.666
"""What a chi-square variable of BINS_COUNT - 1 degrees of freedom exceeds with a probability of 1 %."""
_KOLMOGOROV_99 = 1.628
"""What the square root of n times a Kolmogorov-Smirnov distance exceeds with a probability of 1 %."""
_NORMAL_99 = 2.326
"""What a standard normal variable exceeds with a probability of 1 %."""
_EMPTY_BIN_COUNT = 0.5
"""Added to every bin, so that an empty one has a logarithm."""


Held: TypeAlias = tuple[Sequence[Sequence[float]] | FloatArray | NDArray[np.float32], int, FloatArray]
"""Quantiles of each feature, how many rows of the reference they tell of, and the rows that are held against them."""


class DriftAlarm(StrEnum):
    """Why somebody should look; the value is told in metrics and in the status."""

    OUT_OF_ENVELOPE = "out_of_envelope"
    OWN_TRAFFIC = "own_traffic"
    ESTIMATES_OUTSIDE = "estimates_outside"


@dataclass(frozen=True, slots=True)
class DriftPolicy:
    """From where on something has drifted. All limits come with what chance alone does to so few passages.

    Attributes:
        psi_limit_ratio: A population stability index above it counts: the usual bound of "a major shift".
        ks_limit_frac: So must the Kolmogorov-Smirnov distance be above this, for the index alone reacts to a single
            bin.
        rows_least_count: With fewer passages nothing is judged.
        own_drifted_limit_frac: Share of the features that must have drifted against the section's own earlier traffic
            for an alarm. They hang together, so chance moves many at once or none.
        out_of_envelope_limit_frac: Share of passages outside the model's envelope that is borne.
        estimates_outside_limit_frac: Share of estimates beyond all of the training's that is borne.
    """

    psi_limit_ratio: float = 0.25
    ks_limit_frac: float = 0.15
    rows_least_count: int = 30
    own_drifted_limit_frac: float = 0.15
    out_of_envelope_limit_frac: float = 0.1
    estimates_outside_limit_frac: float = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class BandReference:
    """How traffic that found about as much grip was distributed.

    Attributes:
        mu_low: Estimates from here on
        mu_high: and below this belong to it.
        rows_count: Passages it tells of.
        quantile_values: Of each kinematic feature, at evenly spaced levels from 0 to 1. (k, levels)
    """

    mu_low: float
    mu_high: float
    rows_count: int
    quantile_values: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class FeatureDrift:
    """How far one feature, or the estimate, is from its reference.

    Attributes:
        name: Of the feature.
        psi_ratio: Population stability index; NaN without a finite value.
        ks_frac: Kolmogorov-Smirnov distance; NaN likewise.
        drifted: Both are above their limits, and above what chance does.
    """

    name: str
    psi_ratio: float
    ks_frac: float
    drifted: bool


@dataclass(frozen=True, slots=True)
class DriftReport:
    """What a window of passages says about drift.

    Attributes:
        rows_count: Passages with features.
        not_finite_count: Values among them that are no numbers; they are left out.
        own_road: The training's reference is of this very road, not of all roads together.
        features: Each feature against the training. Reported, no alarm: weather moves them, and so does a road. Empty
            without a reference or with too few passages.
        estimate: The estimates against those of the training; None likewise. Reported, no alarm.
        own_rows_count: Passages that could be held against the section's own earlier traffic of like friction.
        own_features: Each feature against that traffic; empty with too few such passages.
        total_count: Passages that were asked of the model, with or without a number for an answer.
        out_of_envelope_frac: Share of them outside the model's envelope; 0 without any.
        estimates_outside_frac: Share of estimates beyond all of the training's; 0 without any or without a reference.
        alarms: What somebody should look at.
    """

    rows_count: int
    not_finite_count: int
    own_road: bool
    features: tuple[FeatureDrift, ...]
    estimate: FeatureDrift | None
    own_rows_count: int
    own_features: tuple[FeatureDrift, ...]
    total_count: int
    out_of_envelope_frac: float
    estimates_outside_frac: float
    alarms: tuple[DriftAlarm, ...]

    @property
    def drifted_count(self) -> int:
        """Features that drifted against the training."""
        return sum(feature.drifted for feature in self.features)

    @property
    def own_drifted_count(self) -> int:
        """Features that drifted against the section's own earlier traffic."""
        return sum(feature.drifted for feature in self.own_features)


def worst(features: Sequence[FeatureDrift], count: int) -> tuple[FeatureDrift, ...]:
    """Return the features that moved most, at most so many, the worst first; those without a number are left out."""
    known = [feature for feature in features if not isnan(feature.psi_ratio)]
    return tuple(sorted(known, key=lambda each: (-each.psi_ratio, each.name))[:count])


def reference_levels(
    quantiles: Sequence[Sequence[float]] | FloatArray | NDArray[np.float32], values: FloatArray
) -> FloatArray:
    """Return which share of the reference lies below each value, linear between quantiles.

    What lies beyond all of the reference has the level 0 or 1. Where the reference holds one value many times, so that
    quantiles repeat, equal values are spread evenly over the levels it takes up: a feature that never changes, or has
    few values, has even levels like any other. The order of the rows does not matter, but for which of equal values
    gets which of these levels. No number in, NaN out.

    Args:
        quantiles: Of each feature, never falling, at evenly spaced levels from 0 to 1. (k, levels)
        values: In the order of the features. (n, k)

    Returns:
        Levels from 0 to 1. (n, k)
    """
    # Passages hold 32 bits; compared with more, equal values would differ.
    known = np.asarray(quantiles, dtype=np.float32)
    asked = np.asarray(values, dtype=np.float32)
    levels = np.empty(asked.shape)
    for column, line in enumerate(known):
        levels[:, column] = _levels_of(line, asked[:, column])
    return levels


def _levels_of(quantiles: NDArray[np.float32], values: NDArray[np.float32]) -> FloatArray:
    """Return the levels of one feature's values. (n,)"""
    steps_count = len(quantiles) - 1
    below = np.searchsorted(quantiles, values, side="left")
    until = np.searchsorted(quantiles, values, side="right")
    left, right = np.maximum(below - 1, 0), np.minimum(below, steps_count)
    low, high = quantiles[left].astype(np.float64), quantiles[right].astype(np.float64)
    part = np.divide(values - low, high - low, out=np.zeros(len(values)), where=high > low)
    levels: FloatArray = (left + np.clip(part, 0.0, 1.0) * (right - left)) / steps_count
    tied = until - below > 1
    for place in np.unique(below[tied]):
        rows = np.flatnonzero(tied & (below == place))
        first, last = place / steps_count, (until[rows[0]] - 1) / steps_count
        levels[rows] = first + (last - first) * (np.arange(len(rows)) + 0.5) / len(rows)
    levels[np.isnan(values)] = np.nan
    return levels


def population_stability_index(quantile_values: Sequence[float] | FloatArray, values: FloatArray) -> float:
    """Return how differently values are spread over ten bins that are equally likely by the reference.

    0 is the same, up to 0.1 is called no, up to 0.25 a minor shift. NaN without a finite value; values that are no
    numbers are left out. Half a value is added to every bin, so that empty ones have a logarithm.

    Args:
        quantile_values: Of the reference, never falling, at evenly spaced levels from 0 to 1. (levels,)
        values: (n,)

    References:
        Siddiqi, Credit Risk Scorecards, 2006 (system stability report). Yurdakul and Naranjo, Statistical
        properties of the population stability index, Journal of Risk Model Validation 14(4), 2020 (its distribution).
    """
    return float(_psi_ratio(_column_levels(quantile_values, values))[0])


def kolmogorov_smirnov(quantile_values: Sequence[float] | FloatArray, values: FloatArray) -> float:
    """Return the largest distance between the distribution of values and the reference, which is linear in between.

    NaN without a finite value; values that are no numbers are left out.

    Args:
        quantile_values: Of the reference, never falling, at evenly spaced levels from 0 to 1. (levels,)
        values: (n,)

    References:
        Massey, The Kolmogorov-Smirnov test for goodness of fit, Journal of the American Statistical Association 46,
        1951.
    """
    return float(_ks_frac(_column_levels(quantile_values, values))[0])


def psi_by_chance_ratio(chance_ratio: float) -> float:
    """Return the index that rows of the reference itself exceed with a probability of 1 %.

    It is distributed as the sum of one over both sample sizes times a chi-square variable.

    Args:
        chance_ratio: From `chance_ratio_of`: one over the number of rows, plus one over that of the reference.

    References:
        Yurdakul and Naranjo, Statistical properties of the population stability index, 2020.
    """
    return _CHI_SQUARE_99 * chance_ratio


def ks_by_chance_frac(chance_ratio: float) -> float:
    """Return the distance that rows of the reference itself exceed with a probability of at most 1 %.

    Args:
        chance_ratio: As for `psi_by_chance_ratio`.

    References:
        Smirnov, Table for estimating the goodness of fit of empirical distributions, Annals of Mathematical Statistics
        19, 1948.
    """
    return _KOLMOGOROV_99 * sqrt(chance_ratio)


def chance_ratio_of(parts: Sequence[tuple[int, int]]) -> float:
    """Return one over the rows, plus one over those of their references, each weighted by its part of the rows.

    Args:
        parts: Rows, and rows of the reference that these are held against; at least one row in all.
    """
    total_count = sum(rows_count for rows_count, _ in parts)
    known = sum((rows_count / total_count) ** 2 / reference_count for rows_count, reference_count in parts)
    return 1.0 / total_count + known


def drift_report(
    reference: TrainingReference | None,
    feature_names: Sequence[str],
    rows: FloatArray,
    mu: FloatArray,
    *,
    out_of_envelope_count: int,
    total_count: int,
    baseline: Sequence[BandReference] = (),
    policy: DriftPolicy | None = None,
) -> DriftReport:
    """Return what a window of passages says about drift.

    Args:
        reference: The training of the live model, on this road or on all roads; None if the bundle has none.
        feature_names: Kinematic features: the first ones of the model's table. Those of the road never move.
        rows: Their values, of passages that count and of those outside the envelope. (n, features)
        mu: The estimates; NaN where the model gave no number. (n,)
        out_of_envelope_count: Passages outside the envelope,
        total_count: of so many that were asked of the model.
        baseline: The section's own earlier traffic by friction, none before it is learned.
        policy: Limits.
    """
    policy = policy or DriftPolicy()
    judged = reference is not None and len(rows) >= policy.rows_least_count
    features: tuple[FeatureDrift, ...] = ()
    estimate: FeatureDrift | None = None
    if reference is not None and judged:
        width = len(feature_names)
        features = _compared(feature_names, [(reference.quantiles[:width], reference.rows_count, rows)], policy)
        (estimate,) = _compared(["mu"], [([reference.mu_quantiles], reference.rows_count, mu[:, None])], policy)
    parts = _by_band(baseline, rows, mu)
    own_rows_count = sum(len(part[2]) for part in parts)
    own_features = _compared(feature_names, parts, policy) if own_rows_count >= policy.rows_least_count else ()
    outside_count, estimates_count = _estimates_outside(reference, mu)
    alarms = {
        DriftAlarm.OUT_OF_ENVELOPE: total_count >= policy.rows_least_count
        and surely_above(out_of_envelope_count, total_count, limit_frac=policy.out_of_envelope_limit_frac),
        DriftAlarm.OWN_TRAFFIC: sum(feature.drifted for feature in own_features)
        > policy.own_drifted_limit_frac * max(1, len(own_features)),
        DriftAlarm.ESTIMATES_OUTSIDE: estimates_count >= policy.rows_least_count
        and surely_above(outside_count, estimates_count, limit_frac=policy.estimates_outside_limit_frac),
    }
    return DriftReport(
        rows_count=len(rows),
        not_finite_count=int((~np.isfinite(rows)).sum()),
        own_road=reference is not None and reference.section_id is not None,
        features=features,
        estimate=estimate,
        own_rows_count=own_rows_count,
        own_features=own_features,
        total_count=total_count,
        out_of_envelope_frac=out_of_envelope_count / max(1, total_count),
        estimates_outside_frac=outside_count / max(1, estimates_count),
        alarms=tuple(alarm for alarm, raised in alarms.items() if raised),
    )


def surely_above(count: int, total_count: int, *, limit_frac: float) -> bool:
    """Return whether a share is above a limit by more than what chance does in one of a hundred cases.

    Args:
        count: How many,
        total_count: of how many; never surely above without any.
        limit_frac: The share that is borne.
    """
    by_chance = limit_frac * total_count + _NORMAL_99 * sqrt(limit_frac * (1.0 - limit_frac) * total_count)
    return count > by_chance


def _column_levels(quantiles: Sequence[float] | FloatArray, values: FloatArray) -> FloatArray:
    return reference_levels(
        np.asarray(quantiles)[None, :], _finite_or_nan(np.asarray(values, dtype=np.float64))[:, None]
    )


def _finite_or_nan(values: FloatArray) -> FloatArray:
    return np.where(np.isfinite(values), values, np.nan)


def _psi_ratio(levels: FloatArray) -> FloatArray:
    """Return the index of each feature from its levels. (k,)"""
    known = np.isfinite(levels)
    bins = np.where(known, np.minimum((levels * BINS_COUNT), BINS_COUNT - 1), -1).astype(np.intp)
    counts = np.array([(bins == one).sum(axis=0) for one in range(BINS_COUNT)])
    rows_count = known.sum(axis=0)
    share = (counts + _EMPTY_BIN_COUNT) / (rows_count + BINS_COUNT * _EMPTY_BIN_COUNT)
    index = ((share - 1.0 / BINS_COUNT) * np.log(share * BINS_COUNT)).sum(axis=0)
    return np.where(rows_count > 0, index, np.nan)


def _ks_frac(levels: FloatArray) -> FloatArray:
    """Return the distance of each feature from its levels. (k,)"""
    ordered = np.sort(levels, axis=0)  # NaN last
    rows_count = np.isfinite(levels).sum(axis=0)
    place = np.arange(len(levels))[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        distance = np.maximum((place + 1) / rows_count - ordered, ordered - place / rows_count)
    distance = np.where(place < rows_count, distance, 0.0)
    return np.where(rows_count > 0, distance.max(axis=0, initial=0.0), np.nan)


def _compared(
    feature_names: Sequence[str],
    parts: Sequence[Held],
    policy: DriftPolicy,
) -> tuple[FeatureDrift, ...]:
    """Return how far each feature is from its references.

    Args:
        feature_names: (k,)
        parts: See `Held`; at least one row in all.
        policy: Limits.
    """
    levels = np.concatenate([reference_levels(quantiles, _finite_or_nan(rows)) for quantiles, _, rows in parts])
    chance_ratio = chance_ratio_of([(len(rows), reference_count) for _, reference_count, rows in parts])
    psi_limit_ratio = max(policy.psi_limit_ratio, psi_by_chance_ratio(chance_ratio))
    ks_limit_frac = max(policy.ks_limit_frac, ks_by_chance_frac(chance_ratio))
    return tuple(
        FeatureDrift(name, psi_ratio, ks_frac, psi_ratio > psi_limit_ratio and ks_frac > ks_limit_frac)
        for name, psi_ratio, ks_frac in zip(
            feature_names, _psi_ratio(levels).tolist(), _ks_frac(levels).tolist(), strict=True
        )
    )


def _by_band(baseline: Sequence[BandReference], rows: FloatArray, mu: FloatArray) -> list[Held]:
    chosen = [(band, (mu >= band.mu_low) & (mu < band.mu_high)) for band in baseline]
    return [(band.quantile_values, band.rows_count, rows[inside]) for band, inside in chosen if inside.any()]


def _estimates_outside(reference: TrainingReference | None, mu: FloatArray) -> tuple[int, int]:
    """Return how many estimates lie beyond all of the training's, and how many there are."""
    known = mu[np.isfinite(mu)]
    if reference is None:
        return 0, len(known)
    return int(((known < reference.mu_quantiles[0]) | (known > reference.mu_quantiles[-1])).sum()), len(known)

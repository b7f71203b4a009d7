"""Distributions as pictures show them: boxes, histograms, clouds thin enough to be drawn, figures in per cent."""

from __future__ import annotations

from dataclasses import dataclass
from math import erf, sqrt

import numpy as np

from roadgrip.units import FloatArray
from training.study.picture import Box, Cloud, Line

BOX_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
CLOUD_POINTS_COUNT = 600
"""Points of one cloud at most: more make a picture heavier, not clearer."""


def per_cent(share_frac: float) -> float:
    """Return a share in per cent, for tables and axes that say so."""
    return 100.0 * share_frac


def box_of(values: FloatArray, *, name: str, group: str) -> Box:
    """Return the box of some values.

    Args:
        values: Finite, at least one. (n,)
        name: Which column of the picture it stands in.
        group: Which colour it has.
    """
    low, lower, middle, upper, high = (float(value) for value in np.quantile(values, BOX_QUANTILES))
    return Box(name, group, (low, lower, middle, upper, high))


def cloud_of(x: FloatArray, y: FloatArray, *, name: str, seed: int) -> Cloud:
    """Return points as a cloud, thinned evenly by chance where there are too many.

    Args:
        x: Abscissae. (n,)
        y: Ordinates. (n,)
        name: In the legend.
        seed: Chooses who stays.
    """
    kept = np.arange(len(x))
    if len(x) > CLOUD_POINTS_COUNT:
        kept = np.sort(np.random.default_rng(seed).choice(len(x), CLOUD_POINTS_COUNT, replace=False))
    return Cloud(name, tuple(np.round(x[kept], 5).tolist()), tuple(np.round(y[kept], 5).tolist()))


def histogram_of(
    groups: dict[str, FloatArray], *, edge_values: FloatArray
) -> tuple[tuple[str, tuple[float, ...]], ...]:
    """Return the share of each group's values in every bin, in per cent; what lies outside counts in the outer bins.

    Args:
        groups: Values by name. Each (n,)
        edge_values: Ascending. (bins + 1,)

    Returns:
        Heights by group, as `training.study.picture.Bars` takes them.
    """
    shares = []
    for name, values in groups.items():
        inside = np.clip(values, edge_values[0], np.nextafter(edge_values[-1], edge_values[0]))
        counts, _ = np.histogram(inside, edge_values)
        shares.append((name, tuple((100.0 * counts / len(values)).tolist())))
    return tuple(shares)


@dataclass(frozen=True, slots=True)
class Shape:
    """How like a bell a distribution is.

    Attributes:
        mean_value: In the unit of the values.
        std_value: The same.
        skewness_ratio: 0 for anything symmetrical.
        kurtosis_ratio: In excess of a bell's: 0 for a bell, more with heavier tails.
        within_one_std_frac: Share of the values at most one standard deviation from the mean; 0.683 for a bell.
        within_two_std_frac: At most two; 0.954 for a bell.
    """

    mean_value: float
    std_value: float
    skewness_ratio: float
    kurtosis_ratio: float
    within_one_std_frac: float
    within_two_std_frac: float


def shape_of(values: FloatArray) -> Shape:
    """Return how like a bell some values are distributed; they must not all be the same. (n,)"""
    mean, std = float(values.mean()), float(values.std())
    scaled = (values - mean) / std
    return Shape(
        mean_value=mean,
        std_value=std,
        skewness_ratio=float(np.mean(scaled**3)),
        kurtosis_ratio=float(np.mean(scaled**4)) - 3.0,
        within_one_std_frac=float(np.mean(np.abs(scaled) <= 1.0)),
        within_two_std_frac=float(np.mean(np.abs(scaled) <= 2.0)),
    )


def bell_shares(*, mean_value: float, std_value: float, edge_values: FloatArray) -> tuple[float, ...]:
    """Return the share of a normal distribution in every bin, in per cent; the outer bins take the tails.

    Args:
        mean_value: In the unit of the edges.
        std_value: The same; positive.
        edge_values: Ascending. (bins + 1,)
    """
    below = np.array([0.5 * (1.0 + erf((edge - mean_value) / (std_value * sqrt(2.0)))) for edge in edge_values])
    below[0], below[-1] = 0.0, 1.0
    return tuple((100.0 * np.diff(below)).tolist())


def identity_line(low: float, high: float, *, name: str = "estimate = truth") -> Line:
    """Return the line on which estimates equal the truth."""
    return Line(name, (low, high), (low, high), dashed=True)

"""The feature table: what a kinematic summary holds, in which order, within which range.

Five signals and two road profiles, each as eleven statistics, and the length of the section: 78 features. The
paper counts 82 for the same list; 78 is what its list adds up to, and what we say openly.

The vehicle sends the 55 kinematic features. The 23 of the road follow from the map alone, so either side computes
them from its own copy with `road_features` and nothing is sent twice.

The table's digest travels with every summary and inside every model bundle; a summary made for another table is
refused, because a column that shifted by one place would still look like friction.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import FeatureTableError

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray

TABLE_VERSION = 1

STATISTICS = ("mean", "std", "q20", "q40", "q60", "q80", "min", "median", "max", "skewness", "kurtosis")
"""The paper's eleven statistics, in its order."""

_SHAPE_STATISTICS = frozenset({"skewness", "kurtosis"})
_FLAT = 1e-12
"""A signal whose standard deviation is below this share of its largest magnitude is constant: no shape."""


@dataclass(frozen=True, slots=True)
class Feature:
    """One column of the table.

    Attributes:
        name: Subject, statistic, unit, such as `yaw_rate_excess_q80_radps`.
        unit: The unit as in names, empty when dimensionless.
        minimum: Smallest value that can be physically true; smaller ones are refused.
        maximum: Largest one.
    """

    name: str
    unit: str
    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True)
class _Signal:
    name: str
    unit: str
    minimum: float
    maximum: float


_KINEMATIC_SIGNALS = (
    _Signal("steer", "rad", -1.0, 1.0),
    _Signal("sideslip", "rad", -1.6, 1.6),
    _Signal("sideslip_rate", "radps", -20.0, 20.0),
    _Signal("yaw_rate_excess", "radps", -6.0, 6.0),
    _Signal("speed", "mps", 0.0, 80.0),
)
_ROAD_SIGNALS = (
    _Signal("curvature", "1pm", -0.2, 0.2),
    _Signal("road_difficulty", "ratio", -1.0, 20.0),
)


def _columns(signal: _Signal) -> tuple[Feature, ...]:
    columns = []
    for statistic in STATISTICS:
        if statistic in _SHAPE_STATISTICS:
            # |skewness| <= sqrt(n) and kurtosis <= n; an hour has 360,000 samples.
            bound = 600.0 if statistic == "skewness" else 360_000.0
            low = -bound if statistic == "skewness" else -2.0
            columns.append(Feature(f"{signal.name}_{statistic}", "", low, bound))
        elif statistic == "std":
            width = signal.maximum - signal.minimum
            columns.append(Feature(f"{signal.name}_std_{signal.unit}", signal.unit, 0.0, width / 2.0))
        else:
            columns.append(
                Feature(f"{signal.name}_{statistic}_{signal.unit}", signal.unit, signal.minimum, signal.maximum)
            )
    return tuple(columns)


KINEMATIC_FEATURES: tuple[Feature, ...] = tuple(f for s in _KINEMATIC_SIGNALS for f in _columns(s))
"""What the vehicle sends, in this order. (55)"""

ROAD_FEATURES: tuple[Feature, ...] = (
    *(f for s in _ROAD_SIGNALS for f in _columns(s)),
    Feature("section_length_m", "m", 10.0, 20_000.0),
)
"""What follows from the map, in this order. (23)"""

FEATURES: tuple[Feature, ...] = KINEMATIC_FEATURES + ROAD_FEATURES
"""The regressor's columns. (78)"""

FEATURE_NAMES: tuple[str, ...] = tuple(f.name for f in FEATURES)


def _digest(features: tuple[Feature, ...]) -> str:
    lines = [f"roadgrip feature table {TABLE_VERSION}"]
    lines += [f"{f.name}|{f.unit}|{f.minimum!r}|{f.maximum!r}" for f in features]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


TABLE_DIGEST = _digest(FEATURES)
"""Sixteen hexadecimal characters that name this table."""


def check_digest(digest: str, *, subject: str) -> None:
    """Do nothing if `digest` names this table.

    Args:
        digest: The digest that came with something.
        subject: What it came with, for the message.

    Raises:
        FeatureTableError: It names another table; the message holds both digests.
    """
    if digest != TABLE_DIGEST:
        message = f"{subject} was made for feature table {digest}, this software speaks {TABLE_DIGEST}"
        raise FeatureTableError(message)


def statistics_of(samples: FloatArray) -> FloatArray:
    """Return the eleven statistics of a bag of samples, in the order of `STATISTICS`.

    The order of the samples does not matter. Skewness is the biased Fisher-Pearson coefficient, kurtosis its excess
    (0 for a normal distribution); both are 0 for a constant signal, where they have no meaning. Quantiles
    interpolate linearly. The standard deviation divides by n.

    Args:
        samples: Finite values, at least one. (n,)

    Returns:
        The statistics. (11,)

    Raises:
        ValueError: There is no sample, or one is not finite.
    """
    if samples.size == 0:
        message = "statistics of no samples"
        raise ValueError(message)
    if not np.isfinite(samples).all():
        message = "statistics of samples that are not finite"
        raise ValueError(message)
    # Sorted first, so that sums do not depend on the order in which the samples came, not even in the last bit.
    # Adding zero turns -0.0 into 0.0; the two sort as equals and would stay in the order they came.
    ordered = np.sort(samples) + 0.0
    mean = float(ordered.mean())
    deviation = ordered - mean
    variance = float(np.mean(deviation**2))
    std = float(np.sqrt(variance))
    q20, q40, median, q60, q80 = _quantiles(ordered)
    skewness = kurtosis = 0.0
    if std > _FLAT * max(1e-300, float(np.abs(ordered).max())):
        scaled = deviation / std
        # Products: numpy's general power costs a hundred times as much.
        square = scaled * scaled
        skewness = float(np.mean(square * scaled))
        kurtosis = float(np.mean(square * square)) - 3.0
    return np.array([mean, std, q20, q40, q60, q80, ordered[0], median, ordered[-1], skewness, kurtosis])


def _quantiles(ordered: FloatArray) -> FloatArray:
    """Return 20, 40, 50, 60 and 80 %, linear between neighbours, of samples that are sorted already. (5,)"""
    at = np.array([0.2, 0.4, 0.5, 0.6, 0.8]) * (len(ordered) - 1)
    below = at.astype(np.intp)
    low, high = ordered[below], ordered[np.minimum(below + 1, len(ordered) - 1)]
    return low + (high - low) * (at - below)


def road_features(section: RoadSection) -> FloatArray:
    """Return the features that follow from the map alone, in the order of `ROAD_FEATURES`.

    Args:
        section: The map. Its profile is sampled every metre, so that the statistics do not depend on the speed.

    Returns:
        Statistics of the curvature and of the road difficulty index, and the length. (23,)
    """
    profile = section.profile
    return np.concatenate(
        [
            statistics_of(profile.curvature_1pm),
            statistics_of(profile.road_difficulty_ratio),
            [section.length_m],
        ]
    )

"""The feature tables: what a kinematic summary holds, in which order, within which range.

A table has a version and two parts. The vehicle sends the kinematic features; those of the road follow from the map
alone, so either side computes them from its own copy with `road_features` and nothing is sent twice.

Table 1 is the paper's: five signals and two road profiles, each as eleven statistics, and the length of the section: 78
features, 55 of them kinematic. The paper counts 82 for the same list; 78 is what its list adds up to, and what we
say openly.

The table's digest travels with every summary and names the model of a bundle that may read it; a summary that no model
was made for is refused, because a column that shifted by one place would still look like friction. A newer table
begins with the columns of the older ones, so `summary_for` can say the same in older words.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import FeatureTableError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from roadgrip.records import KinematicSummary
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray

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


@dataclass(frozen=True)
class FeatureTable:
    """The columns that one version of the vehicle client and the regressors made for it agree on.

    Attributes:
        version: Counts the tables; the digest tells them apart.
        kinematic: What the vehicle sends, in this order.
        road: What follows from the map, in this order.
    """

    version: int
    kinematic: tuple[Feature, ...]
    road: tuple[Feature, ...]

    @cached_property
    def features(self) -> tuple[Feature, ...]:
        """The regressor's columns: the kinematic ones, then those of the road."""
        return self.kinematic + self.road

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the regressor's columns."""
        return tuple(feature.name for feature in self.features)

    @cached_property
    def digest(self) -> str:
        """Sixteen hexadecimal characters that name this table."""
        lines = [f"roadgrip feature table {self.version}"]
        lines += [f"{f.name}|{f.unit}|{f.minimum!r}|{f.maximum!r}" for f in self.features]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]

    @cached_property
    def minimum(self) -> FloatArray:
        """Smallest value of each of the regressor's columns that can be true. (columns,)"""
        return np.array([feature.minimum for feature in self.features])

    @cached_property
    def maximum(self) -> FloatArray:
        """Largest value of each of the regressor's columns that can be true. (columns,)"""
        return np.array([feature.maximum for feature in self.features])

    @cached_property
    def statistics_columns(self) -> NDArray[np.intp]:
        """Where the statistics of each signal stand among the kinematic features, in the order of `STATISTICS`.

        The laws between statistics hold for these columns and for no others. (signals, 11)
        """
        blocks = [[f.name for f in _columns(signal)] for signal in _KINEMATIC_SIGNALS]
        known = [block for block in blocks if set(block) <= self._places.keys()]
        return np.array([[self._places[name] for name in block] for block in known], dtype=np.intp).reshape(
            -1, len(STATISTICS)
        )

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.names)}

    def __len__(self) -> int:
        """Return the number of the regressor's columns."""
        return len(self.features)

    def index(self, name: str) -> int:
        """Return the column of a feature.

        Raises:
            FeatureTableError: The table has no such feature.
        """
        if name not in self._places:
            message = f"feature table {self.digest} has no column {name}"
            raise FeatureTableError(message)
        return self._places[name]

    def columns(self, names: Sequence[str]) -> NDArray[np.intp]:
        """Return the columns of some features, in the order asked for. (names,)

        Raises:
            FeatureTableError: The table lacks one of them.
        """
        return np.array([self.index(name) for name in names], dtype=np.intp)

    def columns_of(self, other: FeatureTable) -> NDArray[np.intp]:
        """Return where another table's columns stand in a row of this one. (columns of the other,)

        Raises:
            FeatureTableError: This table lacks one of them.
        """
        return self.columns(other.names)

    def covers(self, other: FeatureTable) -> bool:
        """Return whether a summary of this table holds everything that one of another table does."""
        return {feature.name for feature in other.kinematic} <= {feature.name for feature in self.kinematic}


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


PAPER_TABLE = FeatureTable(
    version=1,
    kinematic=tuple(f for s in _KINEMATIC_SIGNALS for f in _columns(s)),
    road=(*(f for s in _ROAD_SIGNALS for f in _columns(s)), Feature("section_length_m", "m", 10.0, 20_000.0)),
)
"""The paper's features: 55 that the vehicle sends, 23 of the road."""

GRIP_SHAPES: Mapping[str, tuple[float, ...]] = {
    "all": (0.5, 2.0, 8.0),
    "steering": (0.5, 2.0, 8.0),
    "drift": (0.5, 2.0),
    "wheels": (0.5, 2.0),
}
"""Falls of the log-likelihood of friction whose distances are told, by what the likelihood goes by: all channels
together, the steering angle, the lateral velocity, the wheel speeds. One, two and four deviations of a Gaussian."""
GRIP_USE_LEVELS_FRAC = (0.5, 0.8, 0.95, 1.0)
"""Quantiles of the demand that are told as shares of the best friction."""
GRIP_DEMAND_LEVELS_FRAC = (0.95, 1.0)
"""Quantiles of the demand that are told as they are."""
PROFILE_FRICTIONS_MU = (0.12, 0.15, 0.18, 0.22, 0.27, 0.33, 0.40, 0.47, 0.55, 0.65, 0.80, 1.00)
"""At which frictions the likelihood of all channels together is told, so that profiles of many vehicles add up."""
PROFILE_FLOOR = -40.0
"""Log-likelihoods below it are told as it."""
GRIP_PARTS: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "weak": {"below": (0.5,), "above": (0.5, 2.0)},
    "firm": {"below": (0.5,), "above": ()},
}
"""The same falls of the likelihood of all channels together over a part of the drive: of the part where less grip was
found, how little and how much it may be; of the other, how little."""
GAIN_LIMIT = 1000.0
"""More evidence that the friction was not the same all along is told as so much."""
MISFIT_LIMIT = 1000.0
"""Per sample; more is no likelier to mean anything."""
_WIDEST = 5.0
"""In natural logarithms of friction: wider than any grid of frictions."""


def _grip_features() -> tuple[Feature, ...]:
    features = []
    for name, drops in GRIP_SHAPES.items():
        if name == "all":
            features.append(Feature("grip_all_best_mu", "mu", 0.05, 2.0))
        else:
            # In natural logarithms, from the best friction of all channels together: what contradicts what.
            features.append(Feature(f"grip_{name}_shift_ratio", "ratio", -_WIDEST, _WIDEST))
        for side in ("below", "above"):
            features += [
                Feature(f"grip_{name}_{side}_{(2.0 * drop) ** 0.5:.0f}sd_ratio", "ratio", 0.0, _WIDEST)
                for drop in drops
            ]
        features.append(Feature(f"grip_{name}_misfit_ratio", "ratio", 0.0, MISFIT_LIMIT))
    features += [
        Feature(f"grip_profile_{100 * mu:.0f}_ratio", "ratio", PROFILE_FLOOR, 0.0) for mu in PROFILE_FRICTIONS_MU
    ]
    # Of two parts of the drive: the one where less grip was found, and the other.
    features.append(Feature("grip_parts_gain_ratio", "ratio", 0.0, GAIN_LIMIT))
    for part in ("weak", "firm"):
        features.append(Feature(f"grip_{part}_shift_ratio", "ratio", -_WIDEST, _WIDEST))
        for side, drops in GRIP_PARTS[part].items():
            features += [
                Feature(f"grip_{part}_{side}_{(2.0 * drop) ** 0.5:.0f}sd_ratio", "ratio", 0.0, _WIDEST)
                for drop in drops
            ]
    features.append(Feature("demand_weak_use_ratio", "ratio", 0.0, 100.0))
    features += [Feature(f"demand_q{100 * level:.0f}_use_ratio", "ratio", 0.0, 100.0) for level in GRIP_USE_LEVELS_FRAC]
    features += [Feature(f"demand_q{100 * level:.0f}_mu", "mu", 0.0, 10.0) for level in GRIP_DEMAND_LEVELS_FRAC]
    features += [
        Feature("force_y_max_mps2", "mps2", 0.0, 40.0),
        Feature("force_y_mean_mps2", "mps2", 0.0, 40.0),
        Feature("force_x_min_mps2", "mps2", -40.0, 40.0),
        Feature("force_x_max_mps2", "mps2", -40.0, 40.0),
        Feature("yaw_rate_max_radps", "radps", 0.0, 6.0),
    ]
    return tuple(features)


GRIP_TABLE = FeatureTable(version=2, kinematic=PAPER_TABLE.kinematic + _grip_features(), road=PAPER_TABLE.road)
"""The paper's features, and what a model of two axles makes of the drive (`vehicle_client.estimation.grip`)."""

TABLES: Mapping[str, FeatureTable] = {table.digest: table for table in (PAPER_TABLE, GRIP_TABLE)}
"""The tables this software speaks, by digest, oldest first."""

NEWEST_TABLE = GRIP_TABLE
"""What the vehicle client makes and the laboratory learns from."""

FEATURE_NAMES = NEWEST_TABLE.names
"""Its columns by name."""


def table_of(digest: str, *, subject: str) -> FeatureTable:
    """Return the table that a digest names.

    Args:
        digest: The digest that came with something.
        subject: What it came with, for the message.

    Raises:
        FeatureTableError: This software does not speak that table; the message holds all digests.
    """
    if digest not in TABLES:
        message = f"{subject} was made for feature table {digest}, this software speaks {', '.join(TABLES)}"
        raise FeatureTableError(message)
    return TABLES[digest]


def summary_for(summary: KinematicSummary, table: FeatureTable) -> KinematicSummary:
    """Return the same summary in the columns of another table.

    Args:
        summary: What a vehicle made of a drive.
        table: One whose kinematic columns the summary's own table has, too.

    Raises:
        FeatureTableError: The summary's table is not spoken here, or lacks a column that is asked for.
    """
    if summary.table_digest == table.digest:
        return summary
    own = table_of(summary.table_digest, subject="the summary")
    if not own.covers(table):
        message = f"a summary of feature table {own.digest} lacks columns of {table.digest}"
        raise FeatureTableError(message)
    values = tuple(summary.values[own.index(feature.name)] for feature in table.kinematic)
    return replace(summary, values=values, table_digest=table.digest)


def summary_among(summary: KinematicSummary, table_digests: Collection[str]) -> KinematicSummary | None:
    """Return the summary in the columns of the newest table that is among some and can be filled; None without one.

    Args:
        summary: What a vehicle made of a drive.
        table_digests: What the receiver serves.
    """
    own = TABLES.get(summary.table_digest)
    if own is None:
        return summary if summary.table_digest in table_digests else None
    for table in tuple(TABLES.values())[::-1]:
        if table.digest in table_digests and own.covers(table):
            return summary_for(summary, table)
    return None


def older_summary(summary: KinematicSummary) -> KinematicSummary | None:
    """Return the summary in the columns of the next older table that it can fill; None if there is none."""
    digests = tuple(TABLES)
    if summary.table_digest not in digests:
        return None
    return summary_among(summary, digests[: digests.index(summary.table_digest)])


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


def road_features(section: RoadSection, table: FeatureTable = NEWEST_TABLE) -> FloatArray:
    """Return the features that follow from the map alone, in the order of a table's `road`.

    Args:
        section: The map. Its profile is sampled every metre, so that the statistics do not depend on the speed.
        table: Which features are asked for.

    Returns:
        Statistics of the curvature and of the road difficulty index, the length. (23,) for the paper's table
    """
    profile = section.profile
    samples = (profile.curvature_1pm, profile.road_difficulty_ratio)
    figures = {"section_length_m": section.length_m}
    for signal, values in zip(_ROAD_SIGNALS, samples, strict=True):
        names = [feature.name for feature in _columns(signal)]
        figures.update(zip(names, statistics_of(values).tolist(), strict=True))
    return np.array([figures[feature.name] for feature in table.road])

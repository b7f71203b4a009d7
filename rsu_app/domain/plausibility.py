"""Can this passage have happened? Asked before the model, which answers anything with a plausible number."""

from __future__ import annotations

import struct
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from roadgrip.bundle import ModelManifest
from roadgrip.features import STATISTICS, TABLES, FeatureTable
from roadgrip.reasons import Reason
from roadgrip.records import PASSAGE_ID_BYTES, KinematicSummary, NotCounted, Passage, Rejected
from roadgrip.section import RoadSection
from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.envelope import is_strange_driving, is_strange_road, outside_box

AGE_LIMIT_S = 86_400.0
"""A vehicle's spool keeps a passage for a day at most; an older one has a broken clock."""
DISTANCE_TOLERANCE_FRAC = 0.2
"""How far mean speed times duration may be from the section's length: a lane beside the mapped one, cut ends, gaps."""
ESTIMATE_MARGIN_FRAC = 0.1
"""Share of the model's friction range by which an estimate may lie outside of it."""

_RELATIVE_SLACK = 1e-3
_ABSOLUTE_SLACK = 1e-5
"""Slack of the laws between statistics: they arrive as 32-bit numbers."""
_AT = {name: column for column, name in enumerate(STATISTICS)}
_ASCENDING = [_AT[name] for name in ("min", "q20", "q40", "median", "q60", "q80", "max")]


def summary_values(summary: KinematicSummary) -> NDArray[np.float32]:
    """Return the values as they are judged, stored and given to the model: 32 bits. Too large becomes infinite. (k,)"""
    try:
        # A third of the time that numpy takes to look through a tuple.
        packed = _floats(len(summary.values)).pack(*summary.values)
    except (OverflowError, struct.error):
        with np.errstate(over="ignore"):
            return np.array(summary.values, dtype=np.float32)
    return np.frombuffer(packed, dtype=np.float32)


@lru_cache(maxsize=8)
def _floats(count: int) -> struct.Struct:
    return struct.Struct(f"={count}f")


def implausibility(
    passage: Passage, section: RoadSection, *, table_digests: Collection[str] = TABLES.keys()
) -> Rejected | None:
    """Return why the passage is refused, or None if it can have happened.

    Asks, in this order: is it a passage, for a feature table that is served and for this map; are its numbers
    numbers; can each be true alone; can the statistics of a signal be true together; do speed and duration give the
    section's length; is its age possible.

    Args:
        passage: What a vehicle claims.
        section: The map of the section it names.
        table_digests: The feature tables that are served, each one of `roadgrip.features.TABLES`.
    """
    misdirected = misdirection(passage, section, table_digests=table_digests)
    return misdirected or implausibilities([passage], summary_values(passage.summary)[None, :], [section])[0]


def misdirection(passage: Passage, section: RoadSection, *, table_digests: Collection[str]) -> Rejected | None:
    """Return why the passage is no passage for this map and a table that is served, or None; see `implausibility`."""
    summary = passage.summary
    if len(passage.passage_id) != PASSAGE_ID_BYTES:
        return Rejected(Reason.MALFORMED, f"a passage id has {PASSAGE_ID_BYTES} bytes, not {len(passage.passage_id)}")
    if summary.table_digest not in table_digests:
        served = ", ".join(table_digests)
        detail = f"the summary was made for feature table {summary.table_digest[:64]}, this unit serves {served}"
        return Rejected(Reason.WRONG_FEATURE_TABLE, detail)
    if passage.map_version != section.version:
        detail = f"cut with map {passage.map_version[:64]}, this unit serves {section.version}"
        return Rejected(Reason.STALE_MAP, detail)
    wanted_count = len(TABLES[summary.table_digest].kinematic)
    if len(summary.values) != wanted_count:
        return Rejected(Reason.MALFORMED, f"a summary has {wanted_count} values, not {len(summary.values)}")
    return None


def implausibilities(
    passages: Sequence[Passage], values: NDArray[np.float32], sections: Sequence[RoadSection]
) -> list[Rejected | None]:
    """Return why each passage is refused, or None if it can have happened; see `implausibility`.

    Many are hardly dearer than one: what is asked of their numbers is asked of all at once. Only who is refused is
    looked at alone, for the reason.

    Args:
        passages: Of one feature table, each for its map, as `misdirection` lets them through; at least one.
        values: Of their summaries, see `summary_values`. (n, k)
        sections: The map of each.
    """
    table = TABLES[passages[0].summary.table_digest]
    claims = _Claims(
        values=values,
        duration_s=np.array([passage.summary.duration_s for passage in passages]),
        age_s=np.array([passage.age_s for passage in passages]),
        length_m=np.array([section.length_m for section in sections]),
    )
    possible = ~(_not_finite(claims) | _outside(claims, table).any(axis=1))
    # Only numbers that can be true alone are put into the laws.
    asked = np.flatnonzero(possible)
    broken = np.zeros(len(possible), dtype=np.bool_)
    broken[asked] = np.any([law.any(axis=1) for law in _broken_laws(claims.values[asked], table).values()], axis=0)
    fine = possible & ~broken & ~_wrong_distance(claims, table) & ~_wrong_age(claims)
    return [None if ok else _why_refused(claims.only(i), table) for i, ok in enumerate(fine.tolist())]


@dataclass(frozen=True, slots=True)
class _Claims:
    """The numbers of passages of one feature table.

    Attributes:
        values: (n, k)
        duration_s: (n,)
        age_s: (n,)
        length_m: Of the section. (n,)
    """

    values: NDArray[np.float32]
    duration_s: FloatArray
    age_s: FloatArray
    length_m: FloatArray

    def only(self, i: int) -> _Claims:
        """Return one of the passages."""
        one = slice(i, i + 1)
        return _Claims(self.values[one], self.duration_s[one], self.age_s[one], self.length_m[one])


def _not_finite(claims: _Claims) -> BoolArray:
    finite = np.isfinite(claims.values).all(axis=1) & np.isfinite(claims.age_s) & np.isfinite(claims.duration_s)
    return np.asarray(~finite)


def _outside(claims: _Claims, table: FeatureTable) -> BoolArray:
    # Compared as the 32-bit numbers that arrive: 1.6 sent as such is larger than the 64-bit limit 1.6.
    minimum, maximum = _limits(table.digest)
    return np.asarray((claims.values < minimum) | (claims.values > maximum))


@lru_cache(maxsize=8)
def _limits(table_digest: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    table = TABLES[table_digest]
    count = len(table.kinematic)
    return table.minimum[:count].astype(np.float32), table.maximum[:count].astype(np.float32)


def _broken_laws(values: NDArray[np.float32], table: FeatureTable) -> dict[str, BoolArray]:
    """Return which signals of which passages break each law between their statistics. Each (n, signals)"""
    of_signals = values.astype(np.float64)[:, table.statistics_columns]
    ascending = of_signals[..., _ASCENDING]
    mean, std, low, high = (of_signals[..., _AT[name]] for name in ("mean", "std", "min", "max"))
    skewness, kurtosis = of_signals[..., _AT["skewness"]], of_signals[..., _AT["kurtosis"]]
    slack = _ABSOLUTE_SLACK + _RELATIVE_SLACK * (high - low)
    return {
        "quantiles must ascend": np.asarray((np.diff(ascending, axis=-1) < 0.0).any(axis=-1)),
        "the mean lies between minimum and maximum": (mean < low - slack) | (mean > high + slack),
        # Popoviciu: a variance is at most a quarter of the squared range.
        "the deviation is at most half the range": std > (high - low) / 2.0 + slack,
        "the median lies within one deviation of the mean": np.abs(mean - of_signals[..., _AT["median"]]) > std + slack,
        # Pearson: kurtosis (not its excess) is at least 1 + skewness squared.
        "kurtosis and skewness contradict each other": kurtosis + 2.0
        < skewness**2 - _RELATIVE_SLACK * (1.0 + skewness**2),
    }


def _driven_m(claims: _Claims, table: FeatureTable) -> FloatArray:
    return np.asarray(claims.values[:, table.index("speed_mean_mps")] * claims.duration_s, dtype=np.float64)


def _wrong_distance(claims: _Claims, table: FeatureTable) -> BoolArray:
    with np.errstate(invalid="ignore", over="ignore"):
        away_frac = np.abs(_driven_m(claims, table) / claims.length_m - 1.0)
    return np.asarray((claims.duration_s <= 0.0) | ~(away_frac <= DISTANCE_TOLERANCE_FRAC))


def _wrong_age(claims: _Claims) -> BoolArray:
    return np.asarray(~((claims.age_s >= 0.0) & (claims.age_s <= AGE_LIMIT_S)))


def _why_refused(claims: _Claims, table: FeatureTable) -> Rejected:
    """Return the first reason why a single passage cannot have happened."""
    if _not_finite(claims)[0]:
        return Rejected(Reason.NOT_FINITE, "a value, the age or the duration is not a finite number")
    outside = _outside(claims, table)[0]
    if outside.any():
        column = int(np.argmax(outside))
        feature, value = table.kinematic[column], float(claims.values[0, column])
        detail = f"{feature.name} = {value:.6g} is outside {feature.minimum:g} to {feature.maximum:g}"
        return Rejected(Reason.OUT_OF_RANGE, detail)
    for law, broken in _broken_laws(claims.values, table).items():
        if broken.any():
            name = table.names[table.statistics_columns[int(np.argmax(broken[0])), 0]]
            return Rejected(Reason.OUT_OF_RANGE, f"{law}: broken by the signal of {name}")
    duration_s, age_s = float(claims.duration_s[0]), float(claims.age_s[0])
    if _wrong_distance(claims, table)[0]:
        driven_m, length_m = float(_driven_m(claims, table)[0]), float(claims.length_m[0])
        detail = f"{duration_s:.6g} s at its mean speed are {driven_m:.6g} m, the section has {length_m:.1f} m"
        return Rejected(Reason.IMPOSSIBLE_DURATION, detail)
    return Rejected(Reason.IMPOSSIBLE_AGE, f"an age of {age_s:.6g} s is not within 0 to {AGE_LIMIT_S:.0f} s")


def are_strange(rows: FloatArray, manifest: ModelManifest) -> BoolArray:
    """Return which passages the model was not made for. (n,)

    By what ordinary roads and ordinary driving look like, if the bundle says; otherwise by the box of its training.

    Args:
        rows: Features in the order of the model's table. (n, columns)
        manifest: What the model says about itself.
    """
    ordinary, names = manifest.ordinary, manifest.feature_names
    if ordinary is None:
        return outside_box(rows, manifest.envelope)
    return np.asarray(is_strange_road(rows, ordinary, names) | is_strange_driving(rows, ordinary, names))


def envelope_flag(row: FloatArray, manifest: ModelManifest) -> NotCounted:
    """Return whether the model was made for a passage like this one; see `are_strange`. `row` is (columns,)."""
    return NotCounted.OUT_OF_ENVELOPE if are_strange(row[None, :], manifest)[0] else NotCounted.NONE


def estimate_flag(mu: float, manifest: ModelManifest) -> NotCounted:
    """Return whether an estimate is one that the model can be right about: finite, positive, about its range."""
    low, high = manifest.mu_range
    margin = ESTIMATE_MARGIN_FRAC * (high - low)
    if isfinite(mu) and mu > 0.0 and low - margin <= mu <= high + margin:
        return NotCounted.NONE
    return NotCounted.ESTIMATE_OUT_OF_RANGE


def together(one: NotCounted, other: NotCounted) -> NotCounted:
    """Return what both say; mostly neither says anything, which the library takes a thousand instructions to find."""
    return other if one is NotCounted.NONE else one if other is NotCounted.NONE else one | other


def age_flag(age_s: float, *, window_s: float) -> NotCounted:
    """Return whether the passage is too old to say anything about the road as it is now."""
    return NotCounted.OLDER_THAN_WINDOW if age_s > window_s else NotCounted.NONE

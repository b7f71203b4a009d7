"""Can this passage have happened? Asked before the model, which answers anything with a plausible number."""

from __future__ import annotations

from collections.abc import Collection
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from roadgrip.bundle import ModelManifest
from roadgrip.features import STATISTICS, TABLES, FeatureTable
from roadgrip.reasons import Reason
from roadgrip.records import PASSAGE_ID_BYTES, KinematicSummary, NotCounted, Passage, Rejected
from roadgrip.section import RoadSection
from roadgrip.units import FloatArray
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
    """Return the values as they are judged, stored and given to the model: 32 bits. Too large becomes infinite. (n,)"""
    with np.errstate(over="ignore"):
        return np.asarray(summary.values, dtype=np.float32)


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
    summary = passage.summary
    if len(passage.passage_id) != PASSAGE_ID_BYTES:
        return Rejected(Reason.MALFORMED, f"a passage id has {PASSAGE_ID_BYTES} bytes, not {len(passage.passage_id)}")
    if summary.table_digest not in table_digests:
        served = ", ".join(table_digests)
        detail = f"the summary was made for feature table {summary.table_digest[:64]}, this unit serves {served}"
        return Rejected(Reason.WRONG_FEATURE_TABLE, detail)
    table = TABLES[summary.table_digest]
    if passage.map_version != section.version:
        detail = f"cut with map {passage.map_version[:64]}, this unit serves {section.version}"
        return Rejected(Reason.STALE_MAP, detail)
    if len(summary.values) != len(table.kinematic):
        detail = f"a summary has {len(table.kinematic)} values, not {len(summary.values)}"
        return Rejected(Reason.MALFORMED, detail)
    values = summary_values(summary)
    if not (np.isfinite(values).all() and isfinite(passage.age_s) and isfinite(summary.duration_s)):
        return Rejected(Reason.NOT_FINITE, "a value, the age or the duration is not a finite number")
    return _impossible_values(values, table) or _impossible_times(passage, section, table)


def _impossible_values(values: NDArray[np.float32], table: FeatureTable) -> Rejected | None:
    # Compared as the 32-bit numbers that arrive: 1.6 sent as such is larger than the 64-bit limit 1.6.
    minimum, maximum = (limit[: len(values)].astype(np.float32) for limit in (table.minimum, table.maximum))
    outside = (values < minimum) | (values > maximum)
    if outside.any():
        feature = table.kinematic[int(np.argmax(outside))]
        value = float(values[np.argmax(outside)])
        detail = f"{feature.name} = {value:.6g} is outside {feature.minimum:g} to {feature.maximum:g}"
        return Rejected(Reason.OUT_OF_RANGE, detail)
    broken = _broken_law(values.astype(np.float64), table)
    return None if broken is None else Rejected(Reason.OUT_OF_RANGE, broken)


def _broken_law(values: FloatArray, table: FeatureTable) -> str | None:
    """Return which law between the statistics of one signal is broken, if any."""
    columns = table.statistics_columns
    of_signals = values[columns]
    ascending = of_signals[:, _ASCENDING]
    mean, std, low, high = (of_signals[:, _AT[name]] for name in ("mean", "std", "min", "max"))
    skewness, kurtosis = of_signals[:, _AT["skewness"]], of_signals[:, _AT["kurtosis"]]
    slack = _ABSOLUTE_SLACK + _RELATIVE_SLACK * (high - low)
    laws = {
        "quantiles must ascend": (np.diff(ascending, axis=1) < 0.0).any(axis=1),
        "the mean lies between minimum and maximum": (mean < low - slack) | (mean > high + slack),
        # Popoviciu: a variance is at most a quarter of the squared range.
        "the deviation is at most half the range": std > (high - low) / 2.0 + slack,
        "the median lies within one deviation of the mean": np.abs(mean - of_signals[:, _AT["median"]]) > std + slack,
        # Pearson: kurtosis (not its excess) is at least 1 + skewness squared.
        "kurtosis and skewness contradict each other": kurtosis + 2.0
        < skewness**2 - _RELATIVE_SLACK * (1.0 + skewness**2),
    }
    for law, broken in laws.items():
        if broken.any():
            name = table.names[columns[int(np.argmax(broken)), 0]]
            return f"{law}: broken by the signal of {name}"
    return None


def _impossible_times(passage: Passage, section: RoadSection, table: FeatureTable) -> Rejected | None:
    duration_s = passage.summary.duration_s
    driven_m = passage.summary.values[table.index("speed_mean_mps")] * duration_s
    if duration_s <= 0.0 or abs(driven_m / section.length_m - 1.0) > DISTANCE_TOLERANCE_FRAC:
        detail = f"{duration_s:.6g} s at its mean speed are {driven_m:.6g} m, the section has {section.length_m:.1f} m"
        return Rejected(Reason.IMPOSSIBLE_DURATION, detail)
    if not 0.0 <= passage.age_s <= AGE_LIMIT_S:
        return Rejected(
            Reason.IMPOSSIBLE_AGE, f"an age of {passage.age_s:.6g} s is not within 0 to {AGE_LIMIT_S:.0f} s"
        )
    return None


def envelope_flag(row: FloatArray, manifest: ModelManifest) -> NotCounted:
    """Return whether the model was made for passages like this one.

    By what ordinary roads and ordinary driving look like, if the bundle says; otherwise by the box of its training.

    Args:
        row: Features in the order of the model's table. (columns,)
        manifest: What the model says about itself.
    """
    rows, ordinary, names = row[None, :], manifest.ordinary, manifest.feature_names
    if ordinary is None:
        outside = outside_box(rows, manifest.envelope)
    else:
        outside = is_strange_road(rows, ordinary, names) | is_strange_driving(rows, ordinary, names)
    return NotCounted.OUT_OF_ENVELOPE if outside[0] else NotCounted.NONE


def estimate_flag(mu: float, manifest: ModelManifest) -> NotCounted:
    """Return whether an estimate is one that the model can be right about: finite, positive, about its range."""
    low, high = manifest.mu_range
    margin = ESTIMATE_MARGIN_FRAC * (high - low)
    if isfinite(mu) and mu > 0.0 and low - margin <= mu <= high + margin:
        return NotCounted.NONE
    return NotCounted.ESTIMATE_OUT_OF_RANGE


def age_flag(age_s: float, *, window_s: float) -> NotCounted:
    """Return whether the passage is too old to say anything about the road as it is now."""
    return NotCounted.OLDER_THAN_WINDOW if age_s > window_s else NotCounted.NONE

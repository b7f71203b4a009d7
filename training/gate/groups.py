"""The group that fares worst: a mean over all drives hides a road or a kind of weather that a model gave up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from training.dataset import Runs
from training.designs import EXACT_SUFFIX
from training.gate.contender import Case
from training.gate.thresholds import GroupThresholds
from training.gate.verdict import Check, Found, check_of
from training.study.picture import Axis, Bars
from training.table_models import USE_EDGES_RATIO

FRICTION_BAND_MU = 0.1
_UNKNOWN = "unknown"
_MOST_BARS_COUNT = 40
_ROUNDING_MU = 1e-9


@dataclass(frozen=True, slots=True)
class GroupError:
    """The error within a group.

    Attributes:
        name: Of the group.
        rows_count: Its drives.
        error_ratio: The challenger's mean.
        champion_ratio: The champion's; None without one.
    """

    name: str
    rows_count: int
    error_ratio: float
    champion_ratio: float | None

    def limit_ratio(self, limits: GroupThresholds, *, slack_ratio: float) -> float:
        """Return the largest error that passes."""
        if self.champion_ratio is None:
            return slack_ratio * limits.alone_ratio
        return limits.worse_ratio * self.champion_ratio + limits.allowance_ratio


def groups_of(runs: Runs) -> Mapping[str, NDArray[np.str_]]:
    """Return the name of each drive's group, for each way to group them: road, friction, sensors, use of the grip."""
    label_mu, use_ratio = runs.labels["label_mu"], runs.labels["peak_utilisation_ratio"]
    band = np.floor(label_mu / FRICTION_BAND_MU + _ROUNDING_MU).astype(np.intp)
    use = np.where(np.isfinite(use_ratio), np.searchsorted(USE_EDGES_RATIO, use_ratio, side="right"), -1)
    return {
        "road": np.array([f"road {name}" for name in runs.section_id], dtype=np.str_),
        "friction": np.array(
            [f"friction {FRICTION_BAND_MU * k:.1f} to {FRICTION_BAND_MU * (k + 1):.1f}" for k in band.tolist()],
            dtype=np.str_,
        ),
        "sensors": np.array(
            ["exact sensors" if name.endswith(EXACT_SUFFIX) else "other sensors" for name in runs.scenario],
            dtype=np.str_,
        ),
        "use": np.array([_use_name(k) for k in use.tolist()], dtype=np.str_),
    }


def errors_by_group(case: Case, *, fewest_rows_count: int) -> list[GroupError]:
    """Return the error within every group that has so many drives, in the order of the ways to group them."""
    errors = case.error_ratio(case.challenger)
    champion = None if case.champion is None else case.error_ratio(case.champion)
    found = []
    for names in groups_of(case.runs).values():
        for name in np.unique(names).tolist():
            rows = names == name
            if rows.sum() >= fewest_rows_count and not name.endswith(_UNKNOWN):
                theirs = None if champion is None else float(champion[rows].mean())
                found.append(GroupError(name, int(rows.sum()), float(errors[rows].mean()), theirs))
    return found


def worst_group(case: Case, limits: GroupThresholds, *, slack_ratio: float, required: bool) -> Found:
    """Return whether no group fares worse than it may; the one that is nearest to its limit is named.

    Args:
        case: A hold-out and what is said of it.
        limits: What is asked.
        slack_ratio: So much wider is the limit without a champion.
        required: Whether the challenger fails by it.
    """
    found = errors_by_group(case, fewest_rows_count=limits.fewest_rows_count)
    if not found:
        sentence = f"no group has {limits.fewest_rows_count} drives"
        return Found((check_of("worst_group", case.title, passed=False, required=False, sentence=sentence),))
    worst = max(found, key=lambda each: each.error_ratio / each.limit_ratio(limits, slack_ratio=slack_ratio))
    limit = worst.limit_ratio(limits, slack_ratio=slack_ratio)
    broken_count = sum(each.error_ratio > each.limit_ratio(limits, slack_ratio=slack_ratio) for each in found)
    than = "" if worst.champion_ratio is None else f", the champion's {100 * worst.champion_ratio:.2f} %"
    check: Check = check_of(
        "worst_group",
        case.title,
        passed=broken_count == 0,
        required=required,
        figures={
            "error_ratio": worst.error_ratio,
            **({} if worst.champion_ratio is None else {"champion_error_ratio": worst.champion_ratio}),
            "rows_count": worst.rows_count,
            "groups_count": len(found),
            "broken_count": broken_count,
        },
        limits={"error_ratio": limit},
        sentence=(
            f"{worst.name} ({worst.rows_count} drives) is nearest to its limit of {100 * limit:.2f} %: error "
            f"{100 * worst.error_ratio:.2f} %{than}; {broken_count} of {len(found)} groups are beyond theirs"
        ),
    )
    return Found((check,), (_picture(case, found),))


def _use_name(number: int) -> str:
    if number < 0:
        return f"use {_UNKNOWN}"
    edges = (0.0, *USE_EDGES_RATIO)
    return (
        f"use above {edges[number]:.1f}"
        if number == len(USE_EDGES_RATIO)
        else (f"use {edges[number]:.1f} to {edges[number + 1]:.1f}")
    )


def _picture(case: Case, found: list[GroupError]) -> Bars:
    roads = [each for each in found if each.name.startswith("road ")]
    others = [each for each in found if not each.name.startswith("road ")]
    worst_roads = sorted(roads, key=lambda each: -each.error_ratio)[: max(0, _MOST_BARS_COUNT - len(others))]
    shown = [*others, *worst_roads]
    groups = [("challenger", tuple(100.0 * each.error_ratio for each in shown))]
    if case.champion is not None:
        groups.append(("champion", tuple(100.0 * (each.champion_ratio or 0.0) for each in shown)))
    return Bars(
        title=f"Error by group, {case.title}" + (", worst roads" if len(worst_roads) < len(roads) else ""),
        x_title="group",
        y_axis=Axis("mean error, %", low=0.0),
        names=tuple(each.name for each in shown),
        groups=tuple(groups),
    )

"""Sanity: who slips more at the same demand found less grip, not much more.

*Held fixed* is the demand: the road, the speed, the steering, the forces and yaw rate (`force_*`, `yaw_rate_max_*`) and
the grip that was asked for (`demand_q*_mu`). *Scaled* is the measured slip: sideslip, its rate, and the yaw rate beyond
what the steering asks for. A factor on a signal scales its mean, deviation, quantiles and ends, and leaves skewness and
kurtosis as they are, so that the row still is one that a drive can have.

The newer table also holds what a physical inverse makes of the same drive (`grip_*`). In the first move it stays as it
was: that asks the trees about the slip alone. In the second it reads the slip for what it is: its best friction
and its likelihoods of friction move down by the same factor, and so the share of the grip that was used
(`demand_*_use_ratio`) moves up; distances between frictions, told in logarithms, stay.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from roadgrip.features import PROFILE_FRICTIONS_MU, FeatureTable
from roadgrip.units import FloatArray
from training.dataset import Runs
from training.error_model import LEAST_MU
from training.gate.contender import Contender, mu_of_rows
from training.gate.thresholds import MonotoneThresholds
from training.gate.verdict import Check, Found, check_of, joined
from training.study.picture import Axis, Line, Lines

Move: TypeAlias = Callable[[FloatArray, FeatureTable, float], FloatArray]
"""From rows, their table and a factor to rows with so much more slip."""

_SLIP_SIGNALS = ("sideslip_", "yaw_rate_excess_")
_SHAPES = ("_skewness", "_kurtosis")
_BEST_NAME = "grip_all_best_mu"


def with_more_slip(rows: FloatArray, table: FeatureTable, factor: float) -> FloatArray:
    """Return rows whose measured slip is scaled, within the table's ranges. (n, columns)"""
    slip = [i for i, n in enumerate(table.names) if n.startswith(_SLIP_SIGNALS) and not n.endswith(_SHAPES)]
    moved = rows.copy()
    moved[:, slip] *= factor
    return np.clip(moved, table.minimum, table.maximum)


def with_less_found(rows: FloatArray, table: FeatureTable, factor: float) -> FloatArray:
    """Return rows with more slip that the physical inverse reads as so much less friction. (n, columns)

    Args:
        rows: Features. (n, columns)
        table: Of the rows; it has the features of the inverse.
        factor: Above one.
    """
    moved = with_more_slip(rows, table, factor)
    moved[:, table.index(_BEST_NAME)] /= factor
    used = [i for i, name in enumerate(table.names) if name.startswith("demand_") and name.endswith("_use_ratio")]
    moved[:, used] *= factor
    profile = table.columns([f"grip_profile_{100 * mu:.0f}_ratio" for mu in PROFILE_FRICTIONS_MU])
    log_mu = np.log(PROFILE_FRICTIONS_MU)
    # What was said of a friction is now said of one that is smaller by the factor.
    moved[:, profile] = [np.interp(log_mu + np.log(factor), log_mu, row) for row in rows[:, profile]]
    return np.clip(moved, table.minimum, table.maximum)


def moves_of(table: FeatureTable) -> Mapping[str, Move]:
    """Return the ways to give a row of a table more slip, by name."""
    moves: dict[str, Move] = {"slip alone": with_more_slip}
    return moves | ({"slip and inverse": with_less_found} if _BEST_NAME in table.names else {})


def monotone_sanity(
    contender: Contender, holdouts: Mapping[str, Runs], limits: MonotoneThresholds, *, rng: np.random.Generator
) -> Found:
    """Return whether more slip at equal demand never means much more grip.

    Args:
        contender: Its newest table's models are asked.
        holdouts: Ordinary drives by the title of the hold-out, in the columns of that table, all usable.
        limits: What is asked.
        rng: Chooses rows where there are too many.
    """
    return joined(
        _of_rows(contender, _some(runs, limits.most_rows_count, rng=rng), limits, title=title, name=name, move=move)
        for title, runs in holdouts.items()
        for name, move in moves_of(runs.table).items()
    )


def _of_rows(
    contender: Contender, runs: Runs, limits: MonotoneThresholds, *, title: str, name: str, move: Move
) -> Found:
    factors = limits.factors_ratio
    changes = [_log_change(contender, runs, move(runs.features, runs.table, factor)) for factor in factors]
    means = [float(change.mean()) for change in changes]
    steep = [float((change > np.log1p(limits.steep_rise_ratio)).mean()) for change in changes]
    return Found(
        (_check(title, name, means, steep, limits),),
        (_picture(title, name, changes, factors),),
    )


def _check(title: str, name: str, means: Sequence[float], steep: Sequence[float], limits: MonotoneThresholds) -> Check:
    mean, share = max(means), max(steep)
    return check_of(
        "monotone_sanity",
        f"{title}, {name}",
        passed=mean <= limits.mean_rise_ratio and share <= limits.steep_frac,
        figures={"mean_rise_ratio": mean, "steep_frac": share},
        limits={"mean_rise_ratio": limits.mean_rise_ratio, "steep_frac": limits.steep_frac},
        sentence=(
            f"with up to {max(limits.factors_ratio):g} times the slip the estimate changes by {100 * mean:+.2f} % in "
            f"the mean where it rises most ({100 * limits.mean_rise_ratio:+.2f} % at most), and rises by more than "
            f"{100 * limits.steep_rise_ratio:g} % in {100 * share:.1f} % of the drives ({100 * limits.steep_frac:g} %)"
        ),
    )


def _log_change(contender: Contender, runs: Runs, moved: FloatArray) -> FloatArray:
    before, after = (
        np.maximum(np.nan_to_num(mu_of_rows(contender, rows, runs.section_id, table=runs.table)), LEAST_MU)
        for rows in (runs.features, moved)
    )
    change: FloatArray = np.log(after / before)
    return change


def _some(runs: Runs, most_rows_count: int, *, rng: np.random.Generator) -> Runs:
    if len(runs) <= most_rows_count:
        return runs
    return runs.rows(np.sort(rng.choice(len(runs), most_rows_count, replace=False)))


def _picture(title: str, name: str, changes: Sequence[FloatArray], factors_ratio: tuple[float, ...]) -> Lines:
    quantiles = [np.quantile(change, [0.05, 0.95]).tolist() for change in changes]
    line = Line(
        "mean, and nine tenths of the drives",
        (1.0, *factors_ratio),
        (0.0, *(100.0 * float(change.mean()) for change in changes)),
        low=(0.0, *(100.0 * low for low, _ in quantiles)),
        high=(0.0, *(100.0 * high for _, high in quantiles)),
    )
    return Lines(
        title=f"More slip at equal demand, {title}, {name}",
        x_axis=Axis("factor on the slip"),
        y_axis=Axis("change of the estimate's logarithm, %"),
        lines=(line,),
    )

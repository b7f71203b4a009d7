"""The error of what a unit publishes: the friction interval of fifty passages of one road and friction.

The unit's own rule places it, on the passages that the unit would count, bounds of doubtful ones at their estimates as
the unit's median takes them. The truth is what a new tyre finds: the road's base friction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roadgrip.units import FloatArray
from training.designs import TWO_FRICTIONS_SUFFIX
from training.gate.contender import Answers, Case
from training.gate.thresholds import IntervalThresholds
from training.gate.verdict import Found, check_of, joined
from training.study.batches import P95_FRAC, Cell, answers_of_cell, cells_of, published_rule
from training.study.picture import Axis, Bars


def interval_error(cases: Sequence[Case], limits: IntervalThresholds, *, seed: int) -> Found:
    """Return whether intervals are as near to the truth as they should be, for each hold-out of ordinary drives.

    A hold-out with too few passages at one friction of a road says nothing, and is said to; if none says anything, the
    challenger fails.

    Args:
        cases: Hold-outs of ordinary drives.
        limits: What is asked.
        seed: Draws the batches, the same for both bundles.
    """
    found = joined(_of_case(case, limits, seed=seed) for case in cases)
    if any(check.required for check in found.checks):
        return found
    none = check_of(
        "interval_error", "all hold-outs", passed=False, sentence="no hold-out has enough passages for an interval"
    )
    return Found((*found.checks, none))


def interval_errors_ratio(
    case: Case, answers: Answers, limits: IntervalThresholds, *, seed: int
) -> dict[float, FloatArray]:
    """Return how far intervals are from what a new tyre finds, in parts of it, by base friction. Each (batches,)

    Cells that a unit would count too few passages of are left out.
    """
    rule = published_rule(answers.mu)
    errors: dict[float, list[FloatArray]] = {}
    for cell in _cells(case, answers, fewest_rows_count=limits.fewest_rows_count):
        middles_mu = answers_of_cell(
            cell, rule, size_count=limits.passages_count, batches_count=limits.batches_count, seed=seed
        )
        errors.setdefault(cell.base_friction_mu, []).append(np.abs(middles_mu / cell.midpoint_mu - 1.0))
    return {friction_mu: np.concatenate(errors[friction_mu]) for friction_mu in sorted(errors)}


def _of_case(case: Case, limits: IntervalThresholds, *, seed: int) -> Found:
    ours = interval_errors_ratio(case, case.challenger, limits, seed=seed)
    theirs = {} if case.champion is None else interval_errors_ratio(case, case.champion, limits, seed=seed)
    if not ours:
        sentence = f"no road has {limits.fewest_rows_count} passages that count at one friction"
        required = bool(theirs)  # the champion would have published an interval
        return Found((check_of("interval_error", case.title, passed=False, required=required, sentence=sentence),))
    mean, p95 = _figures(ours)
    figures = {"mean_ratio": mean, "p95_ratio": p95}
    if theirs:
        champion_mean, champion_p95 = _figures(theirs)
        figures |= {"champion_mean_ratio": champion_mean, "champion_p95_ratio": champion_p95}
        mean_limit = limits.worse_ratio * champion_mean + limits.allowance_ratio
        p95_limit = limits.worse_ratio * champion_p95 + limits.allowance_ratio
        than = f"; the champion's {100 * champion_mean:.2f} % and {100 * champion_p95:.2f} %"
    else:
        mean_limit, p95_limit, than = limits.alone_mean_ratio, limits.alone_p95_ratio, ""
    check = check_of(
        "interval_error",
        case.title,
        passed=mean <= mean_limit and p95 <= p95_limit,
        figures=figures,
        limits={"mean_ratio": mean_limit, "p95_ratio": p95_limit},
        sentence=(
            f"intervals of {limits.passages_count} passages are off by {100 * mean:.2f} % in the mean "
            f"({100 * mean_limit:.2f} % at most), 95 % of them by at most {100 * p95:.2f} % ({100 * p95_limit:.2f} %)"
            f"{than}"
        ),
    )
    return Found((check,), (_picture(case, ours, theirs),))


def _cells(case: Case, answers: Answers, *, fewest_rows_count: int) -> list[Cell]:
    # Where the friction drops along the road there is no one truth.
    one_friction = ~np.char.endswith(np.array(case.runs.scenario, dtype=np.str_), TWO_FRICTIONS_SUFFIX)
    base_mu = case.runs.labels["base_friction_mu"]
    rows = np.flatnonzero(one_friction & answers.counted & (base_mu > 0.0))
    cells = cells_of(case.runs.section_id, base_mu, rows=rows)
    return [cell for cell in cells if len(cell.rows) >= fewest_rows_count]


def _figures(errors: dict[float, FloatArray]) -> tuple[float, float]:
    every = np.concatenate(list(errors.values()))
    return float(every.mean()), float(np.quantile(every, P95_FRAC))


def _picture(case: Case, ours: dict[float, FloatArray], theirs: dict[float, FloatArray]) -> Bars:
    frictions_mu = sorted({*ours, *theirs})

    def heights(errors: dict[float, FloatArray]) -> tuple[float, ...]:
        return tuple(100.0 * float(errors[mu].mean()) if mu in errors else float("nan") for mu in frictions_mu)

    groups = [("challenger", heights(ours))] + ([("champion", heights(theirs))] if theirs else [])
    return Bars(
        title=f"Error of the published interval, {case.title}",
        x_title="base friction",
        y_axis=Axis("mean error of mu_new, %", low=0.0),
        names=tuple(f"{mu:.2f}" for mu in frictions_mu),
        groups=tuple(groups),
    )

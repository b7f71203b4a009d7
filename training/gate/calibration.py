"""Whether what a bundle says of its own errors is true: bounds hold as often as promised, errors are as expected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from roadgrip.units import BoolArray, FloatArray
from training.gate.contender import Answers, Case
from training.gate.groups import groups_of
from training.gate.thresholds import CalibrationThresholds
from training.gate.verdict import Check, Found, check_of
from training.study.picture import Axis, Line, Lines, Picture

_WIDTHS_RATIO = tuple(round(0.1 * i, 1) for i in range(21))
_TENTHS_COUNT = 10


def stated_share_ratio(answers: Answers, label_mu: FloatArray) -> FloatArray:
    """Return how far the truth lies from each statement, as a share of the way to its bound: above 1 it does not hold.

    One that says "at least" is only wrong where there is less than it says. NaN without bounds. (n,)

    Args:
        answers: What a bundle says of drives.
        label_mu: The truth. (n,)
    """
    judged_mu = np.where(answers.at_least, np.minimum(label_mu, answers.mu), label_mu)
    reach = np.log(answers.mu / answers.mu_low)
    share: FloatArray = np.abs(np.log(judged_mu / answers.mu)) / reach
    return share


def calibration(case: Case, limits: CalibrationThresholds, *, required: bool) -> Found:
    """Return whether bounds hold overall and in every group, and whether errors are about as large as was expected.

    Args:
        case: A hold-out and what is said of it.
        limits: What is asked.
        required: Whether the challenger fails by it.
    """
    answers, label_mu = case.challenger, case.label_mu
    told = np.isfinite(answers.mu_low)
    if not told.any():
        sentence = "the bundle does not say how far an estimate may be off"
        return Found(
            (check_of("coverage", case.title, passed=False, required=required and limits.required, sentence=sentence),)
        )
    held = stated_share_ratio(answers, label_mu) <= 1.0
    groups = _group_coverage(case, held, told, fewest_rows_count=limits.fewest_rows_count)
    checks = (
        _coverage(case, held[told], limits, required=required),
        *([_worst_coverage(case, groups, limits, required=required)] if groups else []),
        _expected_error(case, told, limits, required=required),
    )
    return Found(checks, _pictures(case))


def _coverage(case: Case, held: BoolArray, limits: CalibrationThresholds, *, required: bool) -> Check:
    answers = case.challenger
    promised = float(np.nanmean(answers.promised_frac))
    coverage, lowest = float(held.mean()), promised - limits.shortfall_frac
    named = np.isfinite(answers.mu_low) & ~answers.at_least
    width = float(np.median(np.log(answers.mu_high[named] / answers.mu_low[named]))) if named.any() else float("nan")
    at_least_frac = float(answers.at_least.mean())
    return check_of(
        "coverage",
        case.title,
        passed=lowest <= coverage <= limits.highest_frac,
        required=required,
        figures={"coverage_frac": coverage, "width_ratio": width, "at_least_frac": at_least_frac},
        limits={"lowest_frac": lowest, "highest_frac": limits.highest_frac},
        sentence=(
            f"{100 * coverage:.1f} % of the statements hold, {100 * promised:.0f} % are promised "
            f"({100 * lowest:.1f} to {100 * limits.highest_frac:.1f} % pass); {100 * at_least_frac:.1f} % are bounds "
            f"only, the others' bounds are {100 * width:.1f} % apart in the median"
        ),
    )


def _group_coverage(
    case: Case, held: BoolArray, told: BoolArray, *, fewest_rows_count: int
) -> dict[str, tuple[float, int]]:
    """Return coverage and number of drives of every group that is large enough. Whole roads are no group here.

    Passages of one road err together, so that the coverage on one is hit or miss even of a perfect bundle.
    """
    found = {}
    for way, names in groups_of(case.runs).items():
        for name in np.unique(names).tolist() if way != "road" else []:
            rows = (names == name) & told
            if rows.sum() >= fewest_rows_count:
                found[name] = float(held[rows].mean()), int(rows.sum())
    return found


def _worst_coverage(
    case: Case, groups: dict[str, tuple[float, int]], limits: CalibrationThresholds, *, required: bool
) -> Check:
    promised = float(np.nanmean(case.challenger.promised_frac))
    name, (coverage, rows_count) = min(groups.items(), key=lambda each: each[1][0])
    lowest = promised - limits.group_shortfall_frac
    return check_of(
        "worst_coverage",
        case.title,
        passed=coverage >= lowest,
        required=required,
        figures={"coverage_frac": coverage, "rows_count": rows_count, "groups_count": len(groups)},
        limits={"lowest_frac": lowest},
        sentence=(
            f"statements hold least often in the group {name} ({rows_count} drives): {100 * coverage:.1f} %, "
            f"{100 * lowest:.1f} % at least"
        ),
    )


def _expected_error(case: Case, told: BoolArray, limits: CalibrationThresholds, *, required: bool) -> Check:
    came = float(case.error_ratio(case.challenger)[told].mean())
    expected = float(case.challenger.expected_error_ratio[told].mean())
    ratio = expected / max(came, 1e-9)
    low, high = limits.lowest_expected_ratio, limits.highest_expected_ratio
    return check_of(
        "expected_error",
        case.title,
        passed=low <= ratio <= high,
        required=required,
        figures={"expected_ratio": expected, "came_ratio": came, "expected_over_came_ratio": ratio},
        limits={"lowest_ratio": low, "highest_ratio": high},
        sentence=(
            f"errors of {100 * expected:.2f} % were expected in the mean, {100 * came:.2f} % came: {ratio:.2f} times, "
            f"{low:g} to {high:g} pass"
        ),
    )


def _pictures(case: Case) -> tuple[Picture, ...]:
    both = {"challenger": case.challenger} | ({} if case.champion is None else {"champion": case.champion})
    both = {name: answers for name, answers in both.items() if np.isfinite(answers.mu_low).any()}
    coverage = tuple(
        Line(name, _WIDTHS_RATIO, tuple(_coverage_at(answers, case.label_mu, width) for width in _WIDTHS_RATIO))
        for name, answers in both.items()
    )
    told = tuple(_expectation_line(name, case, answers) for name, answers in both.items())
    highest = max((max(*line.x, *line.y) for line in told), default=1.0)
    return (
        Lines(
            title=f"Share of statements that hold if bounds were wider or narrower, {case.title}",
            x_axis=Axis("width over the bundle's own", low=0.0, high=2.0),
            y_axis=Axis("share that holds, %", low=0.0, high=100.0),
            lines=coverage,
        ),
        Lines(
            title=f"Error that came against error expected, tenths of the drives, {case.title}",
            x_axis=Axis("mean error expected, %", low=0.0),
            y_axis=Axis("mean error that came, %", low=0.0),
            lines=(*told, Line("as expected", (0.0, highest), (0.0, highest), dashed=True)),
        ),
    )


def _coverage_at(answers: Answers, label_mu: FloatArray, width_ratio: float) -> float:
    share = stated_share_ratio(answers, label_mu)
    return 100.0 * float((share[np.isfinite(share)] <= width_ratio).mean())


def _expectation_line(name: str, case: Case, answers: Answers) -> Line:
    told = np.flatnonzero(np.isfinite(answers.expected_error_ratio))
    order = told[np.argsort(answers.expected_error_ratio[told], kind="stable")]
    came = case.error_ratio(answers)
    tenths: list[NDArray[np.intp]] = [tenth for tenth in np.array_split(order, _TENTHS_COUNT) if len(tenth)]
    return Line(
        name,
        tuple(100.0 * float(answers.expected_error_ratio[tenth].mean()) for tenth in tenths),
        tuple(100.0 * float(came[tenth].mean()) for tenth in tenths),
    )

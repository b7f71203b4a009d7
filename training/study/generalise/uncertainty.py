"""Knowing what it does not know: errors to expect, intervals that hold, and passages that only say "at least"."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import pairwise

import numpy as np

from roadgrip.bundle import Conformal
from roadgrip.units import BoolArray, FloatArray
from training.conformal import GROUP_SHORTFALL_FRAC
from training.study.chapter import Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import identity_line, per_cent
from training.study.folds import FOLDS_COUNT, LEARNED_SETS
from training.study.generalise.doubt import Intervals, best_threshold, intervals, told_apart_frac
from training.study.generalise.held_out import (
    SUREST_FRAC,
    UTILISATION_BANDS,
    HeldOut,
    band_name,
    band_of,
    by_use,
    held_out,
    mean_by_road,
    surest,
)
from training.study.picture import Axis, Bars, Line, Lines, Picture
from training.study.recipes import BEST_RECIPE
from training.study.wording import by_grade, leading_grade, per_cent_words
from training.table_figures import holds
from training.table_models import COVERAGE_FRAC, FRICTION_EDGES_MU, LITTLE_USE_RATIO, Answers, calibrated
from vehicle_client.simulator.plan import SensorGrade

DECILES_COUNT = 10
RIGHT_RATIO = 1.25
"""Errors that are found are about those expected if no tenth differs by a larger factor."""
CLASSES_COUNT = 5
EVEN_FRAC = 0.05
"""So much less often may intervals hold in the worst band."""
RARELY_HELD_FRAC = 0.7
"""A road on which fewer of the intervals hold the truth is one where the unit is surer than it may be."""

REGRESSOR, WIDTH, USE = "second regressor", "width of the likelihood", "share of the grip it seems to have used"
CONSTANT, SCALED = "one width for all", "by the error to expect"
BY_EXPECTED, BY_USE = "the same, by class of expected error", "the same, by share of the grip it seems to have used"


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Judge errors to expect, intervals and bounds on held-out roads."""
    judged = held_out(bench, grade, BEST_RECIPE)
    signals = signals_of(judged)
    ways = ways_of(judged)
    advice = recommended(judged)
    figures = {
        **_signal_figures(judged, signals),
        **_interval_figures(judged, ways),
        **_censoring_figures(judged, advice),
        **_stated_figures(judged, advice),
        "calibration.worst_ratio": _worst_calibration_ratio(judged),
        "recommended.coverage_frac": advice.coverage_frac,
        "recommended.quantile": advice.quantile,
        "recommended.doubtful_above_ratio": advice.doubtful_above_ratio,
    }
    return Result(
        figures=figures,
        sizes={
            "passages": len(judged),
            "roads": len(set(judged.roads)),
            "folds, by road": FOLDS_COUNT,
            f"passages that used less than {LITTLE_USE_RATIO:.2f} of the grip": int(_shy(judged).sum()),
            "seed": bench.seed,
        },
        tables=(
            _signal_table(figures, signals),
            _interval_table(judged, ways),
            _censoring_table(judged, advice),
            _stated_table(judged, advice),
        ),
        pictures=_pictures(judged, ways, advice, grade),
    )


def signals_of(judged: HeldOut) -> dict[str, FloatArray]:
    """Return what might tell a doubtful estimate from a sure one, by name: the more, the more doubtful. Each (m,)"""
    return {
        REGRESSOR: judged.expected_error_ratio,
        WIDTH: judged.column("grip_all_above_1sd_ratio") + judged.column("grip_all_below_1sd_ratio"),
        USE: -seeming_use_ratio(judged),
    }


def seeming_use_ratio(judged: HeldOut) -> FloatArray:
    """Return the largest force that was asked of the road over what there seems to have been. (m,)"""
    return judged.column("demand_q100_mu") / np.maximum(judged.mu, 1e-3)


def ways_of(judged: HeldOut) -> dict[str, Intervals]:
    """Return intervals by the ways of placing them."""
    nothing = np.zeros(len(judged), dtype=np.intp)
    expected = judged.expected_error_ratio
    edges = np.quantile(expected, np.linspace(0.0, 1.0, CLASSES_COUNT + 1)[1:-1])
    use_edges = np.array([band[0] for band in UTILISATION_BANDS[1:]])
    placed = partial(intervals, judged, coverage_frac=COVERAGE_FRAC)
    return {
        CONSTANT: placed(scale_ratio=np.ones(len(judged)), class_number=nothing),
        SCALED: placed(scale_ratio=expected, class_number=nothing),
        BY_EXPECTED: placed(scale_ratio=expected, class_number=np.searchsorted(edges, expected)),
        BY_USE: placed(scale_ratio=expected, class_number=np.searchsorted(use_edges, seeming_use_ratio(judged))),
    }


def recommended(judged: HeldOut) -> Conformal:
    """Return what a bundle with such models should say of their expected errors.

    As `training.table_models` finds it for a bundle: doubtful is what has more error to expect than the value that best
    parts passages that used less than a third of the grip from the others (Youden's index), and more than errors that
    need no excuse.

    Args:
        judged: Passages on roads of which nothing was learned.
    """
    return calibrated(
        Answers(judged.mu, judged.expected_error_ratio),
        {"label_mu": judged.label_mu, "peak_utilisation_ratio": judged.utilisation_ratio},
        rows=np.ones(len(judged), dtype=np.bool_),
    )


def _shy(judged: HeldOut) -> BoolArray:
    return judged.utilisation_ratio < LITTLE_USE_RATIO


def _kept_mape(judged: HeldOut, signal: FloatArray) -> float:
    return float(judged.error_ratio[surest(signal, kept_frac=SUREST_FRAC)].mean())


def _signal_figures(judged: HeldOut, signals: Mapping[str, FloatArray]) -> dict[str, float]:
    figures = {"kept_mape.nothing": judged.mape_ratio, "kept_mape.the errors": _kept_mape(judged, judged.error_ratio)}
    for name, signal in signals.items():
        figures[f"kept_mape.{name}"] = _kept_mape(judged, signal)
        figures[f"told_apart.{name}"] = told_apart_frac(signal, _shy(judged))
    return figures


def _interval_figures(judged: HeldOut, ways: Mapping[str, Intervals]) -> dict[str, float]:
    figures = {}
    for name, found in ways.items():
        held = mean_by_road(found.holds.astype(np.float64), judged.roads)
        figures[f"held.{name}"] = float(found.holds.mean())
        figures[f"held_in_worst_band.{name}"] = min(_by_band(judged, found.holds.astype(np.float64)).values())
        figures[f"rarely_held_roads.{name}"] = float(np.mean(held < RARELY_HELD_FRAC))
        figures[f"half_width.{name}"] = float(found.half_width_ratio.mean())
    return figures


def _doubtful(judged: HeldOut, advice: Conformal) -> BoolArray:
    """Return which passages only say "at least". (m,)"""
    return judged.expected_error_ratio > advice.doubtful_above_ratio


def _bound(judged: HeldOut, advice: Conformal) -> FloatArray:
    return judged.mu * np.exp(-advice.quantile * judged.expected_error_ratio)


def _censoring_figures(judged: HeldOut, advice: Conformal) -> dict[str, float]:
    shy, doubtful = _shy(judged), _doubtful(judged, advice)
    bound, demand = _bound(judged, advice), judged.column("demand_q100_mu")
    use = seeming_use_ratio(judged)
    figures = {"used_below": -best_threshold(-use, shy)}
    for name, said in (("at_least", doubtful), ("at_least_by_use", use < figures["used_below"])):
        figures[f"{name}.share"] = float(said.mean())
        figures[f"{name}.of_shy"] = _mean_of(said, shy)
        figures[f"{name}.of_others"] = _mean_of(said, ~shy)
        figures[f"{name}.named_mape"] = _mean_of(judged.error_ratio, ~said)
    for name, low in (("bound", bound), ("demand", demand)):
        figures[f"{name}.held"] = float(np.mean(low <= judged.label_mu))
        figures[f"{name}.held_at_least"] = _mean_of(low <= judged.label_mu, doubtful)
        figures[f"{name}.share_of_truth_at_least"] = _mean_of(low / judged.label_mu, doubtful)
    return figures


def _stated(judged: HeldOut, advice: Conformal) -> BoolArray:
    """Return where what is said holds: of an "at least" the bound, of the others the interval. (m,)"""
    return holds(Answers(judged.mu, judged.expected_error_ratio), judged.label_mu, advice)


def _groups(judged: HeldOut) -> dict[str, BoolArray]:
    """Return the passages by friction and by the share of the grip that they used, groups that are not empty."""
    by_friction = {
        f"friction {band_name(band)}": band_of(judged.label_mu, band)
        for band in pairwise((0.0, *FRICTION_EDGES_MU, np.inf))
    }
    used = {f"used {band}": chosen for band, chosen in by_use(judged.utilisation_ratio).items()}
    return {name: chosen for name, chosen in (by_friction | used).items() if chosen.any()}


def _stated_figures(judged: HeldOut, advice: Conformal) -> dict[str, float]:
    held = _stated(judged, advice)
    by_group = [float(held[chosen].mean()) for chosen in _groups(judged).values()]
    return {"stated.held": float(held.mean()), "stated.held_in_worst_group": min(by_group)}


def _stated_table(judged: HeldOut, advice: Conformal) -> Table:
    held, doubtful = _stated(judged, advice), _doubtful(judged, advice)
    everything = np.ones(len(judged), dtype=np.bool_)
    rows: list[tuple[Cell, ...]] = [
        (name, int(chosen.sum()), per_cent(float(doubtful[chosen].mean())), per_cent(float(held[chosen].mean())))
        for name, chosen in ({"all": everything} | _groups(judged)).items()
    ]
    return Table(
        "How often what is said holds, intervals and bounds, as a bundle would say it",
        ("passages with", "passages", "say at least, %", "holds, %"),
        tuple(rows),
        note=f"Asked for: {per_cent(advice.coverage_frac):.0f} % over all, and at most "
        f"{per_cent(GROUP_SHORTFALL_FRAC):.0f} % fewer in any group. By the truth, which nobody knows on the road.",
    )


def _mean_of(values: FloatArray | BoolArray, chosen: BoolArray) -> float:
    return float(np.mean(values[chosen])) if chosen.any() else np.nan


def _by_band(judged: HeldOut, values: FloatArray) -> dict[str, float]:
    """Return the mean of some values by utilisation, for bands that have passages."""
    bands = by_use(judged.utilisation_ratio)
    return {name: float(values[chosen].mean()) for name, chosen in bands.items() if chosen.any()}


def _deciles(judged: HeldOut) -> tuple[FloatArray, FloatArray]:
    """Return expected and found error, means over tenths of the passages by the error to expect. (10,) each"""
    order = np.argsort(judged.expected_error_ratio, kind="stable")
    tenths = np.array_split(order, DECILES_COUNT)
    found = np.abs(judged.log_ratio)
    expected_mean = np.array([judged.expected_error_ratio[tenth].mean() for tenth in tenths])
    return expected_mean, np.array([found[tenth].mean() for tenth in tenths])


def _worst_calibration_ratio(judged: HeldOut) -> float:
    """Return by how much found and expected error differ in the worst tenth, as a factor above one."""
    expected, found = _deciles(judged)
    return float(np.exp(np.abs(np.log(found / expected)).max()))


def _signal_table(figures: Mapping[str, float], signals: Mapping[str, FloatArray]) -> Table:
    rows: list[tuple[Cell, ...]] = [("none, all are kept", per_cent(figures["kept_mape.nothing"]), None)]
    rows += [(name, per_cent(figures[f"kept_mape.{name}"]), figures[f"told_apart.{name}"]) for name in signals]
    rows.append(("the errors themselves, which nobody knows", per_cent(figures["kept_mape.the errors"]), None))
    return Table(
        f"What tells doubtful passages: MAPE of the {per_cent(SUREST_FRAC):.0f} % that seem surest",
        ("by", "MAPE %", "tells those that used less than a third"),
        tuple(rows),
        note="Last column: how often a passage that used less than a third of the grip seems more doubtful than "
        "another one; 0.5 is chance, 1 is always.",
    )


def _interval_table(judged: HeldOut, ways: Mapping[str, Intervals]) -> Table:
    bands = list(_by_band(judged, judged.utilisation_ratio))
    rows: list[tuple[Cell, ...]] = []
    for name, found in ways.items():
        held = _by_band(judged, found.holds.astype(np.float64))
        by_road = mean_by_road(found.holds.astype(np.float64), judged.roads)
        rows.append(
            (
                name,
                per_cent(float(found.holds.mean())),
                *(per_cent(held[band]) for band in bands),
                per_cent(float(np.mean(by_road < RARELY_HELD_FRAC))),
                per_cent(float(found.half_width_ratio.mean())),
            )
        )
    return Table(
        f"Intervals that shall hold the truth in {per_cent(COVERAGE_FRAC):.0f} % of the passages",
        (
            "how wide",
            "hold, %",
            *(f"used {band}: hold, %" for band in bands),
            f"roads where fewer than {per_cent(RARELY_HELD_FRAC):.0f} % hold, %",
            "mean half-width, %",
        ),
        tuple(rows),
        note="Placed by passages on other roads. By the largest share of the grip used, which nobody knows on the "
        "road. Half-widths on the logarithm of friction. A bundle holds the second way.",
    )


def _censoring_table(judged: HeldOut, advice: Conformal) -> Table:
    doubtful = _doubtful(judged, advice)
    bound, demand = _bound(judged, advice), judged.column("demand_q100_mu")
    rows: list[tuple[Cell, ...]] = []
    for band, chosen in by_use(judged.utilisation_ratio).items():
        told = chosen & doubtful
        rows.append(
            (
                band,
                int(chosen.sum()),
                *(
                    per_cent(value) if np.isfinite(value) else None
                    for value in (
                        _mean_of(doubtful, chosen),
                        _mean_of(bound <= judged.label_mu, told),
                        _mean_of(bound / judged.label_mu, told),
                        _mean_of(demand <= judged.label_mu, told),
                        _mean_of(demand / judged.label_mu, told),
                        _mean_of(judged.error_ratio, chosen & ~doubtful),
                    )
                ),
            )
        )
    return Table(
        f'Passages that say "at least": those with more than {per_cent(advice.doubtful_above_ratio):.1f} % to expect',
        (
            "share of the grip used",
            "passages",
            "say at least, %",
            "bound holds, %",
            "bound, % of the truth",
            "demand holds, %",
            "demand, % of the truth",
            "the others' MAPE, %",
        ),
        tuple(rows),
        note="Demand: the largest force that was asked, which the road gave; the bound that needs no model of error.",
    )


def _pictures(
    judged: HeldOut, ways: Mapping[str, Intervals], advice: Conformal, grade: SensorGrade
) -> tuple[Picture, ...]:
    expected, found = _deciles(judged)
    highest = 105.0 * float(max(expected.max(), found.max()))
    said = _by_band(judged, _doubtful(judged, advice).astype(np.float64))
    held = {name: _by_band(judged, way.holds.astype(np.float64)) for name, way in ways.items()}
    return (
        Lines(
            f"Found against expected error on roads never seen, {grade} sensors",
            Axis("expected error, %, means of tenths", low=0.0, high=highest),
            Axis("found error, %", low=0.0, high=highest),
            (
                Line("tenths of the passages", tuple((100.0 * expected).tolist()), tuple((100.0 * found).tolist())),
                identity_line(0.0, highest, name="found = expected"),
            ),
        ),
        Bars(
            f"How often intervals hold the truth, {grade} sensors",
            "largest share of the grip used",
            Axis("%", low=0.0, high=100.0),
            tuple(said),
            tuple((name, tuple(per_cent(values[band]) for band in said)) for name, values in held.items()),
        ),
        Bars(
            f'Passages that say "at least", {grade} sensors',
            "largest share of the grip used",
            Axis("%", low=0.0, high=100.0),
            tuple(said),
            (("say at least", tuple(per_cent(value) for value in said.values())),),
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say whether the regressor knows what it does not know."""
    grade = leading_grade(results)
    figures = results[grade].figures
    kept = {name: figures[f"kept_mape.{name}"] for name in (REGRESSOR, WIDTH, USE)}
    best = min(kept, key=lambda name: kept[name])
    right = figures["calibration.worst_ratio"] <= RIGHT_RATIO
    even = figures[f"held_in_worst_band.{SCALED}"] >= COVERAGE_FRAC - EVEN_FRAC
    text = (
        f"Without the fifth of the passages that seem most doubtful the error on roads never seen falls from "
        f"{by_grade(results, 'kept_mape.nothing')} to {by_grade(results, f'kept_mape.{REGRESSOR}')}, by a second "
        f"regressor that learned what the first one got wrong; {best} tells best with {grade} sensors. What it expects "
        f"is {'about what is found' if right else 'not what is found'}: in the worst tenth they differ by a factor of "
        f"{figures['calibration.worst_ratio']:.2f}. Intervals as wide as it says hold the truth in "
        f"{by_grade(results, f'held.{SCALED}')} of the passages where {per_cent_words(COVERAGE_FRAC)} are asked for, "
        f"{'whatever' if even else 'but not whatever'} share of the grip was used: in the worst band they hold in "
        f"{by_grade(results, f'held_in_worst_band.{SCALED}')}, one width for all in "
        f"{by_grade(results, f'held_in_worst_band.{CONSTANT}')}. On "
        f"{by_grade(results, f'rarely_held_roads.{SCALED}')} of the roads fewer than "
        f"{per_cent_words(RARELY_HELD_FRAC)} hold: passages of one road err alike. If an expected error above "
        f'{by_grade(results, "recommended.doubtful_above_ratio")} makes an estimate an "at least", '
        f"{by_grade(results, 'at_least.of_shy')} of the passages that used less than a third of the grip say so, and "
        f"{by_grade(results, 'at_least.of_others')} of the others; their bounds hold in "
        f"{by_grade(results, 'bound.held_at_least')}, at {by_grade(results, 'bound.share_of_truth_at_least')} of the "
        f"truth, where the force alone that was asked proves "
        f"{by_grade(results, 'demand.share_of_truth_at_least')}. Those that name a friction err by "
        f"{by_grade(results, 'at_least.named_mape')}. The share of the grip that a passage seems to have used tells "
        f"them apart, too: below {by_grade(results, 'used_below')} are {by_grade(results, 'at_least_by_use.of_shy')} "
        f"of those and {by_grade(results, 'at_least_by_use.of_others')} of the others, and the rest errs by "
        f"{by_grade(results, 'at_least_by_use.named_mape')}."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="uncertainty",
    title="Knowing what it does not know",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=LEARNED_SETS,
)

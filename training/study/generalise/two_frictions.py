"""Roads that do not have one friction all along: what it takes to find the lesser one on a road never seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from roadgrip.features import FEATURE_NAMES
from training.study.chapter import Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import per_cent
from training.study.folds import LEARNED_SETS, PAPER_SET, RANDOM_ROADS_SET
from training.study.generalise.held_out import HIGH_UTILISATION_RATIO, HeldOut, held_out, on_other_roads
from training.study.picture import Axis, Line, Lines
from training.study.recipes import BEST_RECIPE, PAPER_RECIPE, Recipe
from training.study.wording import by_grade, leading_grade
from vehicle_client.simulator.plan import SensorGrade

PARTS_PREFIXES = ("grip_parts_", "grip_weak_", "grip_firm_", "demand_weak_")
"""Of the features that tell the slippery part of a drive by itself."""
WITHOUT_PARTS = tuple(name for name in FEATURE_NAMES if not name.startswith(PARTS_PREFIXES))
ONE, TWO = "s-turn", "s-turn-two-frictions"
"""The paper's road with one friction and with two."""


@dataclass(frozen=True, slots=True)
class Way:
    """A way to a regressor.

    Attributes:
        recipe: How it learns, and from which features.
        learned_sets: From which roads.
    """

    recipe: Recipe
    learned_sets: tuple[str, ...]


BEST, UNIFORM, WHOLE, PAPER = "best", "uniform roads alone", "nothing of the parts", "the paper's features"
WAYS: Mapping[str, Way] = {
    BEST: Way(BEST_RECIPE, LEARNED_SETS),
    UNIFORM: Way(BEST_RECIPE, (RANDOM_ROADS_SET,)),
    WHOLE: Way(BEST_RECIPE.on(WITHOUT_PARTS, name="without parts"), LEARNED_SETS),
    PAPER: Way(PAPER_RECIPE, LEARNED_SETS),
}


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Judge every way on uniform roads and on roads of two frictions, of which nothing was learned."""
    figures: dict[str, float] = {}
    bias_by_base: dict[str, dict[float, float]] = {}
    for name, way in WAYS.items():
        uniform, two = (_judged(bench, grade, way, data_set) for data_set in LEARNED_SETS)
        paper = _judged(bench, grade, way, PAPER_SET)
        one_road, two_road = (_on_scenario(paper, scenario) for scenario in (ONE, TWO))
        used = two.utilisation_ratio >= HIGH_UTILISATION_RATIO
        figures |= {
            f"{name}.uniform.mape": uniform.mape_ratio,
            f"{name}.two.mape": two.mape_ratio,
            f"{name}.two.mape_util60": two.part(used).mape_ratio if used.any() else np.nan,
            f"{name}.two.bias": float(two.log_ratio.mean()),
            f"{name}.{ONE}.mape": one_road.mape_ratio,
            f"{name}.{TWO}.mape": two_road.mape_ratio,
        }
        bias_by_base[name] = _bias_by_base(two_road)
        figures[f"{name}.{TWO}.worst_bias"] = max(bias_by_base[name].values(), key=abs)
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            name,
            *(
                per_cent(figures[f"{name}.{what}"])
                for what in ("uniform.mape", "two.mape", "two.mape_util60", f"{ONE}.mape", f"{TWO}.mape")
            ),
            per_cent(figures[f"{name}.{TWO}.worst_bias"]),
        )
        for name in WAYS
    )
    return Result(
        figures=figures,
        sizes={
            "passages on uniform roads": len(uniform),
            "passages on roads of two frictions": len(two),
            "roads of two frictions": len(set(two.roads)),
            "passages on the paper's S-turn": len(one_road),
            "the same with two frictions": len(two_road),
            "seed": bench.seed,
        },
        tables=(
            Table(
                "MAPE on roads of one friction and of two, in %",
                (
                    "regressor",
                    "random roads of one friction",
                    "of two frictions",
                    f"the same, use {HIGH_UTILISATION_RATIO:g} and more",
                    "the paper's S-turn",
                    "the same with two frictions",
                    "its worst bias over base frictions",
                ),
                rows,
                note="Nothing was learned of any road that is judged. Asked for is the lesser friction. Uniform roads "
                "alone: the same features and way of learning, no road of two frictions. Nothing of the parts: without "
                "the figures that tell the slippery part of a drive by itself.",
            ),
        ),
        pictures=(
            Lines(
                f"Bias on the paper's S-turn of two frictions, {grade} sensors",
                Axis("base friction of the slippery turn"),
                Axis("mean error in %"),
                tuple(
                    Line(name, tuple(bias), tuple(per_cent(value) for value in bias.values()))
                    for name, bias in bias_by_base.items()
                ),
            ),
        ),
    )


def _judged(bench: Workbench, grade: SensorGrade, way: Way, data_set: str) -> HeldOut:
    judge = held_out if data_set in way.learned_sets else on_other_roads
    return judge(bench, grade, way.recipe, data_set=data_set, learned_sets=way.learned_sets)


def _on_scenario(judged: HeldOut, scenario: str) -> HeldOut:
    return judged.part(np.array(judged.runs.scenario)[judged.rows] == scenario)


def _bias_by_base(judged: HeldOut) -> dict[float, float]:
    """Return the mean error relative to the truth for every base friction, in rising order."""
    base_mu = np.round(judged.runs.labels["base_friction_mu"][judged.rows], 2)
    error = judged.mu / judged.label_mu - 1.0
    return {float(base): float(error[base_mu == base].mean()) for base in np.unique(base_mu)}


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say whether the slippery turn is found behind a grippy one, and what that costs elsewhere."""
    grade = leading_grade(results)
    figures = results[grade].figures

    def told(name: str, what: str) -> str:
        return by_grade(results, f"{name}.{what}")

    gain = figures[f"{UNIFORM}.{TWO}.mape"] / figures[f"{BEST}.{TWO}.mape"]
    text = (
        "A regressor that has learned from uniform roads alone takes the paper's S-turn of two frictions for a better "
        f"road than it is: it errs by {told(UNIFORM, f'{TWO}.mape')}, in the mean by up to "
        f"{told(UNIFORM, f'{TWO}.worst_bias')} at one base friction. With such roads to learn from, and the slippery "
        f"part of a drive told by itself, it errs by {told(BEST, f'{TWO}.mape')}"
        + (f", {gain:.1f} times less with {grade} sensors" if gain > 1.0 else "")
        + f"; without those figures by {told(WHOLE, f'{TWO}.mape')}. On random roads of two frictions it errs by "
        f"{told(BEST, 'two.mape')}, {told(BEST, 'two.mape_util60')} where the grip was used. That costs something on "
        f"uniform roads: {told(BEST, 'uniform.mape')} instead of {told(UNIFORM, 'uniform.mape')} on random ones, "
        f"{told(BEST, f'{ONE}.mape')} instead of {told(UNIFORM, f'{ONE}.mape')} on the S-turn, and without the figures "
        f"{told(WHOLE, f'{ONE}.mape')}."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="two_frictions",
    title="Roads that do not have one friction all along",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=(*LEARNED_SETS, PAPER_SET),
)

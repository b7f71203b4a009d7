"""The headline figures for other drivers and other cars than those of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from roadgrip.units import FloatArray
from training.accuracy import by_group, mape_ratio, relative_rms_ratio
from training.dataset import Runs
from training.regressor import RowIndices
from training.study.chapter import Cell as TableCell
from training.study.chapter import Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import per_cent
from training.study.folds import FOLDS_COUNT, PAPER_SET, cross_validated, learner, paper_estimates, rows_by_name
from training.study.picture import Axis, Bars
from training.study.recipes import PAPER_RECIPE, SPEED_ONLY_RECIPE, Recipe
from training.study.wording import by_grade, leading_grade
from vehicle_client.simulator.plan import SensorGrade

REACTING_SET, FLEET_SET = "paper-reacting", "paper-fleet"
WHO = {PAPER_SET: "prudent drivers, one car", REACTING_SET: "reacting drivers, one car", FLEET_SET: "a fleet of cars"}
ELSEWHERE, THERE = "learned from prudent drivers in one car", "learned from their like"
SHORT = {ELSEWHERE: "elsewhere", THERE: "there"}
RECIPES = {"78 features": PAPER_RECIPE, "speed only": SPEED_ONLY_RECIPE}
WORSE_RATIO = 2.0
"""Twice the error is another regressor."""


@dataclass(frozen=True, slots=True)
class Error:
    """Errors of a regressor on a data set.

    Attributes:
        mape_ratio: Over all runs.
        relative_rms_ratio: The same.
        worst_mape_ratio: Of the worst scenario.
        worst_scenario: Its name.
        rows_count: Runs judged.
    """

    mape_ratio: float
    relative_rms_ratio: float
    worst_mape_ratio: float
    worst_scenario: str
    rows_count: int


def error_of(runs: Runs, rows: RowIndices, estimate_mu: FloatArray) -> Error:
    """Return the errors of estimates.

    Args:
        runs: The table.
        rows: Runs that are judged. (n,)
        estimate_mu: Their estimates. (n,)
    """
    truth_mu = runs.labels["label_mu"][rows]
    scenario = [runs.scenario[row] for row in rows.tolist()]
    by_scenario = by_group(mape_ratio, scenario, truth_mu=truth_mu, estimate_mu=estimate_mu)
    worst = max(by_scenario, key=lambda name: by_scenario[name])
    return Error(
        mape_ratio(truth_mu, estimate_mu),
        relative_rms_ratio(truth_mu, estimate_mu),
        by_scenario[worst],
        worst,
        len(rows),
    )


def strangers(learned: Runs, judged: Runs) -> RowIndices:
    """Return the usable rows to learn from that share no driver, tyre and surface with those that are judged.

    A reacting driver is the prudent one without his guess: where the guess made no difference, the drive is the same.
    """
    known = set(judged.run_key)
    return np.array([row for row in rows_by_name(learned).tolist() if learned.run_key[row] not in known], dtype=np.intp)


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return the errors for all drivers with one grade of sensors."""
    found: dict[tuple[str, str, str], Error] = {}
    sizes: dict[str, int] = {"folds": FOLDS_COUNT, "seed": bench.seed}
    home = bench.runs(PAPER_SET, grade)
    for recipe_name, recipe in RECIPES.items():
        estimate_mu = paper_estimates(bench, grade, features=recipe.features, recipe=recipe)
        rows = rows_by_name(home)
        found[PAPER_SET, THERE, recipe_name] = error_of(home, rows, estimate_mu[rows])
    for name in (REACTING_SET, FLEET_SET):
        runs = bench.runs(name, grade)
        sizes[f"runs of {name}"] = int(runs.usable.sum())
        sizes[f"runs learned from for {name}"] = len(strangers(home, runs))
        for recipe_name, recipe in RECIPES.items():
            estimates = _estimates(bench, grade, name, recipe)
            rows = rows_by_name(runs)
            for where in (ELSEWHERE, THERE):
                found[name, where, recipe_name] = error_of(runs, rows, estimates[SHORT[where]])
            bench.report(f"{WHO[name]}, {grade}", 1, 1)
    return Result(
        figures={
            f"{figure}.{name}.{SHORT[where]}.{recipe_name}": float(getattr(error, f"{figure}_ratio"))
            for (name, where, recipe_name), error in found.items()
            for figure in ("mape", "relative_rms", "worst_mape")
        },
        sizes=sizes,
        tables=(_table(found),),
        pictures=(
            Bars(
                f"MAPE for other drivers and cars, {grade} sensors",
                "who drives",
                Axis("MAPE in %", low=0.0),
                tuple(WHO.values()),
                tuple(
                    (
                        f"{recipe_name}, {where}",
                        tuple(
                            per_cent(found.get((name, where, recipe_name), found[name, THERE, recipe_name]).mape_ratio)
                            for name in WHO
                        ),
                    )
                    for recipe_name in RECIPES
                    for where in (THERE, ELSEWHERE)
                ),
            ),
        ),
    )


def _estimates(bench: Workbench, grade: SensorGrade, name: str, recipe: Recipe) -> Mapping[str, FloatArray]:
    """Return estimates of a data set's `rows_by_name` by who learned elsewhere, and by who learned there."""

    def work() -> dict[str, FloatArray]:
        home, runs = bench.runs(PAPER_SET, grade), bench.runs(name, grade)
        rows, learned = rows_by_name(runs), strangers(home, runs)
        features = runs.columns(recipe.features)[rows]
        learn = learner(bench, recipe.learn)
        elsewhere = learn(home.columns(recipe.features)[learned], home.labels["label_mu"][learned])
        judged = cross_validated(learn, features, runs.labels["label_mu"][rows], seed=bench.seed)
        return {SHORT[ELSEWHERE]: elsewhere(features), SHORT[THERE]: judged.estimate_mu}

    return bench.remembered(f"drivers-{name}-{grade}-{recipe.key}-{bench.seed}", work)


def _table(found: Mapping[tuple[str, str, str], Error]) -> Table:
    rows: list[tuple[TableCell, ...]] = [
        (
            WHO[name],
            where,
            recipe_name,
            per_cent(error.mape_ratio),
            per_cent(error.relative_rms_ratio),
            per_cent(error.worst_mape_ratio),
            error.worst_scenario,
            error.rows_count,
        )
        for (name, where, recipe_name), error in found.items()
    ]
    return Table(
        "Errors for other drivers and cars",
        ("who drives", "regressor", "features", "MAPE %", "relative RMS %", "worst scenario %", "which", "runs"),
        tuple(rows),
        note=(
            "Judged on runs that were not learned from. A regressor for the reacting drivers that learned from prudent "
            "ones saw none of the drives that are the same but for the guess."
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return how far figures for one driver and one car hold for others."""
    figures = results[leading_grade(results)].figures
    home = figures[f"mape.{PAPER_SET}.there.78 features"]
    driver = figures[f"mape.{REACTING_SET}.elsewhere.78 features"]
    fleet = figures[f"mape.{FLEET_SET}.elsewhere.78 features"]
    parts = [
        f"{WHO[name]} {'at least double' if error > WORSE_RATIO * home else 'do not double'} the error"
        for name, error in ((REACTING_SET, driver), (FLEET_SET, fleet))
    ]
    text = (
        "The paper has one driver model and one car, and says that this may limit any positive result. Here, judged by "
        f"a regressor that learned from prudent drivers in one car, {' and '.join(parts)}: MAPE at home "
        f"{by_grade(results, f'mape.{PAPER_SET}.there.78 features')}; reacting drivers "
        f"{by_grade(results, f'mape.{REACTING_SET}.elsewhere.78 features')}, learned from their like "
        f"{by_grade(results, f'mape.{REACTING_SET}.there.78 features')}; the fleet "
        f"{by_grade(results, f'mape.{FLEET_SET}.elsewhere.78 features')}, learned from the like "
        f"{by_grade(results, f'mape.{FLEET_SET}.there.78 features')}. The speed alone gives "
        f"{by_grade(results, f'mape.{PAPER_SET}.there.speed only')} at home, "
        f"{by_grade(results, f'mape.{REACTING_SET}.there.speed only')} with reacting drivers and "
        f"{by_grade(results, f'mape.{FLEET_SET}.there.speed only')} with the fleet."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="drivers",
    title="Other drivers, other cars",
    paper_says=(
        "One kind of vehicle, one driver model, an observer tuned to that vehicle: whether the results hold beyond it "
        "is named as a gap in the evidence."
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET, REACTING_SET, FLEET_SET),
)

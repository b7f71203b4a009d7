"""The best regressor on roads that it knows, in the paper's own measures, beside the paper's configuration."""

from __future__ import annotations

from collections.abc import Mapping

from training.study.chapter import Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import per_cent
from training.study.feature_selection import SELECTED_COUNT
from training.study.folds import FOLDS_COUNT, PAPER_SET, paper_split
from training.study.known_roads import global_estimates, known_roads_figures, scenario_mape_ratio
from training.study.picture import Axis, Bars
from training.study.recipes import BEST_RECIPE, PAPER_RECIPE, Recipe
from training.study.wording import by_grade
from vehicle_client.simulator.plan import SensorGrade

PAPER, BEST = "paper_config", "best"
CONFIGS: Mapping[str, Recipe] = {PAPER: PAPER_RECIPE, BEST: BEST_RECIPE}
"""By the names of the study's headlines; those of the paper's configuration are given by the chapters of part A."""
MEASURES: Mapping[str, str] = {
    "known_worst_mape": "MAPE of held-out runs, worst scenario",
    "cv_median_mape": f"MAPE, median of {FOLDS_COUNT} folds",
    "sfs15_mape": f"the same with {SELECTED_COUNT} features chosen among its own",
    "relative_rms": "relative RMS of held-out runs",
}


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Judge both configurations on the paper's data with one grade of sensors."""
    split = paper_split(bench, grade)
    found: dict[str, dict[str, float]] = {}
    by_scenario: dict[str, dict[str, float]] = {}
    for config, recipe in CONFIGS.items():
        found[config] = known_roads_figures(bench, grade, recipe)
        by_scenario[config] = scenario_mape_ratio(split, global_estimates(bench, grade, recipe))
    return Result(
        figures={
            **{f"{config}.{name}": value for config, figures in found.items() for name, value in figures.items()},
            **{f"headline.{BEST}.{name}": value for name, value in found[BEST].items()},
        },
        sizes={
            "rows learned from": len(split.train_rows),
            "rows judged": len(split.test_rows),
            "folds": FOLDS_COUNT,
            "seed": bench.seed,
        },
        tables=(_table(found, by_scenario, split.scenarios),),
        pictures=(
            Bars(
                f"MAPE of held-out runs on known roads, {grade} sensors",
                "scenario",
                Axis("MAPE in %", low=0.0),
                split.scenarios,
                tuple(
                    (recipe.name, tuple(per_cent(by_scenario[config][name]) for name in split.scenarios))
                    for config, recipe in CONFIGS.items()
                ),
            ),
        ),
    )


def _table(
    found: Mapping[str, Mapping[str, float]], by_scenario: Mapping[str, Mapping[str, float]], scenarios: tuple[str, ...]
) -> Table:
    rows: list[tuple[Cell, ...]] = [
        (words, *(per_cent(found[config][name]) for config in CONFIGS)) for name, words in MEASURES.items()
    ]
    rows += [
        (f"MAPE of held-out runs, {name}", *(per_cent(by_scenario[config][name]) for config in CONFIGS))
        for name in scenarios
    ]
    return Table(
        "The best regressor in the paper's measures, roads known, in %",
        ("measure", *(f"{recipe.name} ({config})" for config, recipe in CONFIGS.items())),
        tuple(rows),
        note=f"One regressor for all scenarios. The {SELECTED_COUNT} features are chosen forward with the paper's "
        "trees, for either configuration among its own.",
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say what the best regressor gains where the road is known."""
    gains = [
        1.0 - result.figures[f"{BEST}.cv_median_mape"] / result.figures[f"{PAPER}.cv_median_mape"]
        for result in results.values()
    ]
    gained = "gains" if all(gain > 0.0 for gain in gains) else "does not always gain"

    def told(name: str) -> str:
        mine, papers = (by_grade(results, f"{config}.{name}") for config in (BEST, PAPER))
        return f"{mine}, instead of {papers}"

    text = (
        f"On the paper's own roads the best regressor {gained} over the paper's configuration. It errs by "
        f"{told('cv_median_mape')}, in the median of {FOLDS_COUNT} folds; in the worst scenario by "
        f"{told('known_worst_mape')}; with {SELECTED_COUNT} features by {told('sfs15_mape')}. The relative RMS of "
        f"single vehicles is {told('relative_rms')}. What it gains on roads never seen is told by other chapters."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="known_roads",
    title="The best regressor on roads it knows",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET,),
)

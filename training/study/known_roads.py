"""How a recipe does on roads it was taught on, as the headlines of the study define it."""

from __future__ import annotations

import numpy as np

from roadgrip.units import FloatArray
from training.accuracy import by_group, mape_ratio, relative_rms_ratio
from training.study.chapter import Workbench
from training.study.feature_selection import SELECTED_COUNT, selected_features
from training.study.folds import Split, learner, paper_split, recipe_fold_mape_ratio
from training.study.paper_features import PAPER_FEATURES
from training.study.recipes import Recipe
from vehicle_client.simulator.plan import SensorGrade


def global_estimates(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> FloatArray:
    """Return estimates of the held-out tenth by one regressor for all scenarios.

    Returns:
        Friction; rows as in `paper_split(bench, grade).test_rows`. (rows,)
    """

    def work() -> dict[str, FloatArray]:
        split = paper_split(bench, grade)
        rows = split.train_rows
        learned = learner(bench, recipe.learn)(split.features(recipe.features, rows), split.label_mu(rows))
        return {"estimate_mu": learned(split.features(recipe.features, split.test_rows))}

    return bench.remembered(f"held-out-{grade}-{recipe.key}-{bench.seed}", work)["estimate_mu"]


def local_estimates(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> FloatArray:
    """Return estimates of the held-out tenth by a regressor for each scenario, taught on that scenario alone.

    Returns:
        Friction; rows as in `paper_split(bench, grade).test_rows`. (rows,)
    """

    def work() -> dict[str, FloatArray]:
        split = paper_split(bench, grade)
        where = np.array(split.runs.scenario)
        estimate = np.full(len(split.test_rows), np.nan)
        for scenario in split.scenarios:
            rows = split.scenario_rows(split.train_rows, scenario)
            learned = learner(bench, recipe.learn)(split.features(recipe.features, rows), split.label_mu(rows))
            mine = where[split.test_rows] == scenario
            estimate[mine] = learned(split.features(recipe.features, split.test_rows[mine]))
        return {"estimate_mu": estimate}

    return bench.remembered(f"held-out-local-{grade}-{recipe.key}-{bench.seed}", work)["estimate_mu"]


def scenario_mape_ratio(split: Split, estimate_mu: FloatArray) -> dict[str, float]:
    """Return the MAPE of every scenario.

    Args:
        split: The paper's.
        estimate_mu: Of the held-out tenth. (rows,)
    """
    scenario = [split.runs.scenario[row] for row in split.test_rows.tolist()]
    return by_group(mape_ratio, scenario, truth_mu=split.label_mu(split.test_rows), estimate_mu=estimate_mu)


def known_worst_mape_ratio(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> float:
    """Return the MAPE of one regressor for all scenarios in that scenario where it is worst, on the held-out tenth."""
    return max(scenario_mape_ratio(paper_split(bench, grade), global_estimates(bench, grade, recipe)).values())


def known_relative_rms_ratio(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> float:
    """Return the RMS of the errors relative to the truth of one regressor for all scenarios, on the held-out tenth."""
    split = paper_split(bench, grade)
    return relative_rms_ratio(split.label_mu(split.test_rows), global_estimates(bench, grade, recipe))


def cv_median_mape_ratio(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> float:
    """Return the median over eight folds of the MAPE, on the other nine tenths."""
    return float(np.median(recipe_fold_mape_ratio(bench, grade, recipe)))


def sfs15_mape_ratio(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> float:
    """Return the median over eight folds of the MAPE with 15 features, chosen forward among the recipe's own.

    They are chosen with the paper's trees, whatever the recipe: thousands of fits must be cheap.
    """
    # The paper's search goes on to 30 and is there anyway.
    most_count = None if recipe.features == PAPER_FEATURES else SELECTED_COUNT
    chosen = selected_features(bench, grade, candidates=recipe.features, most_count=most_count)
    return cv_median_mape_ratio(bench, grade, recipe.on(chosen))


def known_roads_figures(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> dict[str, float]:
    """Return how a recipe of at least 15 features does on known roads, by the names of the study's headlines."""
    return {
        "known_worst_mape": known_worst_mape_ratio(bench, grade, recipe),
        "cv_median_mape": cv_median_mape_ratio(bench, grade, recipe),
        "relative_rms": known_relative_rms_ratio(bench, grade, recipe),
        "sfs15_mape": sfs15_mape_ratio(bench, grade, recipe),
    }

"""Estimates by regressors that had not seen the drive, or not even the road, each with the error to expect of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from roadgrip.units import FloatArray
from training.dataset import Runs
from training.fit_parameters import FitParameters
from training.regressor import RowIndices
from training.study.chapter import Arrays, Workbench
from training.study.folds import FOLDS_COUNT, PAPER_SET, cross_validated, fold_numbers, paper_estimates, side_by_side
from training.study.generalise.passages import Passages
from training.study.paper_features import columns_by_name
from training.study.recipes import Boosted, Recipe
from vehicle_client.simulator.plan import SensorGrade

RANDOM_ROADS_SET = "random-roads"
ERROR_LEARNER = Boosted(
    FitParameters(trees_count=100, depth_count=5, learning_rate_ratio=0.08, row_share_frac=0.7, column_share_frac=0.5)
)
"""Expected errors are rough at best; few and slow trees do not make more of them than there is."""
LEAST_ERROR_RATIO = 0.002
"""Trees of squared errors may come out below zero."""
DOUBTFUL_ABOVE_RATIO = 0.15
"""An estimate with a larger expected error is taken for a lower bound."""
BOUND_COVERAGE_FRAC = 0.95
"""Share of vehicles whose bound is to lie below the truth."""


@dataclass(frozen=True, slots=True)
class Estimated:
    """Runs with what strangers made of them.

    Attributes:
        runs: The runs.
        rows: Those that have a summary. (m,)
        passages: One for every run, NaN without a summary; none is taken for a bound. (n,)
        bound_mu: Below this the friction hardly is. (n,)
    """

    runs: Runs
    rows: RowIndices
    passages: Passages
    bound_mu: FloatArray

    @property
    def with_bounds(self) -> Passages:
        """The same passages, doubtful estimates taken for the lower bounds they give. (n,)"""
        doubtful = self.passages.expected_error_ratio > DOUBTFUL_ABOVE_RATIO
        return Passages(
            mu=np.where(doubtful, self.bound_mu, self.passages.mu),
            expected_error_ratio=np.where(doubtful, 0.0, self.passages.expected_error_ratio),
            at_least=doubtful,
        )


def known_roads(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> Estimated:
    """Return the paper's runs, each estimated by a regressor that knows its road and not the drive.

    The expected error is learned in the same manner from the errors, and the folds are dealt alike.
    """

    def work() -> Arrays:
        runs = bench.runs(PAPER_SET, grade)
        rows = _rows_by_name(runs)
        mu = paper_estimates(bench, grade, features=recipe.features, recipe=recipe)[rows]
        seen = np.column_stack([columns_by_name(runs, recipe.features)[rows], mu])
        error = _error(mu, runs.labels["label_mu"][rows])
        expected = cross_validated(ERROR_LEARNER, seen, error, seed=bench.seed).estimate_mu
        return _arrays(len(runs), rows, mu, expected, bound_exponent=_bound_exponent(mu, runs, rows, expected))

    found = bench.remembered(f"known-roads-{grade}-{recipe.key}-{bench.seed}", work)
    return _estimated(bench.runs(PAPER_SET, grade), found)


def unseen_roads(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> Estimated:
    """Return the paper's runs, estimated by a regressor that has seen random roads and none of the paper's.

    The expected error is learned from random roads too: from the errors on roads that the regressor of the moment had
    not seen.
    """

    def work() -> Arrays:
        learned, judged = bench.runs(RANDOM_ROADS_SET, grade), bench.runs(PAPER_SET, grade)
        rows, at = _rows_by_name(learned), _rows_by_name(judged)
        features = columns_by_name(learned, recipe.features)[rows]
        label = learned.labels["label_mu"][rows]
        fold = road_folds([learned.section_id[i] for i in rows], seed=bench.seed)
        strangers = estimates_by_strangers(recipe, features, label, fold=fold)
        seen = np.column_stack([features, strangers])
        error = _error(strangers, label)
        expected_there = cross_validated(ERROR_LEARNER, seen, error, seed=bench.seed).estimate_mu
        exponent = _bound_exponent(strangers, learned, rows, expected_there)
        there = columns_by_name(judged, recipe.features)[at]
        mu = recipe.learn(features, label)(there)
        expected = ERROR_LEARNER(seen, error)(np.column_stack([there, mu]))
        return _arrays(len(judged), at, mu, expected, bound_exponent=exponent)

    found = bench.remembered(f"unseen-roads-{grade}-{recipe.key}-{bench.seed}", work)
    return _estimated(bench.runs(PAPER_SET, grade), found)


def road_folds(section_ids: list[str], *, seed: int) -> RowIndices:
    """Return which fold each row is judged in, all rows of a road in the same. (n,)"""
    names = sorted(set(section_ids))
    fold_of = dict(zip(names, fold_numbers(len(names), FOLDS_COUNT, seed=seed).tolist(), strict=True))
    return np.array([fold_of[name] for name in section_ids], dtype=np.intp)


def estimates_by_strangers(
    recipe: Recipe, features: FloatArray, label_mu: FloatArray, *, fold: RowIndices
) -> FloatArray:
    """Return the estimate of every row by a regressor that learned from the other folds.

    Args:
        recipe: How to learn; its own features are not looked at.
        features: (n, columns)
        label_mu: The truth. (n,)
        fold: The fold of every row. (n,)
    """
    estimate = np.full(len(label_mu), np.nan)

    def judge(number: int) -> None:
        out = fold == number
        estimate[out] = recipe.learn(features[~out], label_mu[~out])(features[out])

    side_by_side([partial(judge, number) for number in np.unique(fold).tolist()])
    return estimate


def _rows_by_name(runs: Runs) -> RowIndices:
    """Return the usable rows in the order of their names, as `paper_estimates` deals them to the folds."""
    order = np.argsort(np.array(runs.run_key), kind="stable")
    return order[runs.usable[order]]


def _error(mu: FloatArray, label_mu: FloatArray) -> FloatArray:
    return np.abs(np.log(np.maximum(mu, 1e-3) / label_mu))


def _bound_exponent(mu: FloatArray, runs: Runs, rows: RowIndices, expected: FloatArray) -> float:
    """Return how many expected errors below its estimate a bound lies for the coverage that is wanted."""
    too_high = np.log(mu / runs.labels["label_mu"][rows]) / np.maximum(expected, LEAST_ERROR_RATIO)
    return float(max(0.0, np.quantile(too_high, BOUND_COVERAGE_FRAC)))


def _arrays(
    runs_count: int, rows: RowIndices, mu: FloatArray, expected: FloatArray, *, bound_exponent: float
) -> Arrays:
    expected = np.maximum(expected, LEAST_ERROR_RATIO)
    columns = {"mu": mu, "expected_error_ratio": expected, "bound_mu": mu * np.exp(-bound_exponent * expected)}
    whole = {name: np.full(runs_count, np.nan) for name in columns}
    for name, values in columns.items():
        whole[name][rows] = values
    return whole


def _estimated(runs: Runs, found: Arrays) -> Estimated:
    return Estimated(
        runs=runs,
        rows=np.flatnonzero(np.isfinite(found["mu"])),
        passages=Passages(found["mu"], found["expected_error_ratio"], np.zeros(len(runs), dtype=np.bool_)),
        bound_mu=found["bound_mu"],
    )

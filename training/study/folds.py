"""Who learns from what and is judged on what: nine tenths and one tenth, eight folds, strangers to drive or road."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, is_dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np

from roadgrip.units import BoolArray, FloatArray
from training.accuracy import mape_ratio
from training.dataset import DatasetError, Runs
from training.fit_parameters import FitParameters
from training.regressor import HOLD_OUT_FRAC, RowIndices
from training.study.chapter import Workbench
from training.study.paper_features import PAPER_FEATURES
from training.study.recipes import PAPER_RECIPE, Learner, Recipe
from vehicle_client.simulator.plan import SensorGrade

FOLDS_COUNT = 8
"""The paper's."""
QUICK_BINS_COUNT = 32
PAPER_SET = "paper"
"""Name of the data set that the paper's results are made again with."""
RANDOM_ROADS_SET = "random-roads"
"""Name of the data set whose roads stand for any other."""
TWO_FRICTIONS_SET = "random-roads-two-frictions"
"""Name of the data set of roads, other ones, that do not have one friction all along."""
LEARNED_SETS = (RANDOM_ROADS_SET, TWO_FRICTIONS_SET)
"""What a regressor learns from that is to be right on any road."""


@dataclass(frozen=True, slots=True)
class Split:
    """The paper's split of its data.

    Attributes:
        runs: All of them.
        train_rows: Nine tenths of the usable runs of every scenario, shuffled together.
        test_rows: The rest.
    """

    runs: Runs
    train_rows: RowIndices
    test_rows: RowIndices

    def features(self, names: Sequence[str], rows: RowIndices) -> FloatArray:
        """Return features by name. (rows, names)"""
        return self.runs.columns(names)[rows]

    def label_mu(self, rows: RowIndices) -> FloatArray:
        """Return the truth. (rows,)"""
        return self.runs.labels["label_mu"][rows]

    def scenario_rows(self, rows: RowIndices, scenario: str) -> RowIndices:
        """Return those of the rows that were driven in a scenario."""
        return rows[np.array(self.runs.scenario)[rows] == scenario]

    @property
    def scenarios(self) -> tuple[str, ...]:
        """The scenarios, by name."""
        return tuple(sorted({self.runs.scenario[i] for i in self.train_rows}))


def paper_split(bench: Workbench, grade: SensorGrade) -> Split:
    """Return the paper's data with the paper's split."""
    return split_by_scenario(bench.runs(PAPER_SET, grade), seed=bench.seed)


def split_by_scenario(runs: Runs, *, seed: int) -> Split:
    """Return the usable runs in nine tenths and one tenth, scenario by scenario.

    A run falls on the same side whatever the order of the rows.

    Raises:
        DatasetError: Some scenario has too few runs to be split.
    """
    usable = rows_by_name(runs)
    scenarios = np.array(runs.scenario)[usable]
    rng = np.random.default_rng(seed)
    train, test = [], []
    for name in sorted(set(scenarios.tolist())):
        shuffled = rng.permutation(usable[scenarios == name])
        test_count = round(HOLD_OUT_FRAC * len(shuffled))
        if test_count == 0:
            raise DatasetError(f"{len(shuffled)} usable runs of {name} cannot be split into nine tenths and one")
        test.append(shuffled[:test_count])
        train.append(shuffled[test_count:])
    if not train:
        raise DatasetError("no usable runs")
    return Split(runs, rng.permutation(np.concatenate(train)), np.concatenate(test))


def rows_by_name(runs: Runs) -> RowIndices:
    """Return the rows that have a summary, by the names of the runs: no fold hangs on the order of the rows. (m,)"""
    order = np.argsort(np.array(runs.run_key), kind="stable")
    return order[runs.usable[order]]


def roads_of(runs: Runs, rows: RowIndices) -> tuple[str, ...]:
    """Return the road of each of some rows. (m,)"""
    return tuple(runs.section_id[row] for row in rows.tolist())


def fold_numbers(rows_count: int, folds_count: int, *, seed: int) -> RowIndices:
    """Return which fold each row is judged in: chance deals them out, as evenly as it goes. (rows,)"""
    return np.random.default_rng([seed, folds_count]).permutation(np.arange(rows_count) % folds_count)


def road_folds(section_ids: Sequence[str], *, seed: int, folds_count: int = FOLDS_COUNT) -> RowIndices:
    """Return which fold each row is judged in, all rows of a road in the same. (n,)"""
    names = sorted(set(section_ids))
    fold_of = dict(zip(names, fold_numbers(len(names), folds_count, seed=seed).tolist(), strict=True))
    return np.array([fold_of[name] for name in section_ids], dtype=np.intp)


@dataclass(frozen=True, slots=True)
class Judged:
    """Estimates of rows by regressors that had not seen them.

    Attributes:
        label_mu: The truth. (n,)
        estimate_mu: The estimate. (n,)
        fold: The fold in which each row was judged. (n,)
    """

    label_mu: FloatArray
    estimate_mu: FloatArray
    fold: RowIndices

    @property
    def fold_mape_ratio(self) -> FloatArray:
        """The MAPE of every fold. (folds,)"""
        folds = range(int(self.fold.max()) + 1)
        errors = [mape_ratio(self.label_mu[self.fold == k], self.estimate_mu[self.fold == k]) for k in folds]
        return np.array(errors)


def cross_validated(
    learn: Learner,
    features: FloatArray,
    label_mu: FloatArray,
    *,
    seed: int,
    on_fold: Callable[[int], None] | None = None,
) -> Judged:
    """Return the estimate of every row by a regressor that learned from seven of the paper's eight folds.

    Args:
        learn: How to learn; called once for each fold, from several threads.
        features: (n, columns)
        label_mu: The truth. (n,)
        seed: Deals the rows to the folds.
        on_fold: Called after each fold with the number of those done.
    """
    fold = fold_numbers(len(label_mu), FOLDS_COUNT, seed=seed)
    return Judged(label_mu, estimates_by_strangers(learn, features, label_mu, fold=fold, on_fold=on_fold), fold)


def learner(bench: Workbench, learn: Learner) -> Learner:
    """Return how something is learned here: for a rough answer trees part the rows at fewer values of each feature.

    From a few thousand rows that takes a quarter of the time and costs no accuracy.

    Args:
        bench: Says whether a rough answer is wanted.
        learn: How it is learned otherwise; a record with `parameters` of trees, or one with such a learner in `learn`,
            or anything else, which stays as it is.
    """
    record: Any = learn
    if not bench.quick or not is_dataclass(record) or isinstance(record, type):
        return learn
    parameters, inner = getattr(record, "parameters", None), getattr(record, "learn", None)
    if isinstance(parameters, FitParameters):
        bins_count = min(QUICK_BINS_COUNT, parameters.bins_count)
        return cast("Learner", replace(record, parameters=replace(parameters, bins_count=bins_count)))
    return learn if inner is None else cast("Learner", replace(record, learn=learner(bench, inner)))


def estimates_by_strangers(
    learn: Learner,
    features: FloatArray,
    label_mu: FloatArray,
    *,
    fold: RowIndices,
    taught: BoolArray | None = None,
    on_fold: Callable[[int], None] | None = None,
) -> FloatArray:
    """Return the estimate of every row by a regressor that learned from the other folds. (n,)

    Args:
        learn: How to learn; called once for each fold, from several threads.
        features: (n, columns)
        label_mu: The truth. (n,)
        fold: In which each row is judged. (n,)
        taught: Rows that may be learned from; all if None. (n,)
        on_fold: Called after each fold with the number of those done.
    """
    estimate = np.full(len(label_mu), np.nan)

    def judge(number: int) -> None:
        out = fold == number
        learned = ~out if taught is None else taught & ~out
        estimate[out] = learn(features[learned], label_mu[learned])(features[out])

    side_by_side([partial(judge, number) for number in np.unique(fold).tolist()], on_done=on_fold)
    return estimate


def side_by_side(jobs: Sequence[Callable[[], None]], *, on_done: Callable[[int], None] | None = None) -> None:
    """Do jobs that let go of the interpreter, as the growing of trees does, on all cores.

    The first error ends it; jobs that had not begun are dropped.

    Args:
        jobs: What to do, in any order.
        on_done: Called with the number of jobs that are done.
    """
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        try:
            for done, future in enumerate(as_completed([pool.submit(job) for job in jobs]), start=1):
                future.result()
                if on_done is not None:
                    on_done(done)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def recipe_fold_mape_ratio(
    bench: Workbench, grade: SensorGrade, recipe: Recipe, *, rows_count: int | None = None
) -> FloatArray:
    """Return the MAPE of every fold of a recipe, cross-validated on the nine tenths of the paper's data. (folds,)

    Args:
        bench: Where the data comes from.
        grade: Sensors.
        recipe: How to learn, and from which features.
        rows_count: Only the first so many of the rows, which are shuffled; all if None.
    """

    def work() -> dict[str, FloatArray]:
        split = paper_split(bench, grade)
        rows = split.train_rows[:rows_count]
        judged = cross_validated(
            learner(bench, recipe.learn),
            split.features(recipe.features, rows),
            split.label_mu(rows),
            seed=bench.seed,
            on_fold=lambda done: bench.report(f"folds of {recipe.name}, {grade}", done, FOLDS_COUNT),
        )
        return {"mape_ratio": judged.fold_mape_ratio}

    name = "fold-mape" if rows_count is None else f"fold-mape-{rows_count}"
    return bench.remembered(f"{name}-{grade}-{recipe.key}-{bench.seed}", work)["mape_ratio"]


def paper_estimates(
    bench: Workbench, grade: SensorGrade, *, features: Sequence[str] = PAPER_FEATURES, recipe: Recipe = PAPER_RECIPE
) -> FloatArray:
    """Return an estimate of every run of the paper's data by a regressor that had not seen it.

    Eight folds over all usable runs, the tenth that is otherwise held out included: every run is judged by a regressor
    that learned from seven eighths of the others.

    Args:
        bench: Where the data comes from.
        grade: Sensors.
        features: What to learn from: the paper's 78, or `training.study.feature_selection.selected_features`.
        recipe: How to learn; its own features are not looked at.

    Returns:
        Friction, NaN where a run has no summary; rows as in `bench.runs("paper", grade)`. (runs,)
    """
    chosen = recipe.on(features)

    def work() -> dict[str, FloatArray]:
        runs = bench.runs(PAPER_SET, grade)
        rows = rows_by_name(runs)
        judged = cross_validated(
            learner(bench, chosen.learn),
            runs.columns(chosen.features)[rows],
            runs.labels["label_mu"][rows],
            seed=bench.seed,
            on_fold=lambda done: bench.report(f"estimates by strangers, {chosen.name}, {grade}", done, FOLDS_COUNT),
        )
        estimate = np.full(len(runs), np.nan)
        estimate[rows] = judged.estimate_mu
        return {"estimate_mu": estimate}

    return bench.remembered(f"estimates-{grade}-{chosen.key}-{bench.seed}", work)["estimate_mu"]

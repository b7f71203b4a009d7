"""The global regressor: boosted trees from a kinematic summary and the road's features to friction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import xgboost

from roadgrip.units import FloatArray
from training.accuracy import FEWEST_ROADS, mape_ratio, relative_rms_ratio
from training.dataset import DatasetError, Runs
from training.error_model import ERROR_FIT, grow_error_trees, log_error_ratio
from training.fit_parameters import FitParameters, Target

RowIndices: TypeAlias = np.ndarray[tuple[int], np.dtype[np.intp]]
"""Rows of a table."""

HOLD_OUT_FRAC = 0.1
"""The paper's split: nine tenths to learn from, one tenth to be judged on."""
ROAD_FOLDS_COUNT = 5
_FEWEST_RUNS = 50
CERTAIN_ERROR_RATIO = 0.01
"""Smaller errors to expect are not weighed up any further: a hundredth is as good as it gets."""
_TARGET_ATTRIBUTE = "target"
_BASE_ATTRIBUTE = "base_column"


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fitted regressor with the rows it was judged on.

    Attributes:
        booster: The trees.
        train_rows: Indices of the rows it learned from.
        test_rows: Indices of the rows it never saw.
        metrics: Figures of merit on `test_rows`.
    """

    booster: xgboost.Booster
    train_rows: RowIndices
    test_rows: RowIndices
    metrics: dict[str, float]


def estimate_mu(booster: xgboost.Booster, features: FloatArray, *, threads_count: int = 0) -> FloatArray:
    """Return the friction the trees give for rows of features, whatever they add up to.

    Args:
        booster: What `grow_trees` returned, or such trees read from a file.
        features: The columns it was grown on, in the same order. (n, columns)
        threads_count: At most so many; 0 takes what there is.

    Returns:
        Friction. (n,)
    """
    rows = xgboost.DMatrix(features.astype(np.float32), nthread=threads_count or None)
    answers = booster.predict(rows).astype(np.float64)
    if target_of(booster) is Target.MU:
        return answers
    base = base_column_of(booster)
    return np.exp(answers) if base is None else np.exp(answers) * features[:, base]


def target_of(booster: xgboost.Booster) -> Target:
    """Return what the trees add up to: friction, or its logarithm. The trees' file carries it along."""
    return Target(booster.attr(_TARGET_ATTRIBUTE) or Target.MU)


def base_column_of(booster: xgboost.Booster) -> int | None:
    """Return the column that what the trees add up to is the logarithm of the ratio to; None without one."""
    column = booster.attr(_BASE_ATTRIBUTE)
    return None if column is None else int(column)


def grow_trees(
    features: FloatArray,
    label_mu: FloatArray,
    parameters: FitParameters,
    *,
    weight_ratio: FloatArray | None = None,
    threads_count: int = 0,
    on_round: Callable[[int], None] | None = None,
) -> xgboost.Booster:
    """Return boosted trees that follow the labels.

    The same rows in the same order give the same trees, whatever the number of threads.

    Args:
        features: What to learn from; (n, columns)
        label_mu: The truth, positive. (n,)
        parameters: How the trees are grown.
        weight_ratio: What the squared error of each row counts beside its certainty; one each by default. (n,)
        threads_count: At most so many; 0 takes what there is.
        on_round: Called after each boosting round with its number, for a progress bar.

    Raises:
        ValueError: A base column is given for trees that do not add up to a logarithm.
    """
    if parameters.certainty_power_ratio > 0.0:
        certainty = certainty_ratio(features, label_mu, parameters, threads_count=threads_count)
        weight_ratio = certainty if weight_ratio is None else certainty * weight_ratio
    settings = {
        "objective": "reg:squarederror",
        "max_depth": parameters.depth_count,
        "eta": parameters.learning_rate_ratio,
        "subsample": parameters.row_share_frac,
        "colsample_bytree": parameters.column_share_frac,
        "colsample_bynode": parameters.node_column_share_frac,
        "min_child_weight": parameters.leaf_rows_count,
        "tree_method": "hist",
        "max_bin": parameters.bins_count,
        "seed": parameters.seed,
        "nthread": threads_count,
    }
    label = np.log(label_mu) if parameters.target is Target.LOG_MU else label_mu
    if parameters.base_column is not None:
        if parameters.target is not Target.LOG_MU:
            raise ValueError("only a logarithm is told as a distance from a column")
        label = label - np.log(features[:, parameters.base_column])
    rows = xgboost.QuantileDMatrix(
        features.astype(np.float32),
        label=label,
        weight=weight_ratio,
        max_bin=parameters.bins_count,
        nthread=threads_count or None,
    )
    booster = xgboost.train(
        settings,
        rows,
        num_boost_round=parameters.trees_count,
        callbacks=[_RoundReporter(on_round)] if on_round else None,
    )
    if parameters.target is not Target.MU:
        booster.set_attr(**{_TARGET_ATTRIBUTE: parameters.target.value})
    if parameters.base_column is not None:
        booster.set_attr(**{_BASE_ATTRIBUTE: str(parameters.base_column)})
    return booster


def certainty_ratio(
    features: FloatArray, label_mu: FloatArray, parameters: FitParameters, *, threads_count: int = 0
) -> FloatArray:
    """Return what the squared error of each row shall count, by the error to expect of it; the mean is 1. (n,)

    Either half of the rows is judged by fewer trees that learned from the other half; what these miss teaches what
    error to expect.

    Args:
        features: What is learned from. (n, columns)
        label_mu: The truth, positive. (n,)
        parameters: How the trees are grown that shall be weighted.
        threads_count: At most so many; 0 takes what there is.

    References:
        Carroll and Ruppert, Transformation and Weighting in Regression, 1988, chapter 2: weights by estimated spread.
    """
    rough = replace(
        parameters,
        certainty_power_ratio=0.0,
        trees_count=max(1, parameters.trees_count // 3),
        learning_rate_ratio=min(1.0, 2.0 * parameters.learning_rate_ratio),
    )
    half = np.random.default_rng(parameters.seed).permutation(len(label_mu)) % 2
    mu = np.empty(len(label_mu))
    for judged in (half == 0, half == 1):
        trees = grow_trees(features[~judged], label_mu[~judged], rough, threads_count=threads_count)
        mu[judged] = estimate_mu(trees, features[judged], threads_count=threads_count)
    told = replace(ERROR_FIT, seed=parameters.seed, bins_count=min(ERROR_FIT.bins_count, parameters.bins_count))
    errors = grow_error_trees(features, log_error_ratio(mu, label_mu), told, threads_count=threads_count)
    expected = np.maximum(estimate_mu(errors, features, threads_count=threads_count), CERTAIN_ERROR_RATIO)
    weight = expected**-parameters.certainty_power_ratio
    ratio: FloatArray = weight / weight.mean()
    return ratio


def fit(runs: Runs, parameters: FitParameters, *, on_round: Callable[[int], None] | None = None) -> Fitted:
    """Return trees fitted to nine tenths of the usable runs and judged on the rest.

    The same runs and parameters give the same trees, whatever the order of the rows.

    Args:
        runs: Rows with features and labels; rows without a summary are left out.
        parameters: How the trees are grown.
        on_round: Called after each boosting round with its number, for a progress bar.

    Raises:
        DatasetError: There are too few usable runs.
    """
    train_rows, test_rows = split_rows(runs, seed=parameters.seed)
    booster = _grown(runs, train_rows, parameters, on_round=on_round)
    metrics = judge(
        runs.labels["label_mu"][test_rows],
        estimate_mu(booster, runs.features[test_rows]),
        section_id=[runs.section_id[i] for i in test_rows],
    )
    return Fitted(booster=booster, train_rows=train_rows, test_rows=test_rows, metrics=metrics)


def mape_ratio_on_unseen_roads(
    runs: Runs, parameters: FitParameters, *, on_fold: Callable[[int], None] | None = None
) -> float:
    """Return the mean error on a road of which nothing was learned, every road weighing the same.

    The roads are dealt into `ROAD_FOLDS_COUNT` hands; for each, trees are grown on the others and judged on it.

    Args:
        runs: Rows with features and labels.
        parameters: How the trees are grown.
        on_fold: Called after each hand with the number of those done, for a progress bar.

    Raises:
        DatasetError: There are fewer than `FEWEST_ROADS` roads to tell.
    """
    sections = np.array(runs.section_id)
    names = sorted({runs.section_id[i] for i in np.flatnonzero(runs.usable)})
    if len(names) < FEWEST_ROADS:
        raise DatasetError(f"{len(names)} roads say nothing about the next one; at least {FEWEST_ROADS} are needed")
    dealt = np.random.default_rng(parameters.seed).permutation(names)
    order = np.argsort(np.array(runs.run_key), kind="stable")
    errors = []
    for fold in range(ROAD_FOLDS_COUNT):
        unseen = dealt[fold::ROAD_FOLDS_COUNT]
        rows = order[runs.usable[order] & ~np.isin(sections[order], unseen)]
        booster = _grown(runs, rows, parameters)
        for name in unseen:
            road = runs.usable & (sections == name)
            errors.append(mape_ratio(runs.labels["label_mu"][road], estimate_mu(booster, runs.features[road])))
        if on_fold is not None:
            on_fold(fold + 1)
    return float(np.mean(errors))


def _grown(
    runs: Runs, rows: RowIndices, parameters: FitParameters, *, on_round: Callable[[int], None] | None = None
) -> xgboost.Booster:
    return grow_trees(runs.features[rows], runs.labels["label_mu"][rows], parameters, on_round=on_round)


def split_rows(runs: Runs, *, seed: int) -> tuple[RowIndices, RowIndices]:
    """Return the rows to learn from and the rows to be judged on: nine tenths and one tenth of the usable runs.

    A run falls on the same side whatever the order of the rows.

    Raises:
        DatasetError: There are too few usable runs.
    """
    order = np.argsort(np.array(runs.run_key), kind="stable")
    usable = order[runs.usable[order]]
    if len(usable) < _FEWEST_RUNS:
        raise DatasetError(f"{len(usable)} usable runs; at least {_FEWEST_RUNS} are needed")
    shuffled = np.random.default_rng(seed).permutation(usable)
    test_count = max(1, round(HOLD_OUT_FRAC * len(shuffled)))
    return shuffled[test_count:], shuffled[:test_count]


def judge(truth_mu: FloatArray, estimated_mu: FloatArray, *, section_id: list[str]) -> dict[str, float]:
    """Return figures of merit, over all rows and for each section with at least ten rows."""
    metrics = {
        "rows_count": float(len(truth_mu)),
        "mape_ratio": mape_ratio(truth_mu, estimated_mu),
        "relative_rms_ratio": relative_rms_ratio(truth_mu, estimated_mu),
    }
    sections = np.array(section_id)
    for name in sorted(set(section_id)):
        rows = sections == name
        if rows.sum() >= 10:
            metrics[f"mape_ratio.{name}"] = mape_ratio(truth_mu[rows], estimated_mu[rows])
    return metrics


class _RoundReporter(xgboost.callback.TrainingCallback):
    """Tells how many rounds are done."""

    def __init__(self, on_round: Callable[[int], None]) -> None:
        super().__init__()
        self._on_round = on_round

    def after_iteration(self, model: object, epoch: int, evals_log: object) -> bool:
        del model, evals_log
        self._on_round(epoch + 1)
        return False

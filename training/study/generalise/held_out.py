"""Estimates of passages by strangers, mostly to the road, or else to the drive; with the error to expect of each.

Whose road is strange, everything is learned from other roads: the friction, and the error to expect, which a second
regressor learns from what the first one got wrong on roads that it had not seen. Both see the features alone, as the
models of a bundle do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from roadgrip.units import BoolArray, FloatArray
from training.accuracy import mape_ratio
from training.dataset import Runs
from training.error_model import ERROR_FIT, LEAST_MU, grow_error_trees, log_error_ratio
from training.fit_parameters import FitParameters
from training.regressor import RowIndices, estimate_mu
from training.study.chapter import Arrays, Workbench
from training.study.folds import (
    FOLDS_COUNT,
    LEARNED_SETS,
    PAPER_SET,
    RANDOM_ROADS_SET,
    estimates_by_strangers,
    fold_numbers,
    learner,
    paper_estimates,
    road_folds,
    roads_of,
    rows_by_name,
)
from training.study.recipes import Estimator, Learner, Recipe
from vehicle_client.simulator.plan import SensorGrade

LEAST_ERROR_RATIO = 0.002
"""Nobody is believed to be surer."""
SUREST_FRAC = 0.8
"""Share of the passages that the study's headline keeps: those with the least error to expect."""
HIGH_UTILISATION_RATIO = 0.6
"""From here on a passage has used enough of the grip to know it."""
UTILISATION_BANDS: tuple[tuple[float, float], ...] = (
    (0.0, 0.3),
    (0.3, 0.4),
    (0.4, 0.6),
    (0.6, 0.8),
    (0.8, np.inf),
)
"""By the largest share of the grip that a passage used."""


@dataclass(frozen=True, slots=True)
class ErrorTrees:
    """The learner of the error to expect: the trees that bundles have for it, one thread each.

    Attributes:
        parameters: How the trees are grown.
    """

    parameters: FitParameters = ERROR_FIT

    def __call__(self, features: FloatArray, error_ratio: FloatArray) -> Estimator:
        """Return what the trees make of features: the magnitude of the error on the logarithm, positive."""
        booster = grow_error_trees(features, error_ratio, self.parameters, threads_count=1)
        return lambda rows: estimate_mu(booster, rows, threads_count=1)


EXPECTED_ERROR: Learner = ErrorTrees()


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Passages that kept to the road, and what strangers made of them.

    Attributes:
        runs: All runs of the data set.
        rows: Those judged: all that have a summary, by their names. (m,)
        fold: The fold that each was judged in. (m,)
        mu: What the regressor says. (m,)
        expected_error_ratio: Magnitude of the error to expect, on the logarithm. (m,)
    """

    runs: Runs
    rows: RowIndices
    fold: RowIndices
    mu: FloatArray
    expected_error_ratio: FloatArray

    def __len__(self) -> int:
        """Return how many passages were judged."""
        return len(self.rows)

    @property
    def label_mu(self) -> FloatArray:
        """The truth. (m,)"""
        return self.runs.labels["label_mu"][self.rows]

    @property
    def error_ratio(self) -> FloatArray:
        """Magnitude of the error, relative to the truth: the mean of it is the MAPE. (m,)"""
        return np.abs(self.mu / self.label_mu - 1.0)

    @property
    def log_ratio(self) -> FloatArray:
        """Natural logarithm of estimate over truth; positive where there is less grip than said. (m,)"""
        return np.log(np.maximum(self.mu, LEAST_MU) / self.label_mu)

    @property
    def utilisation_ratio(self) -> FloatArray:
        """Largest share of the grip that each used. (m,)"""
        return self.runs.labels["peak_utilisation_ratio"][self.rows]

    @property
    def mape_ratio(self) -> float:
        """Mean error relative to the truth over all passages."""
        return mape_ratio(self.label_mu, self.mu)

    @property
    def roads(self) -> tuple[str, ...]:
        """The road of each. (m,)"""
        return roads_of(self.runs, self.rows)

    def of_all_runs(self, values: FloatArray) -> FloatArray:
        """Return one value, or one line of them, for every run of the data set; NaN where none was judged. (runs, ...)

        Args:
            values: One per passage. (m, ...)
        """
        whole = np.full((len(self.runs), *values.shape[1:]), np.nan)
        whole[self.rows] = values
        return whole

    def column(self, name: str) -> FloatArray:
        """Return a feature of each. (m,)"""
        return self.runs.columns((name,))[self.rows, 0]

    def part(self, chosen: BoolArray) -> HeldOut:
        """Return some of the passages."""
        return replace(
            self,
            rows=self.rows[chosen],
            fold=self.fold[chosen],
            mu=self.mu[chosen],
            expected_error_ratio=self.expected_error_ratio[chosen],
        )


def held_out(
    bench: Workbench,
    grade: SensorGrade,
    recipe: Recipe,
    *,
    data_set: str = RANDOM_ROADS_SET,
    learned_sets: tuple[str, ...] = LEARNED_SETS,
) -> HeldOut:
    """Return the passages on random roads, each judged by regressors that learned from other roads.

    They learn from all sets together, whichever of them is judged.

    Args:
        bench: Where the data comes from.
        grade: Sensors.
        recipe: How to learn, and from which features.
        data_set: Which of the sets is judged.
        learned_sets: Names of the sets that are learned from; no road is in two of them.
    """

    def work() -> Arrays:
        sets = [bench.runs(name, grade) for name in learned_sets]
        rows = [rows_by_name(runs) for runs in sets]
        features = np.concatenate([runs.columns(recipe.features)[mine] for runs, mine in zip(sets, rows, strict=True)])
        label = np.concatenate([runs.labels["label_mu"][mine] for runs, mine in zip(sets, rows, strict=True)])
        roads = [road for runs, mine in zip(sets, rows, strict=True) for road in roads_of(runs, mine)]
        fold = road_folds(roads, seed=bench.seed)
        bench.report(f"unseen roads, {recipe.name}, {grade}", 0, 2)
        mu = estimates_by_strangers(learner(bench, recipe.learn), features, label, fold=fold)
        bench.report(f"unseen roads, {recipe.name}, {grade}", 1, 2)
        expected = estimates_by_strangers(
            learner(bench, EXPECTED_ERROR), features, log_error_ratio(mu, label), fold=fold
        )
        found: dict[str, FloatArray] = {}
        ends = np.cumsum([len(mine) for mine in rows])
        for name, mine, end in zip(learned_sets, rows, ends, strict=True):
            part = slice(end - len(mine), end)
            judged = _arrays(mine, fold[part], mu[part], expected[part])
            found |= {f"{name} {what}": values for what, values in judged.items()}
        return found

    found = bench.remembered(f"held-out-{'-'.join(learned_sets)}-{grade}-{recipe.key}-{bench.seed}", work)
    return _held_out(bench.runs(data_set, grade), found, prefix=f"{data_set} ")


def on_other_roads(
    bench: Workbench,
    grade: SensorGrade,
    recipe: Recipe,
    *,
    data_set: str,
    learned_sets: tuple[str, ...] = LEARNED_SETS,
) -> HeldOut:
    """Return the passages of a data set, judged by regressors that learned from all random roads.

    Args:
        bench: Where the data comes from.
        grade: Sensors.
        recipe: How to learn, and from which features.
        data_set: Its name; none of its roads may be learned from. There may be no runs.
        learned_sets: Names of the sets that are learned from.
    """

    def work() -> Arrays:
        judged = bench.runs(data_set, grade)
        rows = rows_by_name(judged)
        if len(rows) == 0:
            return _arrays(rows, rows, np.empty(0), np.empty(0))
        sets = [held_out(bench, grade, recipe, data_set=name, learned_sets=learned_sets) for name in learned_sets]
        features = np.concatenate([learned.runs.columns(recipe.features)[learned.rows] for learned in sets])
        label = np.concatenate([learned.label_mu for learned in sets])
        missed = np.concatenate([np.abs(learned.log_ratio) for learned in sets])
        there = judged.columns(recipe.features)[rows]
        mu = learner(bench, recipe.learn)(features, label)(there)
        expected = learner(bench, EXPECTED_ERROR)(features, missed)(there)
        return _arrays(rows, np.zeros_like(rows), mu, expected)

    learned_name = "-".join(learned_sets)
    found = bench.remembered(f"other-roads-{data_set}-{learned_name}-{grade}-{recipe.key}-{bench.seed}", work)
    return _held_out(bench.runs(data_set, grade), found)


def on_known_roads(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> HeldOut:
    """Return the paper's runs, each judged by regressors that know its road and not the drive."""

    def work() -> Arrays:
        runs = bench.runs(PAPER_SET, grade)
        rows = rows_by_name(runs)
        mu = paper_estimates(bench, grade, features=recipe.features, recipe=recipe)[rows]
        features, miss = runs.columns(recipe.features)[rows], log_error_ratio(mu, runs.labels["label_mu"][rows])
        # Dealt as the estimates are.
        fold = fold_numbers(len(rows), FOLDS_COUNT, seed=bench.seed)
        return _arrays(
            rows, fold, mu, estimates_by_strangers(learner(bench, EXPECTED_ERROR), features, miss, fold=fold)
        )

    found = bench.remembered(f"known-roads-{grade}-{recipe.key}-{bench.seed}", work)
    return _held_out(bench.runs(PAPER_SET, grade), found)


def left_out_roads(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> HeldOut:
    """Return the paper's runs, each judged by a regressor that learned from the paper's other roads.

    Two scenarios share a road: both are left out together. No error is expected of these (NaN): so few roads say
    nothing about the next one's.
    """

    def work() -> Arrays:
        runs = bench.runs(PAPER_SET, grade)
        rows = rows_by_name(runs)
        fold = np.unique(np.array(runs.section_id)[rows], return_inverse=True)[1]
        features, label = runs.columns(recipe.features)[rows], runs.labels["label_mu"][rows]
        mu = estimates_by_strangers(learner(bench, recipe.learn), features, label, fold=fold)
        return _arrays(rows, fold, mu, np.full(len(rows), np.nan))

    found = bench.remembered(f"left-out-{grade}-{recipe.key}-{bench.seed}", work)
    return _held_out(bench.runs(PAPER_SET, grade), found)


def mean_by_road(values: FloatArray, roads: tuple[str, ...]) -> FloatArray:
    """Return the mean of some values for every road, roads by name. (roads,)

    Args:
        values: One per passage. (m,)
        roads: The road of each. (m,)
    """
    _, place = np.unique(np.array(roads), return_inverse=True)
    mean: FloatArray = np.bincount(place, weights=values) / np.bincount(place)
    return mean


def surest(expected_error_ratio: FloatArray, *, kept_frac: float) -> BoolArray:
    """Return which passages have the least error to expect: a given share, rounded up, and at least one. (m,)"""
    kept_count = max(1, int(np.ceil(kept_frac * len(expected_error_ratio) - 1e-9)))
    kept = np.zeros(len(expected_error_ratio), dtype=np.bool_)
    kept[np.argsort(expected_error_ratio, kind="stable")[:kept_count]] = True
    return kept


def band_of(values: FloatArray, band: tuple[float, float]) -> BoolArray:
    """Return which values lie in a band, its lower edge included. (m,)"""
    return (values >= band[0]) & (values < band[1])


def by_use(utilisation_ratio: FloatArray) -> dict[str, BoolArray]:
    """Return which passages lie in each of `UTILISATION_BANDS`, by the band's name; a band may be empty. Each (m,)

    Args:
        utilisation_ratio: Largest share of the grip that each used. (m,)
    """
    return {band_name(band): band_of(utilisation_ratio, band) for band in UTILISATION_BANDS}


def band_name(band: tuple[float, float], *, unit: str = "") -> str:
    """Return a band for people, such as "0.3 to 0.4", "below 0.3" or "0.8 and more"."""
    low, high = band
    unit = f" {unit}" if unit else ""
    if low <= 0.0:
        return f"below {high:g}{unit}"
    return f"{low:g}{unit} and more" if np.isinf(high) else f"{low:g} to {high:g}{unit}"


def _arrays(rows: RowIndices, fold: RowIndices, mu: FloatArray, expected: FloatArray) -> Arrays:
    return {
        "rows": rows.astype(np.float64),
        "fold": fold.astype(np.float64),
        "mu": mu,
        "expected_error_ratio": np.maximum(expected, LEAST_ERROR_RATIO),
    }


def _held_out(runs: Runs, found: Mapping[str, FloatArray], *, prefix: str = "") -> HeldOut:
    return HeldOut(
        runs=runs,
        rows=found[f"{prefix}rows"].astype(np.intp),
        fold=found[f"{prefix}fold"].astype(np.intp),
        mu=found[f"{prefix}mu"],
        expected_error_ratio=found[f"{prefix}expected_error_ratio"],
    )

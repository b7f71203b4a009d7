"""A model as a unit would have it in its bundle: friction, expected error, envelope, and what they mean together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from roadgrip.bundle import Conformal, GoldenVectors, ModelManifest
from roadgrip.features import NEWEST_TABLE, TABLES, FeatureTable
from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.envelope import is_strange_driving, is_strange_road, outside_box
from rsu_app.domain.judgement import Judgement, judgement
from training.bundling import learn_envelope
from training.dataset import Runs, joined
from training.designs import PAPER_ROADS
from training.error_model import log_error_ratio
from training.regressor import RowIndices
from training.study.chapter import Arrays, Workbench
from training.study.folds import (
    PAPER_SET,
    RANDOM_ROADS_SET,
    estimates_by_strangers,
    fold_numbers,
    learner,
    road_folds,
    rows_by_name,
)
from training.study.generalise.held_out import EXPECTED_ERROR, LEAST_ERROR_RATIO
from training.study.recipes import Estimator, Recipe
from training.table_models import Answers, calibrated, ordinary_by_rows
from vehicle_client.simulator.plan import SensorGrade

ANY_SPEED_SET = "any-speed"
DATA_SETS = (PAPER_SET, RANDOM_ROADS_SET, ANY_SPEED_SET)
USUAL_SETS = (PAPER_SET, RANDOM_ROADS_SET)
FOLDS_COUNT = 4
MOST_DRIVES_COUNT = 15_000
"""Of a data set, that the chapter stays within minutes: how exact a model can get is asked elsewhere."""


@dataclass(frozen=True, slots=True)
class LoopModel:
    """A taught model that judges passages as a unit does.

    Attributes:
        friction: From the recipe's features to friction.
        expected_error: From the same features to the relative error to expect.
        places: Where the recipe's features stand in a row of the newest table. (features,)
        table_places: Where those of the model's own table stand in it. (columns,)
        manifest: What its bundle says of it; range, envelope and the meaning of errors are read.
    """

    friction: Estimator
    expected_error: Estimator
    places: RowIndices
    table_places: RowIndices
    manifest: ModelManifest

    def __call__(self, rows: FloatArray) -> list[Judgement]:
        """Return what passages say.

        Args:
            rows: Features of the newest table. (n, columns)
        """
        features, own = rows[:, self.places], rows[:, self.table_places]
        expected = np.maximum(self.expected_error(features), LEAST_ERROR_RATIO)
        return [
            judgement(row, self.manifest, mu=mu, expected_error_ratio=error)
            for row, mu, error in zip(own, self.friction(features).tolist(), expected.tolist(), strict=True)
        ]


@dataclass(frozen=True, slots=True)
class Teaching:
    """What regressors of the loop are taught.

    Attributes:
        name: For tables.
        recipe: How friction is learned.
        data_sets: From which drives.
        in_a_box: Whether its bundle only holds the box of the features' extremes, not what ordinary driving looks like.
    """

    name: str
    recipe: Recipe
    data_sets: tuple[str, ...]
    in_a_box: bool = False

    @property
    def key(self) -> str:
        """What names arrays that depend on it."""
        return f"{self.recipe.key}-{'-'.join(self.data_sets)}"


@dataclass(frozen=True, slots=True)
class Gathered:
    """The drives of some data sets together.

    Attributes:
        runs: Those with a summary, set by set and by name.
        data_set: Where each comes from. (n,)
        fold: The fold that each is judged in: whole roads of random ones, single drives of the paper's. (n,)
    """

    runs: Runs
    data_set: NDArray[np.str_]
    fold: RowIndices

    def of(self, *names: str) -> BoolArray:
        """Return which come from some of the data sets. (n,)"""
        return np.isin(self.data_set, names)

    @property
    def label_mu(self) -> FloatArray:
        """The truth. (n,)"""
        return self.runs.labels["label_mu"]


def gathered(bench: Workbench, grade: SensorGrade) -> Gathered:
    """Return drives that regressors of the loop are taught with or judged on: all, or so many by chance."""
    parts, names = [], []
    for name in DATA_SETS:
        runs = bench.runs(name, grade)
        rows = rows_by_name(runs)
        if len(rows) > MOST_DRIVES_COUNT:
            chosen = np.random.default_rng(bench.seed).permutation(len(rows))[:MOST_DRIVES_COUNT]
            rows = rows[np.sort(chosen)]
        parts.append(runs.rows(rows))
        names += [name] * len(parts[-1])
    runs = joined(parts)
    known = np.array([section_id in PAPER_ROADS for section_id in runs.section_id])
    fold = road_folds(list(runs.section_id), seed=bench.seed) % FOLDS_COUNT
    fold[known] = fold_numbers(int(known.sum()), FOLDS_COUNT, seed=bench.seed)
    return Gathered(runs, np.array(names), fold)


def strangers_answers(bench: Workbench, grade: SensorGrade, teaching: Teaching) -> Answers:
    """Return what strangers say of all gathered drives, whether regressors are taught with such drives or not.

    They were taught neither the drive nor, if its road is a random one, other drives on it.
    """

    def work() -> Arrays:
        drives = gathered(bench, grade)
        features, taught = drives.runs.columns(teaching.recipe.features), drives.of(*teaching.data_sets)
        by_strangers = partial(estimates_by_strangers, fold=drives.fold, taught=taught)
        mu = by_strangers(learner(bench, teaching.recipe.learn), features, drives.label_mu)
        expected = by_strangers(learner(bench, EXPECTED_ERROR), features, log_error_ratio(mu, drives.label_mu))
        return {"mu": mu, "expected_error_ratio": np.maximum(expected, LEAST_ERROR_RATIO)}

    found = bench.remembered(f"loop-strange-{grade}-{teaching.key}-{bench.seed}", work)
    return Answers(found["mu"], found["expected_error_ratio"])


def loop_model(bench: Workbench, grade: SensorGrade, teaching: Teaching) -> LoopModel:
    """Return a taught model as it would stand in a bundle.

    What error to expect, and what that means, is learned from estimates by strangers.

    Args:
        bench: Where the data comes from.
        grade: Sensors.
        teaching: What it is taught.
    """
    drives, judged = gathered(bench, grade), strangers_answers(bench, grade, teaching)
    taught = drives.of(*teaching.data_sets)
    table = _table_of(teaching.recipe)
    features, label_mu = drives.runs.columns(teaching.recipe.features)[taught], drives.label_mu[taught]
    return LoopModel(
        friction=learner(bench, teaching.recipe.learn)(features, label_mu),
        expected_error=learner(bench, EXPECTED_ERROR)(features, log_error_ratio(judged.mu[taught], label_mu)),
        places=NEWEST_TABLE.columns(teaching.recipe.features),
        table_places=NEWEST_TABLE.columns_of(table),
        manifest=ModelManifest(
            table_digest=table.digest,
            feature_names=table.names,
            model_file="friction",
            error_model_file="error",
            mu_range=(float(label_mu.min()), float(label_mu.max())),
            envelope=learn_envelope(drives.runs.columns(table.names)[taught]),
            golden=GoldenVectors(rows=(), mu=(), expected_error_ratio=()),
            conformal=_calibrated(drives, judged, taught),
            ordinary=None if teaching.in_a_box else ordinary_by_rows(drives.runs, taught, table=table, seed=bench.seed),
        ),
    )


def loop_models(bench: Workbench, grade: SensorGrade, teachings: Sequence[Teaching]) -> dict[str, LoopModel]:
    """Return taught models by name; those that only differ by their envelope are taught once."""
    models: dict[str, LoopModel] = {}
    for done, one in enumerate(teachings):
        bench.report(f"models of the closed loop, {grade}", done, len(teachings))
        whole = [
            two.name for two in teachings[:done] if one.in_a_box and replace(one, name=two.name, in_a_box=False) == two
        ]
        if whole:
            known = models[whole[0]]
            models[one.name] = replace(known, manifest=replace(known.manifest, ordinary=None))
        else:
            models[one.name] = loop_model(bench, grade, one)
    return models


@dataclass(frozen=True, slots=True)
class Taught:
    """What a teaching comes to on drives that were not taught.

    Attributes:
        mape_ratio: Mean error relative to the truth, by data set.
        doubtful_frac: Share of the drives that are taken for lower bounds, by data set.
        outside_box_frac: Share that a box of the features' extremes calls outside, by data set.
        strange_frac: Share that the envelope of ordinary roads and driving calls strange, by data set.
    """

    mape_ratio: Mapping[str, float]
    doubtful_frac: Mapping[str, float]
    outside_box_frac: Mapping[str, float]
    strange_frac: Mapping[str, float]


def what_is_taught(bench: Workbench, grade: SensorGrade, teaching: Teaching) -> Taught:
    """Return what a teaching comes to; envelopes are judged by one fold, the estimates by all."""
    drives, judged = gathered(bench, grade), strangers_answers(bench, grade, teaching)
    error_ratio = np.abs(judged.mu / drives.label_mu - 1.0)
    meant = _calibrated(drives, judged, drives.of(*teaching.data_sets))
    doubtful = judged.expected_error_ratio > meant.doubtful_above_ratio

    def work() -> Arrays:
        table = _table_of(teaching.recipe)
        values, learned = drives.runs.columns(table.names), drives.of(*teaching.data_sets) & (drives.fold != 0)
        ordinary = ordinary_by_rows(drives.runs, learned, table=table, seed=bench.seed)
        strange_road = is_strange_road(values, ordinary, table.names)
        return {
            "outside": outside_box(values, learn_envelope(values[learned])).astype(np.float64),
            "strange": (strange_road | is_strange_driving(values, ordinary, table.names)).astype(np.float64),
        }

    flags = bench.remembered(f"loop-envelopes-{grade}-{teaching.key}-{bench.seed}", work)
    parts = {name: drives.of(name) for name in DATA_SETS}
    return Taught(
        mape_ratio={name: float(error_ratio[part].mean()) for name, part in parts.items()},
        doubtful_frac={name: float(doubtful[part].mean()) for name, part in parts.items()},
        outside_box_frac={
            name: float(flags["outside"][part & (drives.fold == 0)].mean()) for name, part in parts.items()
        },
        strange_frac={name: float(flags["strange"][part & (drives.fold == 0)].mean()) for name, part in parts.items()},
    )


def _calibrated(drives: Gathered, judged: Answers, taught: BoolArray) -> Conformal:
    """Return what expected errors mean, as for a bundle: by random roads that nobody had learned. `taught`: (n,)"""
    random = taught & ~np.isin(drives.runs.section_id, PAPER_ROADS)
    return calibrated(judged, drives.runs.labels, rows=random)


def _table_of(recipe: Recipe) -> FeatureTable:
    """Return the oldest feature table that a recipe's features are of: what a vehicle sends for it."""
    return next(table for table in TABLES.values() if set(recipe.features) <= set(table.names))

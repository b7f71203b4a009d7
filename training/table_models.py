"""The model of a feature table with all that a unit must be told of it, and what strangers made of the same drives.

Whoever judges a drive learned nothing from it, and nothing from its road if that is a random one: what error to expect,
how wide an interval has to be, and the figures of the bundle all come from estimates of such strangers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import xgboost

from roadgrip.bundle import Conformal, OrdinaryDriving
from roadgrip.features import NEWEST_TABLE, PAPER_TABLE, FeatureTable
from roadgrip.units import BoolArray, FloatArray
from training.accuracy import FEWEST_ROADS
from training.bundling import TableModel
from training.conformal import conformal_of
from training.dataset import DatasetError, Runs
from training.designs import PAPER_ROADS
from training.drift.reference import learn_references
from training.error_model import LEAST_MU, grow_error_trees, log_error_ratio
from training.fit_parameters import FitParameters
from training.regressor import RowIndices, estimate_mu, grow_trees
from training.study.envelopes import Ordinary, driving_columns, learn_whole_envelope
from training.study.folds import fold_numbers, road_folds, side_by_side
from training.study.generalise.doubt import best_threshold
from training.study.recipes import BEST_RECIPE, Boosted

FOLDS_COUNT = 4
COVERAGE_FRAC = 0.9
"""How often the interval of a single estimate shall hold the truth."""
LITTLE_USE_RATIO = 1.0 / 3.0
"""Who never used a larger share of the grip shall say "at least"."""
LEAST_DOUBTFUL_RATIO = 0.05
"""An estimate with a smaller error to expect names the friction, however little of the grip was used."""
FRICTION_EDGES_MU = (0.3, 0.4, 0.5, 0.6)
USE_EDGES_RATIO = (0.3, 0.4, 0.6, 0.8)
"""Between these edges of the truth lie groups of passages that intervals must not forget."""


@dataclass(frozen=True, slots=True)
class TablePlan:
    """How the model of a feature table is grown.

    Attributes:
        table: The table.
        features: What the trees see, in this order.
        parameters: How those of friction are grown.
    """

    table: FeatureTable
    features: tuple[str, ...]
    parameters: FitParameters

    @property
    def version(self) -> str:
        """Names the table in figures and files, such as "v1"."""
        return f"v{self.table.version}"

    @property
    def column_names(self) -> tuple[str, ...] | None:
        """The features as a bundle wants to know them: None for the table's own in its order."""
        return None if self.features == self.table.names else self.features


@dataclass(frozen=True, slots=True)
class LearnedDrives:
    """Drives to learn from, those with a summary, by their names.

    Attributes:
        runs: The drives, of the newest feature table.
        fold: The fold that each is judged in: whole roads of random ones, single drives of known ones. (n,)
        own: Which are of a road authority's own roads, beside what the paper has; None for none. (n,)
        weight_ratio: What the squared error of each counts, one in the mean; None if all count alike. (n,)
        marks: Which belong to further parts that are judged for themselves, by the parts' names. Each (n,)
    """

    runs: Runs
    fold: RowIndices
    own: BoolArray | None = None
    weight_ratio: FloatArray | None = None
    marks: Mapping[str, BoolArray] = field(default_factory=dict)

    @property
    def known(self) -> BoolArray:
        """Which were driven on known roads: the paper's, and one's own. (n,)"""
        return _on_known_roads(np.array(self.runs.section_id), self.own)

    @property
    def calibrating(self) -> BoolArray:
        """Which say what an expected error means: those on random roads; all of them where all are of one road. (n,)"""
        return np.ones(len(self.runs), dtype=np.bool_) if self.known.all() else ~self.known

    @property
    def label_mu(self) -> FloatArray:
        """The truth. (n,)"""
        return self.runs.labels["label_mu"]


@dataclass(frozen=True, slots=True)
class Answers:
    """What models say of drives.

    Attributes:
        mu: Friction. (n,)
        expected_error_ratio: Magnitude of the error to expect, on the logarithm. (n,)
    """

    mu: FloatArray
    expected_error_ratio: FloatArray


@dataclass(frozen=True, slots=True)
class GrownModel:
    """The model of a feature table.

    Attributes:
        plan: How it was grown.
        friction: Its trees.
        error: Those of the error to expect.
        strangers: What strangers made of the drives it learned from.
        conformal: What the expected errors mean, by the random roads.
    """

    plan: TablePlan
    friction: xgboost.Booster
    error: xgboost.Booster
    strangers: Answers
    conformal: Conformal

    def answers(self, runs: Runs) -> Answers:
        """Return what the model says of other drives, all of which have a summary."""
        features = runs.columns(self.plan.features)
        return Answers(estimate_mu(self.friction, features), estimate_mu(self.error, features))

    def for_bundle(
        self,
        learned: Runs,
        *,
        unseen: Runs,
        ordinary: OrdinaryDriving,
        watched_roads: Sequence[str] | None = None,
    ) -> TableModel:
        """Return what a bundle holds of the model.

        Args:
            learned: What it learned from.
            unseen: Drives with a summary that it never saw.
            ordinary: Roads and driving it is made for.
            watched_roads: Roads whose traffic units shall hold against that of the training, for which all of it is
                told, too; None tells nothing of how the training was distributed.
        """
        names = self.plan.column_names
        rows = learned.for_table(self.plan.table).features
        return TableModel(
            table=self.plan.table,
            friction=self.friction,
            train_rows=rows,
            train_label_mu=learned.labels["label_mu"],
            unseen_rows=unseen.for_table(self.plan.table).features,
            error=self.error,
            conformal=self.conformal,
            column_names=names,
            error_column_names=names,
            ordinary=ordinary,
            references=()
            if watched_roads is None
            else learn_references(rows, self.strangers.mu, learned.section_id, known_sections=watched_roads),
        )


def best_plan(*, seed: int) -> TablePlan:
    """Return how the newest table's model is grown: by the study's best recipe."""
    learn = BEST_RECIPE.learn
    if not isinstance(learn, Boosted) or learn.relative:
        raise TypeError("a bundle holds trees of plain squared errors; the best recipe is of another kind")
    return TablePlan(NEWEST_TABLE, BEST_RECIPE.features, replace(learn.parameters, seed=seed))


def paper_plan(parameters: FitParameters) -> TablePlan:
    """Return how the model of the paper's 78 features is grown."""
    return TablePlan(PAPER_TABLE, PAPER_TABLE.names, parameters)


def learned_drives(
    runs: Runs,
    *,
    seed: int,
    own: BoolArray | None = None,
    weight_ratio: FloatArray | None = None,
    marks: Mapping[str, BoolArray] | None = None,
) -> LearnedDrives:
    """Return the drives to learn from, dealt to folds; the order of the rows changes nothing.

    A drive that is there under both grades of sensors, by one name, is judged in one fold: who knows the one knows the
    other.

    Args:
        runs: The drives.
        seed: Deals folds.
        own: Which are of a road authority's own roads, to be dealt drive by drive like those of the paper's. (n,)
        weight_ratio: What the squared error of each counts, positive; all alike by default. (n,)
        marks: Which belong to further parts that are judged for themselves, by the parts' names. Each (n,)

    Raises:
        DatasetError: There are too few random roads to say anything about the next one.
    """
    order = np.argsort(np.array(runs.run_key), kind="stable")
    place = order[runs.usable[order]]
    usable = runs.rows(place)
    sections = np.array(usable.section_id)
    dealt_own = None if own is None else own[place]
    known = _on_known_roads(sections, dealt_own)
    roads_count = len(set(sections[~known].tolist()))
    if roads_count < FEWEST_ROADS:
        raise DatasetError(
            f"{roads_count} random roads say nothing about the next one; at least {FEWEST_ROADS} are needed"
        )
    fold = np.empty(len(sections), dtype=np.intp)
    fold[~known] = road_folds(sections[~known].tolist(), seed=seed, folds_count=FOLDS_COUNT)
    fold[known] = drive_folds(np.array(usable.run_key)[known].tolist(), seed=seed)
    return LearnedDrives(
        runs=usable,
        fold=fold,
        own=dealt_own,
        weight_ratio=None if weight_ratio is None else weight_ratio[place] / weight_ratio[place].mean(),
        marks={name: rows[place] for name, rows in (marks or {}).items()},
    )


def drive_folds(run_keys: Sequence[str], *, seed: int) -> RowIndices:
    """Return which fold each drive is judged in, those of one name in the same. (n,)"""
    drives, drive = np.unique(np.array(run_keys), return_inverse=True)
    return fold_numbers(len(drives), FOLDS_COUNT, seed=seed)[drive]


def grown_model(
    drives: LearnedDrives,
    plan: TablePlan,
    *,
    doubtful_above_ratio: float | None = None,
    on_step: Callable[[int], None] | None = None,
) -> GrownModel:
    """Return the model of a table, with what error to expect of it and what that means.

    Args:
        drives: What to learn from.
        plan: How.
        doubtful_above_ratio: See `calibrated`.
        on_step: Called with the number of steps that are done, of `steps_count()`.
    """
    features, label_mu, fold = drives.runs.columns(plan.features), drives.label_mu, drives.fold
    mu, expected = np.full(len(features), np.nan), np.full(len(features), np.nan)
    whole: list[xgboost.Booster] = []

    def grow(rows: BoolArray) -> xgboost.Booster:
        weight = None if drives.weight_ratio is None else drives.weight_ratio[rows]
        return grow_trees(features[rows], label_mu[rows], plan.parameters, weight_ratio=weight, threads_count=1)

    def judge(number: int) -> None:
        out = fold == number
        mu[out] = estimate_mu(grow(~out), features[out], threads_count=1)

    def expect(number: int) -> None:
        out = fold == number
        trees = grow_error_trees(features[~out], miss[~out], threads_count=1)
        expected[out] = estimate_mu(trees, features[out], threads_count=1)

    everything = np.ones(len(features), dtype=np.bool_)
    jobs: list[Callable[[], None]] = [
        lambda: whole.append(grow(everything)),
        *(partial(judge, number) for number in range(FOLDS_COUNT)),
    ]
    side_by_side(jobs, on_done=on_step)
    miss = log_error_ratio(mu, label_mu)
    report = on_step or (lambda _: None)
    jobs = [
        lambda: whole.append(grow_error_trees(features, miss, threads_count=1)),
        *(partial(expect, number) for number in range(FOLDS_COUNT)),
    ]
    side_by_side(jobs, on_done=lambda done: report(FOLDS_COUNT + 1 + done))
    strangers = Answers(mu, expected)
    return GrownModel(
        plan=plan,
        friction=whole[0],
        error=whole[1],
        strangers=strangers,
        conformal=calibrated(
            strangers, drives.runs.labels, rows=drives.calibrating, doubtful_above_ratio=doubtful_above_ratio
        ),
    )


def steps_count() -> int:
    """Return how many steps `grown_model` takes."""
    return 2 * (FOLDS_COUNT + 1)


def calibrated(
    answers: Answers, labels: Mapping[str, FloatArray], *, rows: BoolArray, doubtful_above_ratio: float | None = None
) -> Conformal:
    """Return what expected errors mean by some of the rows.

    Doubtful, and so a bound, is what has more error to expect than the value that best parts passages that used little
    of the grip from the others. The error to expect is asked rather than the share of the grip that a passage seems to
    have used: who takes a slippery road for a good one seems to have used little, and its bound would not hold.

    Only a simulator knows how much of the grip was used: other rows have no say in that.

    Args:
        answers: What strangers said. (n,)
        labels: What is known of the drives; columns of (n,).
        rows: Those to calibrate by. (n,)
        doubtful_above_ratio: From where on an estimate is doubtful, where it was learned elsewhere.

    Raises:
        DatasetError: It was not, and of no row it is known how much of the grip was used.
    """
    label_mu, use_ratio = labels["label_mu"][rows], labels["peak_utilisation_ratio"][rows]
    expected, used = answers.expected_error_ratio[rows], np.isfinite(use_ratio)
    if doubtful_above_ratio is None:
        if not used.any():
            raise DatasetError("of no drive on a random road it is known how much of the grip it used; simulate some")
        parting = best_threshold(expected[used], use_ratio[used] < LITTLE_USE_RATIO)
        doubtful_above_ratio = max(LEAST_DOUBTFUL_RATIO, parting)
    use_group = np.searchsorted(USE_EDGES_RATIO, use_ratio, side="right")
    return conformal_of(
        label_mu,
        np.maximum(answers.mu[rows], LEAST_MU),
        expected,
        coverage_frac=COVERAGE_FRAC,
        doubtful_above_ratio=doubtful_above_ratio,
        groupings=(
            np.searchsorted(FRICTION_EDGES_MU, label_mu, side="right"),
            # What is not known is a group of its own, not the one of those that used most.
            np.where(used, use_group, len(USE_EDGES_RATIO) + 1),
        ),
    )


def ordinary_driving(
    drives: LearnedDrives, *, seed: int, table: FeatureTable = PAPER_TABLE, without_fold: int | None = None
) -> OrdinaryDriving:
    """Return which roads and which driving are ordinary by the drives, for models of a table and of newer ones.

    Args:
        drives: What to learn from.
        seed: See `learn_whole_envelope`.
        table: Whose features are asked; the newer, the better it tells a manoeuvre.
        without_fold: A fold to keep out, so that it can judge.
    """
    learned = np.ones(len(drives.runs), dtype=np.bool_) if without_fold is None else drives.fold != without_fold
    return ordinary_by_rows(drives.runs, learned, table=table, seed=seed, known=drives.known)


def ordinary_by_rows(
    runs: Runs, learned: BoolArray, *, table: FeatureTable, seed: int, known: BoolArray | None = None
) -> OrdinaryDriving:
    """Return which roads and which driving are ordinary by some rows.

    Without a known road the random one that was driven most stands for it.

    Args:
        runs: Drives.
        learned: Which of them are learned from; all of these have a summary. (n,)
        table: Whose features are asked.
        seed: See `learn_whole_envelope`.
        known: Which were driven on known roads; those on the paper's by default. (n,)
    """
    names, sections = table.names, np.array(runs.section_id)
    known = np.isin(sections, PAPER_ROADS) if known is None else known
    if not (learned & known).any():
        driven, counts = np.unique(sections[learned], return_counts=True)
        known = sections == driven[np.argmax(counts)]
    values = runs.columns(names)
    roads: Sequence[str] = sections[learned & ~known].tolist()
    return learn_whole_envelope(
        Ordinary(values[learned & known], values[learned & ~known], tuple(roads), names),
        road_columns=[feature.name for feature in table.road],
        driving_columns=driving_columns(table),
        seed=seed,
    )


def _on_known_roads(sections: np.ndarray[tuple[int], np.dtype[np.str_]], own: BoolArray | None) -> BoolArray:
    roads = list(PAPER_ROADS) if own is None else [*PAPER_ROADS, *sections[own].tolist()]
    return np.isin(sections, roads)

"""Data sets of the shelf become drives to learn from and drives that only judge.

The order in which data sets are named changes nothing: they are taken by their digests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roadgrip.errors import FeatureTableError
from roadgrip.features import FeatureTable
from roadgrip.units import BoolArray, FloatArray
from training.accuracy import FEWEST_ROADS
from training.data.data_shelf import DataKind, DataSet, row_hashes
from training.dataset import DatasetError, Runs, joined
from training.designs import EXACT_SUFFIX, PAPER_ROADS
from training.table_models import LearnedDrives, learned_drives

FRESH_ROADS_FRAC = 0.05
"""Share of the random roads that only judge."""
LABEL_SCALE_RATIO = 0.05
"""A label as uncertain as this, relative to itself, counts half: about what a good model errs by."""
RANDOM_ROAD_PREFIX = "random-"
"""What the sections of random roads are called by; every other one is a road that is driven again."""
UNKNOWN_GRADE, MEASURED_GRADE, EXACT_GRADE = "unknown", "measured", "ideal"
_GRADE_KEY = "sensor_grade"


@dataclass(frozen=True, slots=True)
class DealtDrives:
    """What a retraining learns from and what it is judged by.

    Attributes:
        learned: Drives to learn from.
        fresh: Drives with a summary on random roads of which nothing is learned, by the part of the figures.
        runs: All drives, failed ones and repeated ones included.
        repeated_count: Drives that another data set had brought already.
    """

    learned: LearnedDrives
    fresh: dict[str, Runs]
    runs: Runs
    repeated_count: int

    @property
    def unseen(self) -> Runs:
        """All drives that nothing is learned from."""
        return joined(list(self.fresh.values()))


def dealt_drives(data_sets: Sequence[DataSet], *, table: FeatureTable, seed: int) -> DealtDrives:
    """Return the drives of data sets, dealt.

    Args:
        data_sets: At least one, none of them a hold-out.
        table: The newest feature table that a model is to serve.
        seed: Deals roads and drives.

    Raises:
        DatasetError: There are too few random roads, or drives of an older feature table.
    """
    ordered = sorted(data_sets, key=lambda data_set: data_set.card.digest)
    runs = joined([_of_table(data_set, table) for data_set in ordered])
    of_set = np.repeat(np.arange(len(ordered)), [len(data_set.runs) for data_set in ordered])
    own = own_drives(runs, measured=np.array([d.card.kind is DataKind.MEASURED for d in ordered])[of_set])
    grade = np.concatenate([sensor_grades(data_set) for data_set in ordered])
    first = _first_of_each(runs)
    taught = runs.usable & first
    judging = taught & fresh_roads(runs, taught, own=own, seed=seed)
    rows = np.flatnonzero(taught & ~judging)
    weight_ratio = np.concatenate([label_weight_ratio(data_set) for data_set in ordered])
    marks = {f"sensors.{name}": grade == name for name in sorted(set(grade.tolist()) - {UNKNOWN_GRADE})}
    if len(ordered) > 1:
        marks |= {f"set.{data_set.card.name}": of_set == i for i, data_set in enumerate(ordered)}
    learned = learned_drives(
        runs.rows(rows),
        seed=seed,
        own=own[rows] if own.any() else None,
        weight_ratio=None if (weight_ratio == 1.0).all() else weight_ratio[rows],
        marks={name: mark[rows] for name, mark in marks.items()},
    )
    return DealtDrives(
        learned=learned,
        fresh=_by_grade(runs, judging, grade),
        runs=runs,
        repeated_count=int((runs.usable & ~first).sum()),
    )


def own_drives(runs: Runs, *, measured: BoolArray) -> BoolArray:
    """Return which drives are of a road authority's own roads. (n,)

    That is every measured one, and every one on a section that is neither of the paper's nor drawn at random.

    Args:
        runs: The drives.
        measured: Whose friction was measured, not simulated. (n,)
    """
    sections = np.array(runs.section_id)
    return measured | ~(np.isin(sections, PAPER_ROADS) | np.char.startswith(sections, RANDOM_ROAD_PREFIX))


def label_weight_ratio(data_set: DataSet) -> FloatArray:
    """Return what the squared error of each drive shall count: 1 with an exact label, less with an uncertain one. (n,)

    Errors of a model and of a label add up in what is seen, and each drive weighs by how little of both it has.

    References:
        Carroll and Ruppert, Transformation and Weighting in Regression, 1988, chapter 2.
    """
    if data_set.label_sd_mu is None:
        return np.ones(len(data_set.runs))
    relative = data_set.label_sd_mu / data_set.runs.labels["label_mu"]
    # Rows without a label teach nothing; what they would count is one.
    return np.where(np.isfinite(relative), 1.0 / (1.0 + (relative / LABEL_SCALE_RATIO) ** 2), 1.0)


def sensor_grades(data_set: DataSet) -> np.ndarray[tuple[int], np.dtype[np.str_]]:
    """Return what sensors each drive was made with, as far as its data set tells. (n,)"""
    measured = data_set.card.kind is DataKind.MEASURED
    told = MEASURED_GRADE if measured else data_set.card.made_from.get(_GRADE_KEY, UNKNOWN_GRADE)
    exact = np.char.endswith(np.array(data_set.runs.scenario), EXACT_SUFFIX)
    return np.where(exact, EXACT_GRADE, told)


def fresh_roads(runs: Runs, taught: BoolArray, *, own: BoolArray, seed: int) -> BoolArray:
    """Return which drives are on the random roads that only judge, whoever drove there. (n,)

    Args:
        runs: The drives.
        taught: Those that could teach. (n,)
        own: Those on own roads. (n,)
        seed: Picks roads.

    Raises:
        DatasetError: There would be too few left to learn from.
    """
    sections = np.array(runs.section_id)
    roads = sorted(set(sections[taught & ~own & ~np.isin(sections, PAPER_ROADS)].tolist()))
    if len(roads) <= FEWEST_ROADS:
        raise DatasetError(
            f"{len(roads)} random roads with drives; at least {FEWEST_ROADS + 1} are needed, {FEWEST_ROADS} to say "
            "what the next road is like, and one that only judges. Simulate some, and name that data set too"
        )
    count = min(max(1, round(FRESH_ROADS_FRAC * len(roads))), len(roads) - FEWEST_ROADS)
    picked = np.random.default_rng([seed, len(roads)]).permutation(roads)[:count]
    return np.isin(sections, picked)


def _of_table(data_set: DataSet, table: FeatureTable) -> Runs:
    try:
        return data_set.runs.for_table(table)
    except FeatureTableError as error:
        older = data_set.runs.table.version
        raise DatasetError(
            f"{data_set.card.name} ({data_set.card.digest}) is of feature table {older}: nothing of table "
            f"{table.version} can be learned from it; leave it out, or make a model of table {older} alone"
        ) from error


def _first_of_each(runs: Runs) -> BoolArray:
    """Return which drives no drive before tells the same as. (n,)"""
    seen: set[bytes] = set()
    first = np.ones(len(runs), dtype=np.bool_)
    for i, row in enumerate(row_hashes(runs)):
        first[i] = row not in seen
        if row:
            seen.add(row)
    return first


def _by_grade(runs: Runs, judging: BoolArray, grade: np.ndarray[tuple[int], np.dtype[np.str_]]) -> dict[str, Runs]:
    names = sorted(set(grade[judging].tolist()))
    return {
        "fresh_roads" + ("" if name == UNKNOWN_GRADE else f"_{name}"): runs.rows(
            np.flatnonzero(judging & (grade == name))
        )
        for name in names
    }

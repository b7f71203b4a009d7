"""What a bundle says of its own worth: figures by road, driver, friction, use of the grip and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from roadgrip.bundle import Conformal, OrdinaryDriving
from roadgrip.units import BoolArray, FloatArray
from rsu_app.domain.envelope import is_strange_driving, is_strange_road
from training.conformal import stated_nonconformity_ratio
from training.dataset import Runs
from training.designs import ANY_SPEED_SUFFIX, EXACT_SUFFIX, PAPER_ROADS, TWO_FRICTIONS_SUFFIX
from training.error_model import LEAST_MU
from training.study.generalise.held_out import HIGH_UTILISATION_RATIO
from training.table_models import (
    FOLDS_COUNT,
    FRICTION_EDGES_MU,
    LITTLE_USE_RATIO,
    Answers,
    GrownModel,
    LearnedDrives,
    calibrated,
)

OWN_ROADS = "own_roads"
"""The part of the drives on a road authority's own roads."""
FRICTION_BANDS_MU = tuple(pairwise((0.0, *FRICTION_EDGES_MU, 1.0)))


def figures_of(model: GrownModel, drives: LearnedDrives) -> dict[str, float]:
    """Return figures of a model by strangers' estimates of the drives it learned from, named `figure.part.version`."""
    parts = parts_of(drives.runs, known=drives.known) | own_parts_of(drives) | dict(drives.marks)
    figures = stranger_figures(model, drives, parts)
    random = ~drives.known
    _, road = np.unique(np.array(drives.runs.section_id)[random], return_inverse=True)
    error = np.abs(model.strangers.mu / drives.label_mu - 1.0)
    by_road = np.bincount(road, weights=error[random]) / np.bincount(road)
    return figures | {f"mape_ratio.mean_unseen_road.{model.plan.version}": float(by_road.mean())}


def stranger_figures(
    model: GrownModel,
    drives: LearnedDrives,
    parts: Mapping[str, BoolArray],
    *,
    doubtful_above_ratio: float | None = None,
) -> dict[str, float]:
    """Return figures by strangers' estimates of some parts of the drives, named `figure.part.version`.

    Args:
        model: The model.
        drives: What it learned from.
        parts: Which belong to each part. Each (n,)
        doubtful_above_ratio: See `calibrated`.
    """
    held = np.zeros(len(drives.runs), dtype=np.bool_)
    for number in range(FOLDS_COUNT):
        # The interval of a fold has the width that the other folds' random roads ask for.
        out = drives.fold == number
        meaning = calibrated(
            model.strangers,
            drives.runs.labels,
            rows=~out & drives.calibrating,
            doubtful_above_ratio=doubtful_above_ratio,
        )
        held[out] = holds(model.strangers, drives.label_mu, meaning)[out]
    figures: dict[str, float] = {}
    error = np.abs(model.strangers.mu / drives.label_mu - 1.0)
    doubtful = _doubtful(model, model.strangers)
    for part, rows in parts.items():
        found = _figures(error[rows], doubtful=doubtful[rows], held=held[rows])
        figures |= _named(found, part, model)
    return figures


def answer_figures(model: GrownModel, answers: Answers, label_mu: FloatArray, *, part: str) -> dict[str, float]:
    """Return figures of answers to drives that nothing was learned from, named `figure.part.version`.

    Args:
        model: Says what its expected errors mean.
        answers: What is judged. (n,)
        label_mu: The truth. (n,)
        part: What the drives are called, such as "fresh_roads_ideal".
    """
    error = np.abs(answers.mu / label_mu - 1.0)
    held = holds(answers, label_mu, model.conformal)
    return _named(_figures(error, doubtful=_doubtful(model, answers), held=held), part, model)


def fresh_figures(model: GrownModel, runs: Runs, *, part: str) -> dict[str, float]:
    """Return figures of a finished model on drives it never saw, all of which have a summary.

    Args:
        model: The model.
        runs: The drives.
        part: What they are called, such as "fresh_roads_ideal".
    """
    return answer_figures(model, model.answers(runs), runs.labels["label_mu"], part=part)


def strange_figures(
    ordinary: OrdinaryDriving, runs: Runs, parts: Mapping[str, BoolArray], *, among: BoolArray
) -> dict[str, float]:
    """Return which shares of drives are called strange, named `strange_frac.part`.

    Args:
        ordinary: What is ordinary.
        runs: The drives, all of which have a summary.
        parts: Which belong to each part. Each (n,)
        among: Which are judged at all: those that the envelope had not seen. (n,)
    """
    names, values = runs.table.names, runs.features
    strange = is_strange_road(values, ordinary, names) | is_strange_driving(values, ordinary, names)
    return {
        f"strange_frac.{part}": float(strange[rows & among].mean())
        for part, rows in parts.items()
        if (rows & among).any()
    }


def parts_of(runs: Runs, *, known: BoolArray) -> dict[str, BoolArray]:
    """Return which drives belong to which part that is judged for itself. Each (n,)

    Args:
        runs: The drives.
        known: Which were driven on known roads. (n,)
    """
    sections = np.array(runs.section_id)
    any_speed, two_frictions, exact = (
        np.char.endswith(np.array(runs.scenario), suffix)
        for suffix in (ANY_SPEED_SUFFIX, TWO_FRICTIONS_SUFFIX, EXACT_SUFFIX)
    )
    unseen: BoolArray = ~known & ~exact
    label_mu, used = runs.labels["label_mu"], runs.labels["peak_utilisation_ratio"]
    parts: dict[str, BoolArray] = {"known_roads": known}
    parts |= {f"known_roads.{name}": sections == name for name in PAPER_ROADS}
    parts |= {
        "unseen_roads": unseen,
        "unseen_roads.usual_drivers": unseen & ~any_speed & ~two_frictions,
        "unseen_roads.any_speed": unseen & any_speed,
        "unseen_roads.two_frictions": unseen & two_frictions,
        "unseen_roads.high_use": unseen & (used >= HIGH_UTILISATION_RATIO),
        "unseen_roads.low_use": unseen & (used < HIGH_UTILISATION_RATIO),
        "unseen_roads.little_use": unseen & (used < LITTLE_USE_RATIO),
    }
    for low, high in FRICTION_BANDS_MU:
        parts[f"unseen_roads.{band_key(low, high)}"] = unseen & (label_mu >= low) & (label_mu < high)
    return parts | {"exact_sensors": ~known & exact}


def own_parts_of(drives: LearnedDrives) -> dict[str, BoolArray]:
    """Return which drives are of one's own roads, all of them and road by road; nothing without any. Each (n,)"""
    if drives.own is None or not drives.own.any():
        return {}
    sections = np.array(drives.runs.section_id)
    roads = sorted(set(sections[drives.own].tolist()))
    return {OWN_ROADS: drives.own} | {f"{OWN_ROADS}.{name}": drives.own & (sections == name) for name in roads}


def band_key(low_mu: float, high_mu: float) -> str:
    """Return the name of a band of friction in the figures' names, in hundredths: a point parts their words."""
    return f"friction_{100 * low_mu:.0f}_{100 * high_mu:.0f}"


def holds(answers: Answers, label_mu: FloatArray, meaning: Conformal) -> BoolArray:
    """Return where what is said holds: intervals hold the truth, bounds of doubtful estimates lie below it. (n,)"""
    scores = stated_nonconformity_ratio(
        label_mu,
        np.maximum(answers.mu, LEAST_MU),
        answers.expected_error_ratio,
        doubtful_above_ratio=meaning.doubtful_above_ratio,
    )
    return np.asarray(scores <= meaning.quantile, dtype=np.bool_)


def _doubtful(model: GrownModel, answers: Answers) -> BoolArray:
    return np.asarray(answers.expected_error_ratio > model.conformal.doubtful_above_ratio, dtype=np.bool_)


def _figures(error_ratio: FloatArray, *, doubtful: BoolArray, held: BoolArray) -> dict[str, float]:
    if len(error_ratio) == 0:
        return {}
    found = {
        "rows_count": float(len(error_ratio)),
        "mape_ratio": float(error_ratio.mean()),
        "at_least_frac": float(doubtful.mean()),
        "coverage_frac": float(held.mean()),
    }
    if not doubtful.all():
        found["mape_ratio_not_doubtful"] = float(error_ratio[~doubtful].mean())
    return found


def _named(figures: Mapping[str, float], part: str, model: GrownModel) -> dict[str, float]:
    return {f"{figure}.{part}.{model.plan.version}": value for figure, value in figures.items()}

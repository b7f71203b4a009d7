"""A road authority's own roads: judged as if nothing had been learned of them, and perhaps given a model of their own.

Passages of a road whose friction was measured are near each other in time, and share what was measured. Who learned
from one knows the next too well. So such a road is also judged by models that never saw it: that is what the model was
worth there before the measurement, and what it is worth on the authority's next road.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from roadgrip.units import BoolArray
from training.dataset import DatasetError
from training.error_model import grow_error_trees, log_error_ratio
from training.regressor import RowIndices, estimate_mu, grow_trees
from training.study.folds import side_by_side
from training.table_figures import FRICTION_BANDS_MU, band_key, stranger_figures
from training.table_models import Answers, GrownModel, LearnedDrives, drive_folds, grown_model, steps_count

FEWEST_LOCAL_DRIVES = 200
"""Fewer drives than this do not make a model of a road better than the one of all roads."""
MOST_HANDS_COUNT = 4
"""So many times at most everything is grown again to judge own roads; more roads share a hand."""


@dataclass(frozen=True, slots=True)
class LocalModel:
    """A model for a single section.

    Attributes:
        section_id: The section.
        drives: Those on it.
        model: What was grown on them.
    """

    section_id: str
    drives: LearnedDrives
    model: GrownModel

    def figures(self) -> dict[str, float]:
        """Return its figures by strangers' estimates of its drives, named `figure.local.section.version`."""
        label_mu, part = self.drives.label_mu, f"local.{self.section_id}"
        bands = {
            f"{part}.{band_key(low, high)}": (label_mu >= low) & (label_mu < high) for low, high in FRICTION_BANDS_MU
        }
        parts = {part: np.ones(len(label_mu), dtype=np.bool_), **bands}
        limit_ratio = self.model.conformal.doubtful_above_ratio
        return stranger_figures(self.model, self.drives, parts, doubtful_above_ratio=limit_ratio)


def hands_of(drives: LearnedDrives) -> list[BoolArray]:
    """Return which drives are left out together to judge own roads: all on such a road, whoever drove. Each (n,)"""
    if drives.own is None:
        return []
    sections = np.array(drives.runs.section_id)
    roads = sorted(set(sections[drives.own].tolist()))
    hands_count = min(len(roads), MOST_HANDS_COUNT)
    return [np.isin(sections, roads[hand::hands_count]) for hand in range(hands_count)]


def judged_as_unseen(
    drives: LearnedDrives, model: GrownModel, *, on_step: Callable[[int], None] | None = None
) -> Answers:
    """Return what models that learned nothing of own roads say of them; NaN of all other drives. (n,)

    Args:
        drives: What the model learned from.
        model: How the others are grown, but for their drives.
        on_step: Called with the number of hands (`hands_of`) that are done.
    """
    features, label_mu = drives.runs.columns(model.plan.features), drives.label_mu
    miss = log_error_ratio(model.strangers.mu, label_mu)
    mu, expected = np.full(len(features), np.nan), np.full(len(features), np.nan)

    def judge(out: BoolArray) -> None:
        weight = None if drives.weight_ratio is None else drives.weight_ratio[~out]
        friction = grow_trees(
            features[~out], label_mu[~out], model.plan.parameters, weight_ratio=weight, threads_count=1
        )
        error = grow_error_trees(features[~out], miss[~out], threads_count=1)
        mu[out] = estimate_mu(friction, features[out], threads_count=1)
        expected[out] = estimate_mu(error, features[out], threads_count=1)

    side_by_side([partial(judge, out) for out in hands_of(drives)], on_done=on_step)
    return Answers(mu, expected)


def local_drives(drives: LearnedDrives, section_id: str, *, seed: int) -> LearnedDrives:
    """Return the drives on a section, dealt to folds one by one.

    Args:
        drives: Those on all roads.
        section_id: The section.
        seed: Deals folds.

    Raises:
        DatasetError: There are too few.
    """
    rows: RowIndices = np.flatnonzero(np.array(drives.runs.section_id) == section_id)
    if len(rows) < FEWEST_LOCAL_DRIVES:
        found = f"{len(rows)} drives on {section_id}"
        raise DatasetError(f"{found} make no model of its own; at least {FEWEST_LOCAL_DRIVES} are needed")
    runs = drives.runs.rows(rows)
    return replace(
        drives,
        runs=runs,
        fold=drive_folds(runs.run_key, seed=seed),
        own=np.ones(len(rows), dtype=np.bool_),
        weight_ratio=None if drives.weight_ratio is None else drives.weight_ratio[rows],
        marks={},
    )


def local_models(
    drives: LearnedDrives,
    section_id: str,
    worlds: Sequence[GrownModel],
    *,
    on_step: Callable[[int], None] | None = None,
) -> list[LocalModel]:
    """Return the models for a section, one per feature table.

    From where on an estimate is doubtful is taken from the global model: whoever measured the friction of a road does
    not know how much of it each car used.

    Args:
        drives: Those on the section, from `local_drives`.
        section_id: The section.
        worlds: The global models: each says how the section's is grown.
        on_step: Called with the number of steps that are done, of `steps_count()` for each table.
    """
    report = on_step or (lambda _: None)

    def grown(i: int, world: GrownModel) -> GrownModel:
        return grown_model(
            drives,
            world.plan,
            doubtful_above_ratio=world.conformal.doubtful_above_ratio,
            on_step=lambda done: report(i * steps_count() + done),
        )

    return [LocalModel(section_id, drives, grown(i, world)) for i, world in enumerate(worlds)]

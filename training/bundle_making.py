"""From drives to a bundle: models grown, judged by strangers, and written; for the packaged bundle and for every other.

What is made depends on the drives and the plans alone, not on who shows its progress.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from roadgrip.bundle import BundleManifest, OrdinaryDriving
from training.bundling import TableModel, write_models
from training.dataset import Runs
from training.retraining.own_roads import LocalModel, hands_of, judged_as_unseen, local_drives, local_models
from training.table_figures import (
    OWN_ROADS,
    answer_figures,
    figures_of,
    fresh_figures,
    own_parts_of,
    parts_of,
    strange_figures,
)
from training.table_models import (
    Answers,
    GrownModel,
    LearnedDrives,
    TablePlan,
    grown_model,
    ordinary_driving,
    steps_count,
)

AS_UNSEEN = "own_roads_as_unseen"
"""The part of the drives on own roads, judged by models that learned nothing of these roads."""


class Show(Protocol):
    """Shows what is being done: called when it begins, it returns what is told the number of steps that are done."""

    def __call__(self, title: str, steps_count: int) -> Callable[[int], None]:
        """Begin to show something of so many steps."""
        ...


@dataclass(frozen=True, slots=True)
class MadeBundle:
    """A bundle with what it was made of.

    Attributes:
        manifest: As written.
        learned: The drives that were learned from.
        models: The global models, in the order of the bundle.
        local: Those for single sections.
        as_unseen: What the first global model says of own roads when it learned nothing of them; NaN elsewhere. (n,)
    """

    manifest: BundleManifest
    learned: LearnedDrives
    models: tuple[GrownModel, ...]
    local: tuple[LocalModel, ...]
    as_unseen: Answers


def made_bundle(
    learned: LearnedDrives,
    plans: Sequence[TablePlan],
    out: Path,
    *,
    name: str,
    fresh: Mapping[str, Runs],
    unseen: Runs,
    provenance: Mapping[str, str],
    show: Show,
    local_sections: Sequence[str] = (),
    with_references: bool = False,
) -> MadeBundle:
    """Return the bundle that was grown, judged and written.

    Args:
        learned: What to learn from.
        plans: One per feature table, the newest first.
        out: Folder of the bundle.
        name: Of the bundle.
        fresh: Drives with a summary that only judge, by the name of their part in the figures.
        unseen: Drives with a summary that nothing is learned from; golden vectors come from them.
        provenance: How it comes about; how the trees are grown is added.
        show: Shows progress.
        local_sections: Sections that get a model of their own beside the global one.
        with_references: Whether the bundle tells how its training was distributed, over all roads and on known ones.

    Raises:
        DatasetError: A section has too few drives for a model of its own.
        BundleError: An export does not answer as its trees do.
    """
    seed = plans[0].parameters.seed
    on_sections = {section: local_drives(learned, section, seed=seed) for section in local_sections}
    models = [_grown(learned, plan, show) for plan in plans]
    local = [
        model
        for section, drives in on_sections.items()
        for model in local_models(
            drives,
            section,
            models,
            on_step=show(f"growing trees for {section} on {len(drives.runs)} drives", len(models) * steps_count()),
        )
    ]
    strangers = [_as_unseen(learned, model, show) for model in models]
    judging, ordinary = _ordinary(learned, plans, seed, show)
    done = show("judging and exporting", 1)
    watched_roads = sorted(set(np.array(learned.runs.section_id)[learned.known].tolist())) if with_references else None
    metrics = _judged(learned, models, judging=judging, ordinary=ordinary[0], fresh=fresh)
    for model, answers in zip(models, strangers, strict=True):
        metrics |= _own_figures(learned, model, answers)
    for each in local:
        metrics |= each.figures()
    manifest = write_models(
        [
            *(
                model.for_bundle(learned.runs, unseen=unseen, ordinary=known, watched_roads=watched_roads)
                for model, known in zip(models, ordinary, strict=True)
            ),
            *(_local_model(each, unseen, models, ordinary, with_references=with_references) for each in local),
        ],
        out,
        name=name,
        metrics=metrics,
        provenance={**provenance, **{f"fit.{plan.version}": str(plan.parameters) for plan in plans}},
        rng=np.random.default_rng(seed),
    )
    done(1)
    return MadeBundle(manifest, learned, tuple(models), tuple(local), strangers[0])


def failed_words(driven: Runs) -> str:
    """Return how many drives taught nothing, and why, in words."""
    failed = sorted(set(driven.outcome) - {"completed"})
    counts = ", ".join(f"{driven.outcome.count(name)} {name.replace('_', ' ')}" for name in failed)
    return f"{int((~driven.usable).sum())} drives, from which nothing is learned" + (f": {counts}" if counts else "")


def _grown(learned: LearnedDrives, plan: TablePlan, show: Show) -> GrownModel:
    title = f"growing trees of {len(plan.features)} features on {len(learned.runs)} drives, {plan.version}"
    return grown_model(learned, plan, on_step=show(title, steps_count()))


def _as_unseen(learned: LearnedDrives, model: GrownModel, show: Show) -> Answers:
    hands_count = len(hands_of(learned))
    told = show(f"judging own roads as if never seen, {model.plan.version}", hands_count) if hands_count else None
    return judged_as_unseen(learned, model, on_step=told)


def _ordinary(
    learned: LearnedDrives, plans: Sequence[TablePlan], seed: int, show: Show
) -> tuple[OrdinaryDriving, list[OrdinaryDriving]]:
    """Return what is ordinary by all drives but those of a fold, which it judges, and by all of them for each table."""
    done = show("learning what is ordinary", 1 + len(plans))
    judging = ordinary_driving(learned, table=plans[0].table, seed=seed, without_fold=0)
    done(1)
    ordinary = []
    for i, plan in enumerate(plans):
        ordinary.append(ordinary_driving(learned, table=plan.table, seed=seed))
        done(2 + i)
    return judging, ordinary


def _judged(
    learned: LearnedDrives,
    models: Sequence[GrownModel],
    *,
    judging: OrdinaryDriving,
    ordinary: OrdinaryDriving,
    fresh: Mapping[str, Runs],
) -> dict[str, float]:
    parts = parts_of(learned.runs, known=learned.known) | own_parts_of(learned)
    metrics = strange_figures(judging, learned.runs, parts, among=learned.fold == 0)
    for part, some in fresh.items():
        everything = np.ones(len(some), dtype=np.bool_)
        metrics |= strange_figures(ordinary, some, {part: everything}, among=everything)
        for model in models:
            metrics |= fresh_figures(model, some, part=part)
    for model in models:
        metrics |= figures_of(model, learned)
    return metrics


def _own_figures(learned: LearnedDrives, model: GrownModel, answers: Answers) -> dict[str, float]:
    figures: dict[str, float] = {}
    for part, rows in own_parts_of(learned).items():
        there = Answers(answers.mu[rows], answers.expected_error_ratio[rows])
        title = AS_UNSEEN + part.removeprefix(OWN_ROADS)
        figures |= answer_figures(model, there, learned.label_mu[rows], part=title)
    return figures


def _local_model(
    local: LocalModel,
    unseen: Runs,
    models: Sequence[GrownModel],
    ordinary: Sequence[OrdinaryDriving],
    *,
    with_references: bool,
) -> TableModel:
    """Return what a bundle holds of a section's model; which driving is ordinary, the global model says there, too."""
    (known,) = (
        each for world, each in zip(models, ordinary, strict=True) if world.plan.table == local.model.plan.table
    )
    kept = local.model.for_bundle(
        local.drives.runs,
        unseen=unseen,
        ordinary=known,
        watched_roads=(local.section_id,) if with_references else None,
    )
    return replace(kept, section_id=local.section_id)

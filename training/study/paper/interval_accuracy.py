"""How near the published interval comes to the truth, by the number of vehicles it rests on."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from training.study.batches import (
    BATCH_SIZES_COUNT,
    CellErrors,
    cells_of,
    errors_by_cell,
    mean_over_cells_ratio,
    published_rule,
    worst_cell,
)
from training.study.chapter import Cell as TableCell
from training.study.chapter import Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import per_cent
from training.study.feature_selection import selected_features
from training.study.folds import PAPER_SET, paper_estimates
from training.study.picture import Axis, Line, Lines
from training.study.recipes import PAPER_FIT, SPEED_ONLY_RECIPE
from training.study.wording import by_grade, leading_grade, per_cent_words
from vehicle_client.simulator.plan import SensorGrade

ALL, SELECTED, SPEED, FLOOR = "78 features", "15 selected", "speed only", "perfect estimates"
TOLD_SIZE_COUNT = 50
"""The batch the paper recommends."""
BATCHES_COUNT = 400
QUICK_BATCHES_COUNT = 60
PAPER_WORST_FRAC = 0.10
ABOUT_RATIO = 1.2
"""A fifth more is still "about"."""

ErrorsBySize = Mapping[int, tuple[CellErrors, ...]]


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return the interval's errors with one grade of sensors."""
    runs = bench.runs(PAPER_SET, grade)
    estimates = {
        ALL: paper_estimates(bench, grade),
        SELECTED: paper_estimates(bench, grade, features=selected_features(bench, grade)),
        SPEED: paper_estimates(bench, grade, features=SPEED_ONLY_RECIPE.features, recipe=SPEED_ONLY_RECIPE),
        FLOOR: runs.labels["label_mu"],
    }
    usable = np.flatnonzero(runs.usable & np.isfinite(estimates[ALL]))
    # A batch drives under one friction profile: the road with two frictions is a road of its own here.
    cells = cells_of(runs.scenario, runs.labels["base_friction_mu"], rows=usable)
    batches_count = QUICK_BATCHES_COUNT if bench.quick else BATCHES_COUNT
    found: dict[str, ErrorsBySize] = {}
    for done, (name, estimate_mu) in enumerate(estimates.items()):
        rule = published_rule(estimate_mu)
        found[name] = {
            size: errors_by_cell(cells, rule, size_count=size, batches_count=batches_count, seed=bench.seed)
            for size in BATCH_SIZES_COUNT
        }
        bench.report(f"batches of vehicles, {grade}", done + 1, len(estimates))
    return Result(
        figures=_figures(found),
        sizes={
            "runs": len(usable),
            "cells of road and friction": len(cells),
            "fewest runs of a cell": min(len(cell.rows) for cell in cells),
            "batches per cell and size": batches_count,
            "trees": PAPER_FIT.trees_count,
            "seed": bench.seed,
        },
        tables=(_size_table(found), _friction_table(found[ALL], found[FLOOR]), _road_table(found)),
        pictures=(
            _size_picture(found, f"Error of the interval by number of vehicles, {grade} sensors"),
            _friction_picture(found, f"Error of the interval of 50 vehicles by base friction, {grade} sensors"),
            _paper_picture(found[ALL], f"Error of the interval by base friction and batch, {grade} sensors"),
        ),
    )


def worst_by_friction(errors: tuple[CellErrors, ...]) -> dict[float, CellErrors]:
    """Return the worst road at every base friction, the frictions in order."""
    frictions = sorted({one.base_friction_mu for one in errors})
    return {mu: worst_cell(one for one in errors if one.base_friction_mu == mu) for mu in frictions}


def _figures(found: Mapping[str, ErrorsBySize]) -> dict[str, float]:
    figures: dict[str, float] = {}
    for name, by_size in found.items():
        for size, errors in by_size.items():
            where = f"{name}.{size}"
            figures[f"mean.{where}"] = mean_over_cells_ratio(errors)
            figures[f"worst_p95.{where}"] = worst_cell(errors).p95_ratio
            figures[f"best_friction_worst_p95.{where}"] = min(c.p95_ratio for c in worst_by_friction(errors).values())
            figures[f"worst.{where}"] = max(one.worst_ratio for one in errors)
            figures[f"worst_friction.{where}"] = worst_cell(errors).base_friction_mu
    figures["headline.paper_config.interval50_worst_known"] = figures[f"worst_p95.{ALL}.{TOLD_SIZE_COUNT}"]
    figures["headline.speed_only.interval50_worst_known"] = figures[f"worst_p95.{SPEED}.{TOLD_SIZE_COUNT}"]
    return figures


def _size_table(found: Mapping[str, ErrorsBySize]) -> Table:
    rows: list[tuple[TableCell, ...]] = []
    for name, by_size in found.items():
        for size, errors in by_size.items():
            worst = worst_cell(errors)
            rows.append(
                (
                    name,
                    size,
                    per_cent(mean_over_cells_ratio(errors)),
                    per_cent(float(np.mean([one.p95_ratio for one in errors]))),
                    per_cent(worst.p95_ratio),
                    f"{worst.road}, {worst.base_friction_mu:.2f}",
                    per_cent(max(one.worst_ratio for one in errors)),
                )
            )
    return Table(
        "Error of the interval's middle against 0.9 of the base friction, in %",
        ("estimates", "vehicles", "mean", "95 % of batches", "the same, worst cell", "which", "worst batch of all"),
        tuple(rows),
        note="Estimates by regressors that had not seen the run. A cell is one road at one base friction.",
    )


def _friction_table(by_size: ErrorsBySize, floor: ErrorsBySize) -> Table:
    worst = {size: worst_by_friction(errors) for size, errors in by_size.items()}
    perfect = worst_by_friction(floor[TOLD_SIZE_COUNT])
    rows: list[tuple[TableCell, ...]] = [
        (
            mu,
            *(per_cent(worst[size][mu].p95_ratio) for size in BATCH_SIZES_COUNT),
            per_cent(worst[TOLD_SIZE_COUNT][mu].worst_ratio),
            worst[TOLD_SIZE_COUNT][mu].road,
            per_cent(perfect[mu].p95_ratio),
        )
        for mu in perfect
    ]
    return Table(
        "95th percentile of the error on the worst road, by base friction, in %",
        (
            "base friction",
            *(f"{size} vehicles" for size in BATCH_SIZES_COUNT),
            "50: worst batch",
            "50: worst road",
            "50, perfect estimates",
        ),
        tuple(rows),
    )


def _road_table(found: Mapping[str, ErrorsBySize]) -> Table:
    errors = found[ALL][TOLD_SIZE_COUNT]
    rows: list[tuple[TableCell, ...]] = []
    for road in sorted({one.road for one in errors}):
        here = [one for one in errors if one.road == road]
        floor = [one for one in found[FLOOR][TOLD_SIZE_COUNT] if one.road == road]
        rows.append(
            (
                road,
                per_cent(mean_over_cells_ratio(here)),
                per_cent(worst_cell(here).p95_ratio),
                per_cent(max((one.bias_ratio for one in here), key=abs)),
                per_cent(worst_cell(floor).p95_ratio),
            )
        )
    return Table(
        "50 vehicles by road, in %",
        ("road", "mean", "95 % of batches, worst friction", "largest bias", "95 %, perfect estimates"),
        tuple(rows),
        note="A bias is what no number of vehicles averages out.",
    )


def _size_picture(found: Mapping[str, ErrorsBySize], title: str) -> Lines:
    sizes = tuple(float(size) for size in BATCH_SIZES_COUNT)
    lines = tuple(
        Line(
            name,
            sizes,
            tuple(per_cent(worst_cell(by_size[size]).p95_ratio) for size in BATCH_SIZES_COUNT),
            dashed=name == FLOOR,
        )
        for name, by_size in found.items()
    )
    return Lines(
        title,
        Axis("vehicles in the batch", logarithmic=True),
        Axis("95th percentile of the error, worst cell, in %", low=0.0),
        lines,
    )


def _friction_picture(found: Mapping[str, ErrorsBySize], title: str) -> Lines:
    lines = []
    for name, by_size in found.items():
        worst = worst_by_friction(by_size[TOLD_SIZE_COUNT])
        lines.append(
            Line(name, tuple(worst), tuple(per_cent(one.p95_ratio) for one in worst.values()), dashed=name == FLOOR)
        )
    return Lines(
        title, Axis("base friction"), Axis("95th percentile of the error, worst road, in %", low=0.0), tuple(lines)
    )


def _paper_picture(by_size: ErrorsBySize, title: str) -> Lines:
    lines = []
    for size, errors in by_size.items():
        worst = worst_by_friction(errors)
        lines.append(Line(f"{size} vehicles", tuple(worst), tuple(per_cent(one.worst_ratio) for one in worst.values())))
    return Lines(title, Axis("base friction"), Axis("error of the worst batch in %", low=0.0), tuple(lines))


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return what became of the paper's claim of about 10 % with 50 vehicles."""
    grade = leading_grade(results)
    figures = results[grade].figures
    worst = figures[f"worst.{ALL}.{TOLD_SIZE_COUNT}"]
    p95 = figures[f"worst_p95.{ALL}.{TOLD_SIZE_COUNT}"]
    shrinks = all(
        figures[f"mean.{ALL}.{large}"] < figures[f"mean.{ALL}.{small}"] for small, large in pairwise(BATCH_SIZES_COUNT)
    )
    limit = ABOUT_RATIO * PAPER_WORST_FRAC
    claim = (
        Claim.CONFIRMED
        if worst <= limit and shrinks
        else Claim.PARTLY
        if p95 <= limit and shrinks
        else Claim.NOT_CONFIRMED
    )
    held = {
        Claim.CONFIRMED: "no batch of 50 was much worse than the paper's 10 %",
        Claim.PARTLY: "95 of 100 batches of 50 keep to about 10 % on every road and friction, single ones do not",
    }.get(claim, "batches of 50 do not keep to about 10 % everywhere")
    text = (
        f"The paper: about 10 % in the worst case with 50 vehicles, at base friction 0.35, and 10 vehicles hardly "
        f"tolerable. Here {held}. Of 50 vehicles the 95th percentile in the worst cell is "
        f"{by_grade(results, f'worst_p95.{ALL}.{TOLD_SIZE_COUNT}')}, the worst batch of all "
        f"{by_grade(results, f'worst.{ALL}.{TOLD_SIZE_COUNT}')}, the mean "
        f"{by_grade(results, f'mean.{ALL}.{TOLD_SIZE_COUNT}')}; the worst cell lies at base friction "
        f"{figures[f'worst_friction.{ALL}.{TOLD_SIZE_COUNT}']:.2f}. With 10 vehicles the worst cell has "
        f"{by_grade(results, f'worst_p95.{ALL}.10')}. Perfect estimates of 50 vehicles would leave "
        f"{per_cent_words(figures[f'worst_p95.{FLOOR}.{TOLD_SIZE_COUNT}'])}: that much is chance in who passes. "
        f"The {'mean error falls with every step in size' if shrinks else 'error does not always fall with size'}, and "
        f"the speed alone gives {by_grade(results, f'worst_p95.{SPEED}.{TOLD_SIZE_COUNT}')}."
    )
    return Verdict(claim, text)


CHAPTER = Chapter(
    name="interval_accuracy",
    title="Accuracy of the unit's interval by number of vehicles",
    paper_says=(
        "The median of a batch nears the true middle of the interval as the batch grows. Ten vehicles give a worst "
        "error that is barely tolerable; with at least fifty it lies between 6 and 10 % over the base frictions, the "
        "worst being about 10 % at 0.35. The paper recommends to publish only from fifty vehicles on."
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET,),
)

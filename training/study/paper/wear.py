"""What becomes of the interval where tyres are not worn as the paper assumes: evenly, from new to badly worn.

No new drives: held-out runs are drawn anew inside every cell, each as often as the supposed wear has tyres like its.
Pressure is a factor on what a vehicle finds, hence on its estimate, which is taken to be as wrong in parts as before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from roadgrip.units import FloatArray
from training.chance import chance
from training.regressor import RowIndices
from training.study.batches import (
    Cell,
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
from training.study.folds import PAPER_SET, paper_estimates
from training.study.picture import Axis, Bars
from training.study.wording import by_grade, leading_grade
from vehicle_client.simulator.plan import WEAR_RANGE, SensorGrade

SIZE_COUNT = 50
BATCHES_COUNT = 300
QUICK_BATCHES_COUNT = 60
DRAWN_ROWS_COUNT = 4000
"""Rows that stand for the traffic of a cell under a supposed wear."""
EDGE_FRAC = 0.1
"""Share of the range of wear that "new" and "worn out" mean."""
PRESSURE_RATIO = 0.08
"""By so much a pressure of half a bar less raises friction (the paper, after Braghin et al., 2006)."""
HARDLY_RATIO = 0.02
"""An error that grows by two hundredths of the truth is hardly more."""

EVEN, NEW, WORN = "even (the paper)", "all new", "all badly worn"
MOSTLY_NEW, MOSTLY_WORN, BIMODAL = "mostly new", "mostly worn", "half new, half badly worn"
SOFT, HARD, EACH = "even, all 8 % softer", "even, all 8 % harder", "even, each within 8 %"
ESTIMATES, FLOOR = "78 features", "perfect estimates"


@dataclass(frozen=True, slots=True)
class Supposed:
    """A supposed state of the tyres that pass.

    Attributes:
        density: How frequent tyres are, relative, by where they lie from badly worn (0) to new (1).
        common_ratio: Factor of pressure on the friction that all of them find.
        each_ratio: Half the width of a factor that every vehicle has for itself.
    """

    density: Callable[[FloatArray], FloatArray]
    common_ratio: float = 1.0
    each_ratio: float = 0.0


def _even(place: FloatArray) -> FloatArray:
    return np.ones_like(place)


SUPPOSED: Mapping[str, Supposed] = {
    EVEN: Supposed(_even),
    NEW: Supposed(lambda place: (place >= 1.0 - EDGE_FRAC).astype(np.float64)),
    MOSTLY_NEW: Supposed(lambda place: place),
    MOSTLY_WORN: Supposed(lambda place: 1.0 - place),
    WORN: Supposed(lambda place: (place <= EDGE_FRAC).astype(np.float64)),
    BIMODAL: Supposed(lambda place: (np.minimum(place, 1.0 - place) <= EDGE_FRAC).astype(np.float64)),
    SOFT: Supposed(_even, common_ratio=1.0 + PRESSURE_RATIO),
    HARD: Supposed(_even, common_ratio=1.0 - PRESSURE_RATIO),
    EACH: Supposed(_even, each_ratio=PRESSURE_RATIO),
}
WEAR_ONLY = (NEW, MOSTLY_NEW, MOSTLY_WORN, WORN, BIMODAL)


def redrawn_rows(
    rng: np.random.Generator, rows: RowIndices, wear_ratio: FloatArray, supposed: Supposed, *, count: int
) -> RowIndices:
    """Return rows drawn with replacement, as frequent as tyres of their wear are supposed to be.

    The rows' own wear is taken to be even over its range, as the designs draw it. Empty where no row has such tyres.

    Args:
        rng: Source of chance.
        rows: To draw from. (n,)
        wear_ratio: Wear of every row of the table.
        supposed: The tyres.
        count: Rows to draw.
    """
    low, high = WEAR_RANGE
    weight = supposed.density(np.clip((wear_ratio[rows] - low) / (high - low), 0.0, 1.0))
    total = float(weight.sum())
    if total <= 0.0:
        return np.empty(0, dtype=np.intp)
    return rng.choice(rows, count, p=weight / total)


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return the interval's errors under all supposed states of tyres with one grade of sensors."""
    runs = bench.runs(PAPER_SET, grade)
    estimate_mu = paper_estimates(bench, grade)
    usable = np.flatnonzero(runs.usable & np.isfinite(estimate_mu))
    cells = cells_of(runs.scenario, runs.labels["base_friction_mu"], rows=usable)
    batches_count = QUICK_BATCHES_COUNT if bench.quick else BATCHES_COUNT
    kinds = {ESTIMATES: estimate_mu, FLOOR: runs.labels["label_mu"]}
    found: dict[str, dict[str, tuple[CellErrors, ...]]] = {}
    empty_count = 0
    for done, (name, supposed) in enumerate(SUPPOSED.items()):
        drawn = _redrawn_cells(cells, runs.labels["wear_ratio"], supposed, seed=bench.seed)
        empty_count += len(cells) - len(drawn)
        factor = supposed.common_ratio * chance(bench.seed, f"pressure|{name}").uniform(
            1.0 - supposed.each_ratio, 1.0 + supposed.each_ratio, len(runs)
        )
        found[name] = {
            kind: errors_by_cell(
                drawn,
                published_rule(factor * mu),
                size_count=SIZE_COUNT,
                batches_count=batches_count,
                seed=bench.seed,
            )
            for kind, mu in kinds.items()
        }
        bench.report(f"supposed wear, {grade}", done + 1, len(SUPPOSED))
    what = f"{SIZE_COUNT} vehicles by the tyres that pass, {grade} sensors"
    return Result(
        figures={
            f"{figure}.{kind}.{name}": value
            for name, by_kind in found.items()
            for kind, errors in by_kind.items()
            for figure, value in _in_short(errors).items()
        },
        sizes={
            "runs": len(usable),
            "cells of road and friction": len(cells),
            "cells without any such tyre, over all states": empty_count,
            "vehicles in a batch": SIZE_COUNT,
            "batches per cell": batches_count,
            "seed": bench.seed,
        },
        tables=(_table(found),),
        pictures=(
            _bars(found, "bias", f"Bias of the interval of {what}", Axis("mean signed error in %")),
            _bars(
                found,
                "worst_p95",
                f"Error of the interval of {what}",
                Axis("95th percentile, worst cell, in %", low=0.0),
            ),
        ),
    )


def _bars(found: Mapping[str, Mapping[str, tuple[CellErrors, ...]]], figure: str, title: str, y_axis: Axis) -> Bars:
    return Bars(
        title,
        "tyres",
        y_axis,
        tuple(found),
        tuple(
            (kind, tuple(per_cent(_in_short(by_kind[kind])[figure]) for by_kind in found.values()))
            for kind in (ESTIMATES, FLOOR)
        ),
    )


def _redrawn_cells(
    cells: tuple[Cell, ...], wear_ratio: FloatArray, supposed: Supposed, *, seed: int
) -> tuple[Cell, ...]:
    drawn = []
    for cell in cells:
        rng = chance(seed, f"wear|{cell.road}|{cell.base_friction_mu:.2f}")
        rows = redrawn_rows(rng, cell.rows, wear_ratio, supposed, count=DRAWN_ROWS_COUNT)
        if len(rows):
            drawn.append(replace(cell, rows=rows))
    return tuple(drawn)


def _in_short(errors: tuple[CellErrors, ...]) -> dict[str, float]:
    if not errors:
        return {"bias": np.nan, "mean": np.nan, "worst_p95": np.nan}
    return {
        "bias": float(np.mean([one.bias_ratio for one in errors])),
        "mean": mean_over_cells_ratio(errors),
        "worst_p95": worst_cell(errors).p95_ratio,
    }


def _table(found: Mapping[str, Mapping[str, tuple[CellErrors, ...]]]) -> Table:
    rows: list[tuple[TableCell, ...]] = []
    for name, by_kind in found.items():
        short = [_in_short(by_kind[kind]) for kind in (ESTIMATES, FLOOR)]
        rows.append((name, *(per_cent(one[figure]) for one in short for figure in ("bias", "mean", "worst_p95"))))
    return Table(
        "Error of the interval of 50 vehicles by the tyres that pass, in %",
        ("tyres", "bias", "mean", "95 %, worst cell", "perfect: bias", "perfect: mean", "perfect: 95 %, worst cell"),
        tuple(rows),
        note=(
            "New and badly worn mean the outer tenths of the range from 0.8 to 1; mostly new and mostly worn rise in a "
            "straight line over it. Held-out runs drawn anew by their wear; pressure as a factor on their estimates. "
            "The truth is 0.9 of what a new tyre finds at usual pressure."
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return how much hangs on the assumption that wear is spread symmetrically."""
    figures = results[leading_grade(results)].figures
    usual = figures[f"mean.{ESTIMATES}.{EVEN}"]
    lopsided = [name for name in WEAR_ONLY if figures[f"mean.{ESTIMATES}.{name}"] > usual + HARDLY_RATIO]
    matters = bool(lopsided)
    text = (
        "The paper assumes that wear and pressure spread symmetrically about the middle of the interval and does not "
        f"test what happens otherwise. Here the mean error of 50 vehicles {'grows' if matters else 'hardly grows'} "
        f"without it. Even wear: {by_grade(results, f'mean.{ESTIMATES}.{EVEN}')}. Mean signed error with all tyres "
        f"new: {by_grade(results, f'bias.{ESTIMATES}.{NEW}')}; mostly new: "
        f"{by_grade(results, f'bias.{ESTIMATES}.{MOSTLY_NEW}')}; mostly worn: "
        f"{by_grade(results, f'bias.{ESTIMATES}.{MOSTLY_WORN}')}. Half new and half badly worn is symmetric, yet the "
        f"median then jumps between two crowds: 95th percentile in the worst cell "
        f"{by_grade(results, f'worst_p95.{ESTIMATES}.{BIMODAL}')}, against "
        f"{by_grade(results, f'worst_p95.{ESTIMATES}.{EVEN}')}. All tyres 8 % softer shift the interval by "
        f"{by_grade(results, f'bias.{ESTIMATES}.{SOFT}')}. With all tyres new, "
        f"perfect estimates would be off by {by_grade(results, f'bias.{FLOOR}.{NEW}')}"
    )
    text += (
        ": no better regressor repairs a wrong assumption."
        if abs(figures[f"bias.{FLOOR}.{NEW}"]) > HARDLY_RATIO
        else "."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="wear",
    title="The assumption that wear is symmetric",
    paper_says=(
        "The unit's rule rests on the assumption that the friction of the vehicles that pass is spread symmetrically "
        "about the middle of [0.8, 1] of a new tyre's. Half a bar less pressure raises friction by about 8 %. What an "
        "uneven fleet would do to the interval is not examined."
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET,),
)

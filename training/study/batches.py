"""Batches of vehicles on one road at one base friction, and how far from the truth a rule's answer for them is.

A rule sees the rows of a batch and answers with the midpoint of the friction interval. The truth is 0.9 of the base
friction, the middle of [0.8, 1] of what a new tyre finds; it is no vehicle's label. Every rule is judged on the very
same batches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from roadgrip.units import FloatArray
from rsu_app.domain.interval import MEDIAN_TYRE_RATIO, IntervalPolicy, friction_interval
from training.chance import chance
from training.regressor import RowIndices

BATCH_SIZES_COUNT = (1, 10, 50, 100)
"""Vehicles in a batch, as the paper shows them."""
P95_FRAC = 0.95

RowBatches: TypeAlias = np.ndarray[tuple[int, int], np.dtype[np.intp]]
"""Rows of batches, one batch per line."""
Rule: TypeAlias = Callable[[RowIndices], float]
"""From the rows of one batch to the midpoint of its friction interval; NaN where the rule does not answer."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Vehicles that found the same road.

    Attributes:
        road: Its name; of a road with a friction profile of its own, the scenario's.
        base_friction_mu: What the road offers a new tyre.
        rows: Its rows of the table. (n,)
    """

    road: str
    base_friction_mu: float
    rows: RowIndices

    @property
    def midpoint_mu(self) -> float:
        """The true middle of the interval."""
        return MEDIAN_TYRE_RATIO * self.base_friction_mu


@dataclass(frozen=True, slots=True)
class CellErrors:
    """Errors of a rule over many batches of one size from one cell, relative to the true midpoint.

    The errors are those of the batches that were answered; NaN when none was.

    Attributes:
        road: Of the cell.
        base_friction_mu: Of the cell.
        rows_count: Vehicles the batches were drawn from.
        size_count: Vehicles in a batch.
        batches_count: Batches drawn.
        answered_frac: Share of them that the rule answered.
        bias_ratio: Mean signed error; positive means too much friction.
        mean_ratio: Mean magnitude.
        p95_ratio: 95th percentile of the magnitude.
        worst_ratio: Largest magnitude.
    """

    road: str
    base_friction_mu: float
    rows_count: int
    size_count: int
    batches_count: int
    answered_frac: float
    bias_ratio: float
    mean_ratio: float
    p95_ratio: float
    worst_ratio: float


def cells_of(road: Sequence[str], base_friction_mu: FloatArray, *, rows: RowIndices) -> tuple[Cell, ...]:
    """Return the cells of some rows, by road and base friction; none is empty.

    Args:
        road: Name of the road, or of the scenario, of every row of the table. (n,)
        base_friction_mu: Of every row of the table. (n,)
        rows: Rows that may be drawn.
    """
    names = np.array(road)[rows]
    # In hundredths: frictions that went through a file differ in their last bits.
    hundredths = np.rint(100.0 * base_friction_mu[rows]).astype(np.intp)
    cells = []
    for name, friction in sorted(set(zip(names.tolist(), hundredths.tolist(), strict=True))):
        cells.append(Cell(name, friction / 100.0, rows[(names == name) & (hundredths == friction)]))
    return tuple(cells)


def drawn_batches(rng: np.random.Generator, rows: RowIndices, *, size_count: int, batches_count: int) -> RowBatches:
    """Return batches drawn with replacement: the rows stand for all the traffic that could have come.

    Without replacement the batches of a small cell would be much alike, and their errors look smaller than they are.

    Args:
        rng: Source of chance.
        rows: To draw from, at least one. (n,)
        size_count: Vehicles in a batch.
        batches_count: Batches.

    Returns:
        One batch per line. (batches_count, size_count)
    """
    return rows[rng.integers(len(rows), size=(batches_count, size_count))]


def errors_of_cell(cell: Cell, rule: Rule, *, size_count: int, batches_count: int, seed: int) -> CellErrors:
    """Return how a rule does on a cell; with the same seed every rule sees the same batches.

    Args:
        cell: Where the batches are drawn.
        rule: What answers.
        size_count: Vehicles in a batch.
        batches_count: Batches to draw.
        seed: Of the draws.
    """
    answers_mu = answers_of_cell(cell, rule, size_count=size_count, batches_count=batches_count, seed=seed)
    return errors_of_answers(cell, answers_mu, size_count=size_count)


def answers_of_cell(cell: Cell, rule: Rule, *, size_count: int, batches_count: int, seed: int) -> FloatArray:
    """Return what a rule says of the batches of a cell; arguments as for `errors_of_cell`. (batches_count,)"""
    batches = batches_of_cell(cell, size_count=size_count, batches_count=batches_count, seed=seed)
    return np.array([rule(batch) for batch in batches], dtype=np.float64)


def batches_of_cell(cell: Cell, *, size_count: int, batches_count: int, seed: int) -> RowBatches:
    """Return the batches that every rule is judged on, one per line; arguments as for `errors_of_cell`."""
    rng = chance(seed, f"batches|{cell.road}|{cell.base_friction_mu:.2f}|{size_count}")
    return drawn_batches(rng, cell.rows, size_count=size_count, batches_count=batches_count)


def errors_of_answers(cell: Cell, answers_mu: FloatArray, *, size_count: int) -> CellErrors:
    """Return how far answers for batches of a cell are from the truth.

    Args:
        cell: Where the batches were drawn.
        answers_mu: One midpoint per batch, NaN where there is none; at least one batch. (batches_count,)
        size_count: Vehicles in a batch.
    """
    batches_count = len(answers_mu)
    errors = answers_mu[np.isfinite(answers_mu)] / cell.midpoint_mu - 1.0
    magnitude = np.abs(errors)
    silent = len(errors) == 0
    return CellErrors(
        road=cell.road,
        base_friction_mu=cell.base_friction_mu,
        rows_count=len(cell.rows),
        size_count=size_count,
        batches_count=batches_count,
        answered_frac=len(errors) / batches_count,
        bias_ratio=math.nan if silent else float(errors.mean()),
        mean_ratio=math.nan if silent else float(magnitude.mean()),
        p95_ratio=math.nan if silent else float(np.quantile(magnitude, P95_FRAC)),
        worst_ratio=math.nan if silent else float(magnitude.max()),
    )


def errors_by_cell(
    cells: Iterable[Cell], rule: Rule, *, size_count: int, batches_count: int, seed: int
) -> tuple[CellErrors, ...]:
    """Return how a rule does on each of some cells; arguments as for `errors_of_cell`."""
    return tuple(
        errors_of_cell(cell, rule, size_count=size_count, batches_count=batches_count, seed=seed) for cell in cells
    )


def worst_cell(errors: Iterable[CellErrors]) -> CellErrors:
    """Return the cell with the largest 95th percentile; one where nothing was answered counts as worse than any.

    Args:
        errors: At least one.
    """
    return max(errors, key=lambda one: math.inf if math.isnan(one.p95_ratio) else one.p95_ratio)


def mean_over_cells_ratio(errors: Iterable[CellErrors]) -> float:
    """Return the mean magnitude of the error, over batches and then over cells; at least one, all of them answered."""
    return float(np.mean([one.mean_ratio for one in errors]))


def published_rule(estimate_mu: FloatArray) -> Rule:
    """Return the rule that the unit runs: the middle of the very interval it publishes, which the median places.

    Args:
        estimate_mu: The regressor's answer for every row of the table, or its label for the floor that perfect
            estimates would give. Rows that are never drawn may be NaN. (n,)
    """
    policy = IntervalPolicy()

    def midpoint_mu(rows: RowIndices) -> float:
        interval = friction_interval(np.sort(estimate_mu[rows]).tolist(), newest_age_s=0.0, policy=policy)
        return math.nan if interval is None else (interval.mu_low + interval.mu_new) / 2.0

    return midpoint_mu

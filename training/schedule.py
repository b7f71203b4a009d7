"""In which pieces a design is driven: pure decisions, so that no clock and no worker count shapes the result.

Cells with a quota of kept runs are driven in rounds. The first asks for as many attempts as runs are wanted, each
further one for what the completion rate so far makes likely to be enough. A round is planned when the one before it is
finished, from counts alone: the pieces are the same on any machine. What goes beyond the attempt that gives the last
wanted run is cut off at the end.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from roadgrip.units import BoolArray, FloatArray
from training.scenarios import Design, Quota, Run, Scenario, Terms, run_of

FIRST_SHARD_ATTEMPTS_COUNT = 200
"""Attempts in a shard of the first round: a few seconds of work, so that little is lost to a kill."""
LATER_SHARD_ATTEMPTS_COUNT = 800
"""The same of later rounds, where most drives end early in a ditch."""
_ROUND_MARGIN_RATIO = 1.1
_GROWTH_LIMIT_RATIO = 4.0
"""A round is at most this many times all that went before it: little is known after few attempts."""


class Counts(NamedTuple):
    """How far a cell is.

    Attributes:
        attempts_count: Runs driven.
        kept_count: Runs among them that gave a summary.
    """

    attempts_count: int = 0
    kept_count: int = 0


@dataclass(frozen=True, slots=True)
class Block:
    """Consecutive attempts of one cell.

    Attributes:
        cell_index: Its cell, counted scenario by scenario.
        scenario: Of the cell.
        base_friction_mu: Of the cell.
        first: Number of the first attempt.
        last: One beyond the last.
    """

    cell_index: int
    scenario: Scenario
    base_friction_mu: float
    first: int
    last: int

    @property
    def attempts_count(self) -> int:
        """Number of attempts."""
        return self.last - self.first


@dataclass(frozen=True, slots=True)
class Shard:
    """Runs that are driven and stored together.

    Attributes:
        terms: Of the design.
        blocks: What is driven, in the order of the rows.
    """

    terms: Terms
    blocks: tuple[Block, ...]

    @property
    def attempts_count(self) -> int:
        """Number of runs."""
        return sum(block.attempts_count for block in self.blocks)

    @property
    def name(self) -> str:
        """Name of its file: changes with everything that changes its runs, but for the code that drives them."""
        parts = [str(self.terms)]
        parts += [f"{b.scenario.identity}|{b.base_friction_mu:.3f}|{b.first}|{b.last}" for b in self.blocks]
        digest = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]
        start = self.blocks[0]
        return f"{start.scenario.name}-{start.base_friction_mu:.2f}-{start.first:05d}-{digest}"


def runs_of(block: Block, terms: Terms) -> tuple[Run, ...]:
    """Return the runs of a block."""
    return tuple(
        run_of(terms, block.scenario, base_friction_mu=block.base_friction_mu, number=number)
        for number in range(block.first, block.last)
    )


def streams_of(design: Design) -> tuple[tuple[Block, ...], ...]:
    """Return the cells of a design in groups whose rounds follow each other, as empty blocks.

    A group is one scenario, or several small ones, so that files are not tiny. A scenario that is added at the end
    leaves the groups before it as they are.
    """
    streams: list[tuple[Block, ...]] = []
    cells: list[Block] = []
    attempts_count = 0
    for i, scenario in enumerate(design.scenarios):
        for j, mu in enumerate(design.base_frictions_mu):
            cells.append(Block(i * len(design.base_frictions_mu) + j, scenario, mu, 0, 0))
            attempts_count += further_attempts_count(scenario.quota, Counts())
        if attempts_count >= FIRST_SHARD_ATTEMPTS_COUNT:
            streams.append(tuple(cells))
            cells, attempts_count = [], 0
    return (*streams, tuple(cells)) if cells else tuple(streams)


def next_round(terms: Terms, cells: Sequence[Block], counts: Sequence[Counts]) -> tuple[Shard, ...]:
    """Return what is to be driven next of a group of cells; nothing when all have enough.

    Args:
        terms: Of the design.
        cells: The group.
        counts: How far each of its cells is.
    """
    wanted = [
        Block(cell.cell_index, cell.scenario, cell.base_friction_mu, done.attempts_count, done.attempts_count + more)
        for cell, done in zip(cells, counts, strict=True)
        if (more := further_attempts_count(cell.scenario.quota, done))
    ]
    total = sum(block.attempts_count for block in wanted)
    first = all(done.attempts_count == 0 for done in counts)
    most = FIRST_SHARD_ATTEMPTS_COUNT if first else LATER_SHARD_ATTEMPTS_COUNT
    return tuple(Shard(terms, blocks) for blocks in _packed(wanted, math.ceil(total / max(1, math.ceil(total / most)))))


def further_attempts_count(quota: Quota, done: Counts) -> int:
    """Return how many more attempts a cell needs, as its completion rate so far lets expect; 0 when it has enough."""
    left = quota.attempts_limit_count - done.attempts_count
    if quota.kept_count is None:
        return left
    missing = quota.kept_count - done.kept_count
    if missing <= 0 or left <= 0:
        return 0
    if done.attempts_count == 0:
        return min(left, quota.kept_count)
    rate = (done.kept_count + 1) / (done.attempts_count + 2)
    likely = math.ceil(_ROUND_MARGIN_RATIO * missing / rate)
    return min(left, likely, math.ceil(_GROWTH_LIMIT_RATIO * done.attempts_count))


def inside_quota(kept: BoolArray, kept_count: int | None) -> BoolArray:
    """Return which attempts of one cell belong to the design: all up to the one that gives the last wanted run.

    Args:
        kept: Which attempts gave a summary, in their order. (n,)
        kept_count: How many are wanted; None: all attempts belong to it.
    """
    if kept_count is None:
        return np.ones(len(kept), dtype=np.bool_)
    kept_before_count: FloatArray = np.cumsum(kept, dtype=np.float64) - kept
    return np.asarray(kept_before_count < kept_count)


def _packed(blocks: Sequence[Block], size: int) -> list[tuple[Block, ...]]:
    """Return the blocks cut and gathered into groups of `size` attempts; the last may be smaller."""
    groups: list[tuple[Block, ...]] = []
    group: list[Block] = []
    room = size
    for block in blocks:
        first = block.first
        while first < block.last:
            last = min(block.last, first + room)
            group.append(Block(block.cell_index, block.scenario, block.base_friction_mu, first, last))
            room -= last - first
            first = last
            if room == 0:
                groups.append(tuple(group))
                group, room = [], size
    return [*groups, tuple(group)] if group else groups

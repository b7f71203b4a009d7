"""Summaries made up by somebody who has the model, the simulator and time: in range, ordinary, and false.

He starts from drives that really were possible on this road, at any friction, and changes them a little at a time, as
long as the unit would count them (differential evolution). What he looks for is a friction to claim and, among all
summaries that claim it, those that pass for the surest; or those that say "at least" as much as can be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.lying.judged import Door, Judged, distinct, joined
from roadgrip.features import FeatureTable
from roadgrip.units import FloatArray

LIARS_COUNT = 15
POPULATION_COUNT = 2 * LIARS_COUNT
ROUNDS_COUNT = 25
_ASCENDING = ("min", "q20", "q40", "median", "q60", "q80", "max")
_OFF_TARGET_WEIGHT = 8.0
"""One per cent beside the wanted friction costs as much as eight per cent of expected error."""

Wish = Callable[[Judged], FloatArray]
"""How bad summaries are for what is wanted, smaller is better. (n,)"""


@dataclass(frozen=True, slots=True)
class Crafted:
    """Fifteen different summaries that say about the same.

    Attributes:
        name: What they claim, in words.
        said: What the unit makes of them. (15)
    """

    name: str
    said: Judged


def names(target_mu: float) -> Wish:
    """Return the wish to name a friction and to be sure of it."""

    def cost(said: Judged) -> FloatArray:
        off = _OFF_TARGET_WEIGHT * np.abs(np.log(np.maximum(said.mu, 1e-3) / target_mu))
        return np.where(said.at_least, np.inf, off + said.expected_error_ratio)

    return cost


def bounds_highest(said: Judged) -> FloatArray:
    """Return the wish to say "at least" of as much as can be."""
    return np.where(said.at_least, -said.mu_low, np.inf)


def bounds_lowest(said: Judged) -> FloatArray:
    """Return the wish to say "at least" of as little as can be, with an estimate as low as can be."""
    return np.where(said.at_least, said.mu_low + said.mu, np.inf)


def crafted(door: Door, driven: Judged, wish: Wish, *, name: str, rng: np.random.Generator) -> Crafted | None:
    """Return the summaries that come nearest to a wish, None where none could be had at all.

    Args:
        door: What they must pass.
        driven: What was driven on this road at any friction, as the unit judges it.
        wish: What is wanted.
        name: Of the result.
        rng: Source of chance.
    """
    cost = wish(driven)
    usable = np.flatnonzero(np.isfinite(cost))
    if len(usable) < POPULATION_COUNT:
        return None
    best = driven.rows(usable[np.argsort(cost[usable])[:POPULATION_COUNT]])
    for _ in range(ROUNDS_COUNT):
        counts, children = door.judge(_changed(best.values, driven.values, door.table, rng))
        better = counts & (np.where(counts, wish(children), np.inf) < wish(best))
        if better.any():
            best = joined([best.rows(~better), children.rows(better)])
    best = distinct(best)
    chosen = best.rows(np.argsort(wish(best))[:LIARS_COUNT])
    return None if len(chosen) < LIARS_COUNT else Crafted(name, chosen)


def _changed(parents: FloatArray, pool: FloatArray, table: FeatureTable, rng: np.random.Generator) -> FloatArray:
    """Return parents moved along the difference of two drives, in some of their columns; the laws of order kept."""
    count, width = parents.shape
    one, other = (pool[rng.integers(len(pool), size=count)] for _ in range(2))
    step = rng.choice([0.1, 0.3, 0.6], size=(count, 1))
    columns = rng.random((count, width)) < rng.choice([0.1, 0.4, 1.0], size=(count, 1))
    children = np.where(columns, parents + step * (one - other), parents)
    # A child may also take a value of a better liar: the recombination of the method.
    children = np.where(rng.random((count, width)) < 0.1, parents[rng.permutation(count)], children)
    children = np.clip(children, table.minimum[:width], table.maximum[:width])
    for block in table.statistics_columns:
        order = [column for column in block if any(f"_{word}_" in f"{table.names[column]}_" for word in _ASCENDING)]
        places = sorted(order, key=lambda column: _rank(table.names[column]))
        children[:, places] = np.sort(children[:, places], axis=1)
    return children.astype(np.float32).astype(np.float64)


def _rank(name: str) -> int:
    return next(rank for rank, word in enumerate(_ASCENDING) if f"_{word}_" in f"{name}_")

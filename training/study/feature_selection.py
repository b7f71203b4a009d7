"""Sequential forward selection: from nothing, always the one feature that helps most."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from roadgrip.units import FloatArray
from training.accuracy import mape_ratio
from training.fit_parameters import FitParameters
from training.study.chapter import Workbench
from training.study.folds import fold_numbers, paper_split, side_by_side
from training.study.paper_features import PAPER_FEATURES
from training.study.recipes import PAPER_FIT, Boosted
from vehicle_client.simulator.plan import SensorGrade

Score: TypeAlias = Callable[[tuple[int, ...]], float]
"""How bad a set of columns is; several sets may be asked for at a time."""

SELECTED_COUNT = 15
"""How many features the paper goes on with."""
SEARCH_ROWS_COUNT = 10_000
SEARCH_FOLDS_COUNT = 3
MOST_COUNT = 30
"""How far the paper goes."""
SEARCH_FIT = replace(PAPER_FIT, bins_count=64)
"""The paper's trees from coarser bins: half the time for thousands of fits, and 0.1 points of MAPE."""
QUICK_SEARCH_ROWS_COUNT = 600
QUICK_MOST_COUNT = 15
QUICK_SEARCH_FIT = replace(SEARCH_FIT, trees_count=10, depth_count=3, bins_count=16)


@dataclass(frozen=True, slots=True)
class Selected:
    """Features in the order in which they were chosen.

    Attributes:
        names: The features.
        mape_ratio: The mean over the search's folds of the MAPE with this feature and all before it. (names,)
    """

    names: tuple[str, ...]
    mape_ratio: FloatArray


def forward_selection(
    score: Score, columns_count: int, *, most_count: int, on_step: Callable[[int], None] | None = None
) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return columns in the order in which they are chosen, and how bad the set is with each.

    Of equally good columns the first is taken. Columns that make it worse are taken, too, if no other is better:
    the paper asks for sets of a given size.

    Args:
        score: How bad a set is; it gets the columns in ascending order.
        columns_count: How many there are.
        most_count: How many are chosen, at most all.
        on_step: Called after each choice with the number of those made.
    """
    chosen: list[int] = []
    found: list[float] = []
    for step in range(min(most_count, columns_count)):
        waiting = [column for column in range(columns_count) if column not in chosen]
        scores: dict[int, float] = {}

        def ask(column: int, *, scores: dict[int, float] = scores) -> None:
            scores[column] = score(tuple(sorted((*chosen, column))))

        side_by_side([partial(ask, column) for column in waiting])
        best = min(waiting, key=lambda column: scores[column])
        chosen.append(best)
        found.append(scores[best])
        if on_step is not None:
            on_step(step + 1)
    return tuple(chosen), tuple(found)


def search_settings(*, quick: bool) -> tuple[int, int, FitParameters]:
    """Return how many rows the search learns from, how many features it chooses at most, and how its trees grow."""
    if quick:
        return QUICK_SEARCH_ROWS_COUNT, QUICK_MOST_COUNT, QUICK_SEARCH_FIT
    return SEARCH_ROWS_COUNT, MOST_COUNT, SEARCH_FIT


def selection(
    bench: Workbench, grade: SensorGrade, candidates: Sequence[str] = PAPER_FEATURES, *, most_count: int | None = None
) -> Selected:
    """Return features in the order of a sequential forward selection on the paper's data.

    Three folds on the same 10,000 of the rows to learn from judge every set, by its MAPE.

    Args:
        bench: Where the data comes from.
        grade: Sensors.
        candidates: What there is to choose from.
        most_count: How many are chosen at most; as many as the paper chooses if None.
    """
    rows_count, usual_count, parameters = search_settings(quick=bench.quick)
    wanted_count = usual_count if most_count is None else min(most_count, usual_count)
    names = tuple(candidates)

    def work() -> dict[str, FloatArray]:
        split = paper_split(bench, grade)
        rows = split.train_rows[:rows_count]
        features, label_mu = split.features(names, rows), split.label_mu(rows)
        chosen, mape = forward_selection(
            partial(_search_mape_ratio, features, label_mu, parameters, bench.seed),
            len(names),
            most_count=wanted_count,
            on_step=lambda done: bench.report(f"choice among {len(names)} features, {grade}", done, wanted_count),
        )
        return {"column": np.array(chosen, dtype=np.float64), "mape_ratio": np.array(mape)}

    digest = hashlib.sha256("\n".join(names).encode()).hexdigest()[:12]
    found = bench.remembered(f"selection-{grade}-{digest}-{wanted_count}-{bench.seed}", work)
    return Selected(tuple(names[int(column)] for column in found["column"]), found["mape_ratio"])


def selected_features(
    bench: Workbench,
    grade: SensorGrade,
    *,
    count: int = SELECTED_COUNT,
    candidates: Sequence[str] = PAPER_FEATURES,
    most_count: int | None = None,
) -> tuple[str, ...]:
    """Return the first features of `selection`, in the order in which they were chosen.

    Args:
        bench: Where the data comes from.
        grade: Sensors.
        count: How many.
        candidates: What there is to choose from: the paper's 78, or its 55 without road geometry.
        most_count: Where the search ends; at the paper's 30 if None.

    Raises:
        ValueError: The search ends before.
    """
    chosen = selection(bench, grade, candidates, most_count=most_count).names
    if count > len(chosen):
        raise ValueError(f"{count} features of a search that ends at {len(chosen)}")
    return chosen[:count]


def _search_mape_ratio(
    features: FloatArray, label_mu: FloatArray, parameters: FitParameters, seed: int, columns: tuple[int, ...]
) -> float:
    """Return the mean over the search's folds of the MAPE with some columns."""
    fold = fold_numbers(len(label_mu), SEARCH_FOLDS_COUNT, seed=seed)
    learn, rows = Boosted(parameters), features[:, columns]
    errors = []
    for number in range(SEARCH_FOLDS_COUNT):
        held_out = fold == number
        estimate = learn(rows[~held_out], label_mu[~held_out])(rows[held_out])
        errors.append(mape_ratio(label_mu[held_out], estimate))
    return float(np.mean(errors))

"""How long a bundle takes to answer and how large it is, beside the champion in the same run on the same machine.

A unit on a small computer opens the models once and then answers row by row. Both are timed: opening the models with
the first answer, call by call; and what one more row costs, from calls with many rows less calls with one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np

from roadgrip.bundle import ModelManifest
from roadgrip.units import FloatArray
from training.export import onnx_estimate_mu
from training.gate.contender import Contender
from training.gate.thresholds import SpeedThresholds
from training.gate.verdict import Check, Found, check_of

Ask: TypeAlias = Callable[[FloatArray], object]
"""Opens the models and answers some rows."""
Clock: TypeAlias = Callable[[], float]
"""Seconds that only go forward."""

_MANY_ROWS_COUNT = 500
_MANY_EVERY_COUNT = 10
"""Every tenth call is followed by one with many rows."""


@dataclass(frozen=True, slots=True)
class Times:
    """How long answers took.

    Attributes:
        opening_median_s: To open the models and answer one row.
        opening_p99_s: The same, all but one call in a hundred.
        row_s: One row more.
    """

    opening_median_s: float
    opening_p99_s: float
    row_s: float


def times_of(asked: Sequence[tuple[Ask, FloatArray]], *, calls_count: int, clock: Clock) -> list[Times]:
    """Return how long answers took, of several bundles by turns: what else the machine does slows all of them alike.

    Args:
        asked: For each bundle what opens its models and answers, and at least one row to ask about. (n, columns)
        calls_count: How often each is asked about one row.
        clock: What the time is.
    """
    single_s: list[list[float]] = [[] for _ in asked]
    many_s: list[list[float]] = [[] for _ in asked]
    for ask, rows in asked:
        ask(rows[:1])  # the first call of a process pays for what the later ones have
    for number in range(calls_count):
        for each, (ask, rows) in enumerate(asked):
            single_s[each].append(_seconds(ask, rows[number % len(rows)][None, :], clock))
            if number % _MANY_EVERY_COUNT == 0:
                many_s[each].append(_seconds(ask, rows[np.arange(_MANY_ROWS_COUNT) % len(rows)], clock))
    return [_times(single, many) for single, many in zip(single_s, many_s, strict=True)]


def latency(
    challenger: Contender, champion: Contender | None, rows: FloatArray, limits: SpeedThresholds, *, clock: Clock
) -> Found:
    """Return whether the challenger answers as fast as it should.

    Args:
        challenger: Its newest table's models are timed.
        champion: The same of the champion; None without one.
        rows: Of the challenger's newest table; the champion is asked about the columns of its own. (n, columns)
        limits: What is asked.
        clock: What the time is.
    """
    asked = [(_ask(challenger), rows)]
    if champion is not None:
        asked.append((_ask(champion), _rows_of_champion(challenger, champion, rows)))
    ours, *others = times_of(asked, calls_count=limits.calls_count, clock=clock)
    figures = {
        "opening_median_s": ours.opening_median_s,
        "opening_p99_s": ours.opening_p99_s,
        "row_s": ours.row_s,
    }
    bounds = {
        "opening_median_s": limits.opening_median_s,
        "opening_p99_s": limits.opening_p99_s,
        "row_s": limits.row_s,
    }
    than = ""
    for theirs in others:
        figures["champion_opening_median_s"] = theirs.opening_median_s
        figures["opening_over_champion_ratio"] = ours.opening_median_s / max(theirs.opening_median_s, 1e-9)
        allowed_s = limits.worse_ratio * theirs.opening_median_s + limits.allowance_s
        bounds["opening_median_s"] = min(limits.opening_median_s, allowed_s)
        than = f"; the champion {1000 * theirs.opening_median_s:.1f} ms"
    return Found(
        (
            check_of(
                "latency",
                "bundle",
                passed=all(figures[name] <= bound for name, bound in bounds.items()),
                figures=figures,
                limits=bounds,
                sentence=(
                    f"models are open and one row answered after {1000 * ours.opening_median_s:.1f} ms in the median "
                    f"({1000 * bounds['opening_median_s']:.0f} ms at most), {1000 * ours.opening_p99_s:.1f} ms in 99 "
                    f"of 100 calls{than}; a further row takes {1e6 * ours.row_s:.0f} µs"
                ),
            ),
        )
    )


def size(challenger: Contender, champion: Contender | None, limits: SpeedThresholds) -> Check:
    """Return whether the challenger's files are as small as they should be."""
    limit_bytes = float(limits.most_bytes)
    figures, than = {"size_bytes": float(challenger.size_bytes)}, ""
    if champion is not None:
        figures["champion_size_bytes"] = float(champion.size_bytes)
        limit_bytes = min(limit_bytes, limits.worse_size_ratio * champion.size_bytes + limits.allowance_bytes)
        than = f"; the champion's {champion.size_bytes / 1e6:.2f} MB"
    return check_of(
        "size",
        "bundle",
        passed=challenger.size_bytes <= limit_bytes,
        figures=figures,
        limits={"size_bytes": limit_bytes},
        sentence=f"{challenger.size_bytes / 1e6:.2f} MB of models, {limit_bytes / 1e6:.2f} MB at most{than}",
    )


def _times(single_s: Sequence[float], many_s: Sequence[float]) -> Times:
    more_s = float(np.median(many_s)) - float(np.median(single_s))
    return Times(
        opening_median_s=float(np.median(single_s)),
        opening_p99_s=float(np.quantile(single_s, 0.99)),
        row_s=max(0.0, more_s / (_MANY_ROWS_COUNT - 1)),
    )


def _rows_of_champion(challenger: Contender, champion: Contender, rows: FloatArray) -> FloatArray:
    """Return the same rows in the columns of the champion's newest table; a row of zeros where it has others."""
    ours, theirs = challenger.tables[0], champion.tables[0]
    return rows[:, ours.columns_of(theirs)] if ours.covers(theirs) else np.zeros((1, len(theirs)))


def _ask(contender: Contender) -> Ask:
    model = contender.manifest.model_for(contender.tables[0].digest)
    return partial(_answer, contender, model)


def _answer(contender: Contender, model: ModelManifest | None, rows: FloatArray) -> None:
    for name in () if model is None else model.files:
        onnx_estimate_mu(contender.bundle.files[name], rows)


def _seconds(ask: Ask, rows: FloatArray, clock: Clock) -> float:
    began_s = clock()
    ask(rows)
    return clock() - began_s

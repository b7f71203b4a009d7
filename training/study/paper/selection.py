"""Which features carry the friction: forward selection with and without the road's geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from roadgrip.units import FloatArray
from training.study.chapter import Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import box_of, per_cent
from training.study.feature_selection import (
    SEARCH_FOLDS_COUNT,
    SELECTED_COUNT,
    Selected,
    search_settings,
    selection,
)
from training.study.folds import FOLDS_COUNT, PAPER_SET, paper_split, recipe_fold_mape_ratio
from training.study.paper_features import KINEMATIC_FEATURES, PAPER_FEATURES, SPEED_FEATURES, signal_of
from training.study.picture import Axis, Boxes, Line, Lines
from training.study.recipes import PAPER_RECIPE, SPEED_ONLY_RECIPE
from training.study.wording import by_grade, leading_grade, listed, per_cent_words
from vehicle_client.simulator.plan import SensorGrade

SET_SIZES = (3, 5, 10, 15, 20, 25, 30)
WITH_ROAD, WITHOUT_ROAD = "with road geometry", "without"
CANDIDATES: Mapping[str, tuple[str, ...]] = {WITH_ROAD: PAPER_FEATURES, WITHOUT_ROAD: KINEMATIC_FEATURES}
KEYS: Mapping[str, str] = {WITH_ROAD: "road", WITHOUT_ROAD: "no_road"}
PAPER_MAPE = {3: 0.05, 15: 0.025, 30: 0.025}
"""The paper's medians by number of features, read off its words."""
PAPER_SHARED_COUNT = 10
"""Up to here, the paper's two searches choose the same."""


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return what is chosen and how well it does with one grade of sensors."""
    chosen = {name: selection(bench, grade, candidates) for name, candidates in CANDIDATES.items()}
    judged = {
        (name, count): recipe_fold_mape_ratio(bench, grade, replace(PAPER_RECIPE, features=found.names[:count]))
        for name, found in chosen.items()
        for count in SET_SIZES
        if count <= len(found.names)
    }
    for name, candidates in CANDIDATES.items():
        judged[name, len(candidates)] = recipe_fold_mape_ratio(bench, grade, replace(PAPER_RECIPE, features=candidates))
    speed_only = recipe_fold_mape_ratio(bench, grade, SPEED_ONLY_RECIPE)
    rows_count, _, parameters = search_settings(quick=bench.quick)
    split = paper_split(bench, grade)
    return Result(
        figures={
            **{
                f"median_mape.{KEYS[name]}.{count}": float(np.median(values))
                for (name, count), values in judged.items()
            },
            **{f"shared.{count}": float(_shared_count(chosen, count)) for count in (5, 10, 15)},
            f"idle.{SELECTED_COUNT}": float(idle_count(chosen[WITH_ROAD], SELECTED_COUNT)),
            "first_road_feature": float(_first_road_place(chosen[WITH_ROAD])),
            **_signal_counts(chosen[WITH_ROAD]),
            "headline.paper_config.sfs15_mape": float(np.median(judged[WITH_ROAD, SELECTED_COUNT])),
            "headline.speed_only.sfs15_mape": float(np.median(speed_only)),
        },
        sizes={
            "rows of the search": min(rows_count, len(split.train_rows)),
            "folds of the search": SEARCH_FOLDS_COUNT,
            "trees of the search": parameters.trees_count,
            "bins of the search": parameters.bins_count,
            "rows that judge the sets": len(split.train_rows),
            "folds that judge the sets": FOLDS_COUNT,
            "seed": bench.seed,
        },
        tables=(_order_table(chosen), _size_table(judged, speed_only)),
        pictures=(
            Boxes(
                f"MAPE of eight folds by number of features, {grade} sensors",
                "number of features",
                Axis("MAPE in %", low=0.0),
                tuple(
                    box_of(100.0 * values, name=str(count), group=name)
                    for (name, count), values in sorted(judged.items(), key=lambda item: item[0][1])
                ),
            ),
            _search_picture(chosen, grade),
        ),
    )


def _shared_count(chosen: Mapping[str, Selected], count: int) -> int:
    """Return how many of the first features both searches chose, in whatever order."""
    return len(set(chosen[WITH_ROAD].names[:count]) & set(chosen[WITHOUT_ROAD].names[:count]))


def idle_count(found: Selected, count: int) -> int:
    """Return how many of the first features did not lower the error of the search when they were chosen."""
    return int(np.sum(np.diff(found.mape_ratio[:count]) >= 0.0))


def _first_road_place(found: Selected) -> int:
    """Return when the first feature of the road was chosen, from 1; one after the last if none was."""
    places = [place for place, name in enumerate(found.names, start=1) if name not in KINEMATIC_FEATURES]
    return min(places, default=len(found.names) + 1)


def _signal_counts(found: Selected) -> dict[str, float]:
    """Return how many of the 15 features each signal has."""
    signals = [signal_of(name) for name in found.names[:SELECTED_COUNT]]
    return {
        f"chosen.{signal}": float(signals.count(signal)) for signal in dict.fromkeys(map(signal_of, PAPER_FEATURES))
    }


def _order_table(chosen: Mapping[str, Selected]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for place in range(max(len(found.names) for found in chosen.values())):
        cells: list[Cell] = [place + 1]
        for found in chosen.values():
            there = place < len(found.names)
            cells += [found.names[place], per_cent(found.mape_ratio[place])] if there else [None, None]
        rows.append(tuple(cells))
    columns = ["place"]
    for name in chosen:
        columns += [f"{name}: feature", f"{name}: MAPE % so far"]
    return Table(
        "Order of selection",
        tuple(columns),
        tuple(rows),
        note=f"The first {SELECTED_COUNT} with road geometry are those that the study goes on with. MAPE of the "
        "search's own three folds on its fewer rows, so above that of the full judgement.",
    )


def _size_table(judged: Mapping[tuple[str, int], FloatArray], speed_only: FloatArray) -> Table:
    counts = sorted({count for _, count in judged})
    rows: list[tuple[Cell, ...]] = []
    for count in counts:
        cells: list[Cell] = [str(count)]
        for name in CANDIDATES:
            values = judged.get((name, count))
            cells.append(None if values is None else per_cent(np.median(values)))
        cells.append(per_cent(PAPER_MAPE[count]) if count in PAPER_MAPE else None)
        rows.append(tuple(cells))
    speed = per_cent(np.median(speed_only))
    rows.append((f"{len(SPEED_FEATURES)}, of the speed alone", speed, speed, None))
    return Table(
        "Median MAPE of eight folds by number of features, in %",
        ("features", *CANDIDATES, "the paper, about"),
        tuple(rows),
        note="78 and 55 are all there are with and without road geometry.",
    )


def _search_picture(chosen: Mapping[str, Selected], grade: SensorGrade) -> Lines:
    return Lines(
        f"The search: MAPE of its three folds, {grade} sensors",
        Axis("number of features"),
        Axis("MAPE in %", low=0.0),
        tuple(
            Line(
                name,
                tuple(float(place) for place in range(1, len(found.names) + 1)),
                tuple((100.0 * found.mape_ratio).tolist()),
                dashed=name == WITHOUT_ROAD,
            )
            for name, found in chosen.items()
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return what to make of it: few features are nearly enough, and the road's geometry comes late."""
    grade = leading_grade(results)
    figures = results[grade].figures
    sizes = [count for count in SET_SIZES if f"median_mape.road.{count}" in figures]
    three, fifteen, most = (figures[f"median_mape.road.{count}"] for count in (3, SELECTED_COUNT, sizes[-1]))
    whole = figures[f"median_mape.road.{len(PAPER_FEATURES)}"]
    no_road = figures[f"median_mape.no_road.{SELECTED_COUNT}"]
    saturates = fifteen <= 1.2 * most
    as_good = fifteen <= 1.2 * PAPER_MAPE[15]
    road_is_late = figures["first_road_feature"] > PAPER_SHARED_COUNT
    road_is_of_no_use = abs(no_road - fifteen) <= 0.05 * fifteen
    kept = (saturates, as_good, road_is_late)
    claim = Claim.CONFIRMED if all(kept) else Claim.PARTLY if any(kept) else Claim.NOT_CONFIRMED
    counts = {key.removeprefix("chosen."): value for key, value in figures.items() if key.startswith("chosen.")}
    ranked = [f"{name} ({count:.0f})" for name, count in sorted(counts.items(), key=lambda item: -item[1]) if count]
    first = figures["first_road_feature"]
    place = f"is number {first:.0f}" if first <= sizes[-1] else f"is not among the first {sizes[-1]}"
    # How far a quick search goes is 15.
    more = f"{sizes[-1]} {per_cent_words(most)} and " if sizes[-1] > SELECTED_COUNT else "and "
    matters = "it hardly matters on known roads" if road_is_of_no_use else "it matters, even on known roads"
    text = (
        f"With {grade} sensors three features reach {per_cent_words(three)}, 15 {per_cent_words(fifteen)}, {more}"
        f"all {len(PAPER_FEATURES)} {per_cent_words(whole)}; the paper's about 5, 2.5 and 2.5 % (3, 15, 30). "
        f"15 features: {by_grade(results, 'headline.paper_config.sfs15_mape')}; the speed alone: "
        f"{by_grade(results, 'headline.speed_only.sfs15_mape')}. After 15 features there is "
        f"{'little' if saturates else 'still something'} to gain. The first feature of the road {place}, the "
        f"paper's comes after number {PAPER_SHARED_COUNT}; both searches share "
        f"{figures['shared.10']:.0f} of the first ten, the paper's all ten. Without road "
        f"geometry 15 features come to {per_cent_words(no_road)}: {matters}. "
        f"The 15 are from {listed(ranked)}; the paper names steering angle, sideslip, yaw rate excess and speed. "
        f"{figures['idle.15']:.0f} of the 15 brought nothing when they were chosen: on three roads a feature of the "
        "road can at worst be of no use, so a greedy search takes it where noise makes all others look harmful."
    )
    return Verdict(claim, text)


CHAPTER = Chapter(
    name="selection",
    title="Sequential feature selection",
    paper_says=(
        "Forward selection, with and without road geometry, from 3 to 30 features: the median MAPE falls from about "
        "5 % with three features to about 2.5 % with 15, and hardly further to 30. Both searches choose the same "
        "kinematic features up to number ten; then road features begin to come in. Steering angle, sideslip, "
        "yaw rate excess and speed matter most. The paper goes on with 15 features. (It counts 82 in all; its list "
        "adds up to 78.)"
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET,),
)

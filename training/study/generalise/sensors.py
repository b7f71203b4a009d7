"""What sensors allow on roads never seen: of new cars, of cars that remember, twice as good ones, exact ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from roadgrip.units import BoolArray
from training.accuracy import mape_ratio
from training.study.chapter import Arrays, Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import per_cent
from training.study.folds import RANDOM_ROADS_SET, estimates_by_strangers, learner, road_folds, roads_of, rows_by_name
from training.study.generalise.held_out import HIGH_UTILISATION_RATIO, UTILISATION_BANDS, band_name, by_use
from training.study.picture import Axis, Bars
from training.study.recipes import BEST_RECIPE, Recipe
from training.study.sources import data_set
from training.study.wording import per_cent_words
from vehicle_client.simulator.plan import SensorGrade

RECIPE: Recipe = BEST_RECIPE
NEW_CARS_SET, FINER_SET = "random-roads-new-cars", "random-roads-finer-sensors"
NEW, SCHOOLED, FINER, EXACT = (
    "from the dealer",
    "remembering their sensors",
    "with half the errors",
    "with exact sensors",
)
SETS: Mapping[SensorGrade, Mapping[str, str]] = {
    SensorGrade.AUTOMOTIVE: {NEW: NEW_CARS_SET, SCHOOLED: RANDOM_ROADS_SET, FINER: FINER_SET},
    SensorGrade.IDEAL: {EXACT: RANDOM_ROADS_SET},
}
"""Cars by what they know of the errors of their sensors, and the data set with their drives."""
BANDS = tuple(map(band_name, UTILISATION_BANDS))
LIMITING_FRAC = 0.2
"""If half the errors of the sensors take more of the error away than this, they are what limits."""


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Learn and judge on the same roads with better and better sensors."""
    roads = _roads(bench, grade)
    found = {name: _judged(bench, grade, name, set_name, roads) for name, set_name in SETS[grade].items()}
    errors = {name: _errors_of(one) for name, one in found.items()}
    rows: list[tuple[Cell, ...]] = [
        (f"cars {name}", *map(per_cent, parts.values()), len(found[name]["mu"])) for name, parts in errors.items()
    ]
    return Result(
        figures={
            f"{part}.{name}": value
            for name, parts in errors.items()
            for part, value in parts.items()
            if np.isfinite(value)
        },
        sizes={
            "roads": len(roads),
            "seed": bench.seed,
            **{f"passages, cars {name}": len(one["mu"]) for name, one in found.items()},
        },
        tables=(
            Table(
                "MAPE on roads never seen by what cars know of their sensors, in %",
                ("cars", "all", f"use {HIGH_UTILISATION_RATIO:g} and more", *(f"use {b}" for b in BANDS), "passages"),
                tuple(rows),
                note="Each line learned and judged on the same roads, by folds of roads. Half the errors: of sensors "
                "and of the map.",
            ),
        ),
        pictures=(
            Bars(
                f"Error on roads never seen by use of the grip, {grade} sensors",
                "largest share of the grip used",
                Axis("MAPE in %", low=0.0),
                BANDS,
                tuple(
                    (f"cars {name}", tuple(per_cent(parts[f"mape.{band}"]) for band in BANDS))
                    for name, parts in errors.items()
                ),
            ),
        ),
    )


def _errors_of(found: Arrays) -> dict[str, float]:
    """Return the error over all passages and over parts of them, by the names of the figures; NaN for an empty part."""
    use_ratio = found["utilisation_ratio"]
    return {
        "mape": mape_ratio(found["label_mu"], found["mu"]),
        "mape_util60": _mape_ratio(found, use_ratio >= HIGH_UTILISATION_RATIO),
        **{f"mape.{band}": _mape_ratio(found, chosen) for band, chosen in by_use(use_ratio).items()},
    }


def _roads(bench: Workbench, grade: SensorGrade) -> tuple[str, ...]:
    """Return the roads that the data sets of all grades have: the first of the random ones."""
    fewest = data_set(NEW_CARS_SET)
    size = fewest.quick_size if bench.quick else fewest.size
    shared = set.intersection(*(set(bench.runs(name, grade).section_id) for name in SETS[grade].values()))
    return tuple(sorted(shared)[: size.random_roads_count])


def _judged(bench: Workbench, grade: SensorGrade, name: str, set_name: str, roads: tuple[str, ...]) -> Arrays:
    def work() -> Arrays:
        runs = bench.runs(set_name, grade)
        rows = rows_by_name(runs)
        rows = rows[np.isin(roads_of(runs, rows), roads)]
        fold = road_folds(roads_of(runs, rows), seed=bench.seed)
        label_mu = runs.labels["label_mu"][rows]
        return {
            "mu": estimates_by_strangers(
                learner(bench, RECIPE.learn),
                runs.columns(RECIPE.features)[rows],
                label_mu,
                fold=fold,
                on_fold=lambda done: bench.report(f"cars {name}, {grade}", done, int(fold.max()) + 1),
            ),
            "label_mu": label_mu,
            "utilisation_ratio": runs.labels["peak_utilisation_ratio"][rows],
        }

    return bench.remembered(f"sensors-{set_name}-{grade}-{len(roads)}-{RECIPE.key}-{bench.seed}", work)


def _mape_ratio(found: Arrays, chosen: BoolArray) -> float:
    return mape_ratio(found["label_mu"][chosen], found["mu"][chosen]) if chosen.any() else float("nan")


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say what remembering gains, and whether sensors are what limits."""
    if SensorGrade.AUTOMOTIVE not in results:
        return Verdict(Claim.NOT_CLAIMED, "Exact sensors alone say nothing about what sensors limit.")
    figures = results[SensorGrade.AUTOMOTIVE].figures
    new, schooled, finer = (figures[f"mape.{name}"] for name in (NEW, SCHOOLED, FINER))
    gain, limit = 1.0 - schooled / new, 1.0 - finer / new
    remembering = (
        f"Cars that remember from everyday roads what their sensors get wrong err {per_cent_words(gain)} less than "
        f"cars from the dealer ({per_cent_words(schooled)} instead of {per_cent_words(new)})"
        if gain > 0.0
        else f"Remembering what sensors get wrong gains nothing ({per_cent_words(schooled)}, not {per_cent_words(new)})"
    )
    used = {name: per_cent_words(figures[f"mape_util60.{name}"]) for name in (SCHOOLED, NEW)}
    text = (
        f"{remembering}; where at least {HIGH_UTILISATION_RATIO:.0%} of the grip is used, "
        f"{used[SCHOOLED]} instead of {used[NEW]}. "
        f"Sensors and maps with half the errors take {per_cent_words(limit)} of the error away without any memory: "
        + ("the sensors limit, not the method." if limit > LIMITING_FRAC else "the sensors are not what limits.")
    )
    if SensorGrade.IDEAL in results:
        text += f" Exact ones come to {per_cent_words(results[SensorGrade.IDEAL].figures[f'mape.{EXACT}'])}."
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="sensors",
    title="What sensors allow, and what remembering them gains",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=(RANDOM_ROADS_SET,),
    automotive_needs=(NEW_CARS_SET, FINER_SET),
)

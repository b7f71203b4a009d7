"""What the sideslip is worth, and whether the speed alone gives the friction away."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from roadgrip.units import FloatArray
from training.study.chapter import Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import box_of, per_cent
from training.study.feature_selection import selected_features
from training.study.folds import FOLDS_COUNT, PAPER_SET, paper_split, recipe_fold_mape_ratio
from training.study.known_roads import global_estimates, scenario_mape_ratio
from training.study.learners import Constant
from training.study.paper_features import KINEMATIC_FEATURES, PAPER_FEATURES, signal_of, without_signals
from training.study.picture import Axis, Bars, Boxes
from training.study.recipes import PAPER_RECIPE, Recipe
from training.study.wording import by_grade, leading_grade, per_cent_words
from vehicle_client.simulator.plan import SensorGrade

WHOLE = "everything"
NO_SIDESLIP = "no sideslip, no rate of it"
NO_ANGLE = "no sideslip"
NO_SPEED = "no speed"
NEITHER = "neither sideslip nor speed"
ONLY_SPEED = "speed only"
SPEED_AND_ROAD = "speed and road geometry"
NOTHING = "no feature"
ORDER = (WHOLE, NO_ANGLE, NO_SIDESLIP, NO_SPEED, NEITHER, SPEED_AND_ROAD, ONLY_SPEED)
SELECTED, ALL = "15", "78"
HARDLY_RATIO = 1.1
"""A tenth more error is what "hardly changed" may mean."""
SHORTCUT_FRAC = 0.5
"""A speed that tells more than half of what there is to tell about friction is a shortcut."""


def variants(features: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return what is left of some features without some signals, by name; a set that nothing is left of is missing."""
    speed = tuple(name for name in features if signal_of(name) == "speed")
    road = tuple(name for name in features if name not in KINEMATIC_FEATURES)
    found = {
        WHOLE: features,
        NO_ANGLE: without_signals(features, {"sideslip"}),
        NO_SIDESLIP: without_signals(features, {"sideslip", "sideslip_rate"}),
        NO_SPEED: without_signals(features, {"speed"}),
        NEITHER: without_signals(features, {"sideslip", "sideslip_rate", "speed"}),
        SPEED_AND_ROAD: (*speed, *road),
        ONLY_SPEED: speed,
    }
    return {name: left for name, left in found.items() if left}


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return what is lost without some signals with one grade of sensors."""
    split = paper_split(bench, grade)
    sets = {ALL: variants(PAPER_FEATURES), SELECTED: variants(selected_features(bench, grade))}
    recipes = {
        (which, name): replace(PAPER_RECIPE, name=ONLY_SPEED if name == ONLY_SPEED else "paper", features=features)
        for which, of_it in sets.items()
        for name, features in of_it.items()
    }
    found = {key: recipe_fold_mape_ratio(bench, grade, recipe) for key, recipe in recipes.items()}
    # Learning nothing is the other end of the scale that the speed alone is put on.
    found[ALL, NOTHING] = recipe_fold_mape_ratio(bench, grade, Recipe(NOTHING, PAPER_FEATURES[:1], Constant()))
    by_scenario = {
        name: scenario_mape_ratio(split, global_estimates(bench, grade, recipes[ALL, name])) for name in sets[ALL]
    }
    figures = {f"median_mape.{which}.{name}": float(np.median(values)) for (which, name), values in found.items()}
    figures |= {
        f"worst_scenario_mape.{ALL}.{name}": max(mape_ratio.values()) for name, mape_ratio in by_scenario.items()
    }
    figures["speed_tells_frac"] = told_frac(
        nothing_mape_ratio=figures[f"median_mape.{ALL}.{NOTHING}"],
        some_mape_ratio=figures[f"median_mape.{ALL}.{ONLY_SPEED}"],
        all_mape_ratio=figures[f"median_mape.{ALL}.{WHOLE}"],
    )
    return Result(
        figures=figures,
        sizes={
            "rows": len(split.train_rows),
            "folds": FOLDS_COUNT,
            "rows judged by scenario": len(split.test_rows),
            "seed": bench.seed,
            **{
                f"features of {which}, {name}": len(left)
                for which, of_it in sets.items()
                for name, left in of_it.items()
            },
        },
        tables=(_table(found, sets), _scenario_table(by_scenario, split.scenarios)),
        pictures=(
            Boxes(
                f"MAPE of eight folds without some signals, {grade} sensors",
                "features",
                Axis("MAPE in %", low=0.0),
                tuple(
                    box_of(100.0 * found[which, name], name=name, group=f"of {which}")
                    for name in ORDER
                    for which in (ALL, SELECTED)
                    if (which, name) in found
                ),
            ),
            Bars(
                f"MAPE by scenario without some signals, of 78 features, {grade} sensors",
                "scenario",
                Axis("MAPE in %", low=0.0),
                split.scenarios,
                tuple(
                    (name, tuple(per_cent(by_scenario[name][part]) for part in split.scenarios))
                    for name in ORDER
                    if name in by_scenario
                ),
            ),
        ),
    )


def told_frac(*, nothing_mape_ratio: float, some_mape_ratio: float, all_mape_ratio: float) -> float:
    """Return which share of what all features tell about friction some of them tell, by the error they take away.

    Args:
        nothing_mape_ratio: Error of one number for all.
        some_mape_ratio: Error with some features.
        all_mape_ratio: Error with all of them; less than that with none.
    """
    return (nothing_mape_ratio - some_mape_ratio) / (nothing_mape_ratio - all_mape_ratio)


def _table(found: Mapping[tuple[str, str], FloatArray], sets: Mapping[str, Mapping[str, tuple[str, ...]]]) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for name in (*ORDER, NOTHING):
        cells: list[Cell] = [name]
        for which in (ALL, SELECTED):
            values = found.get((which, name))
            left = len(sets[which].get(name, ()))
            cells += [None, None] if values is None else [left, per_cent(np.median(values))]
        rows.append(tuple(cells))
    return Table(
        "Median MAPE of eight folds without some signals",
        ("features", "of 78: left", "of 78: MAPE %", "of the 15 selected: left", "of the 15: MAPE %"),
        tuple(rows),
        note="The 15 are not chosen anew: what is taken away leaves fewer. `no feature` is one number for all.",
    )


def _scenario_table(by_scenario: Mapping[str, Mapping[str, float]], scenarios: tuple[str, ...]) -> Table:
    return Table(
        "MAPE of held-out runs by scenario, of 78 features, in %",
        ("features", *scenarios),
        tuple(
            (name, *(per_cent(by_scenario[name][part]) for part in scenarios)) for name in ORDER if name in by_scenario
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return what to make of it: does the speed give the friction away, and is the sideslip needed."""
    grade = leading_grade(results)
    figures = results[grade].figures
    median = {name: figures[f"median_mape.{ALL}.{name}"] for name in (*ORDER, NOTHING)}
    speed_hardly = median[NO_SPEED] <= HARDLY_RATIO * median[WHOLE]
    sideslip_hardly = median[NO_SIDESLIP] <= HARDLY_RATIO * median[WHOLE]
    told = figures["speed_tells_frac"]
    no_shortcut = told <= SHORTCUT_FRAC
    kept = (speed_hardly, no_shortcut)
    claim = Claim.CONFIRMED if all(kept) else Claim.PARTLY if any(kept) else Claim.NOT_CONFIRMED
    gives_away = "a driver who suits his speed to the friction gives much of it away"
    driver = "no shortcut of weight" if no_shortcut else gives_away
    text = (
        f"With {grade} sensors and the 78 features the median MAPE goes from {per_cent_words(median[WHOLE])} to "
        f"{per_cent_words(median[NO_SPEED])} without the speed: it {'hardly changes' if speed_hardly else 'changes'}, "
        f"{'as' if speed_hardly else 'unlike what'} the paper finds. But leaving a signal out does not show whether it "
        "is a shortcut, since others may carry the same; asking it alone does: "
        f"{by_grade(results, f'median_mape.{ALL}.{ONLY_SPEED}')} from nothing but the speed, where one number for all "
        f"has {per_cent_words(median[NOTHING])} and all features {by_grade(results, f'median_mape.{ALL}.{WHOLE}')}. "
        f"So the speed tells {100.0 * told:.0f} % of what there is to tell: {driver}. Without the sideslip and its "
        f"rate: {by_grade(results, f'median_mape.{ALL}.{NO_SIDESLIP}')}; it "
        f"{'can be spared on known roads' if sideslip_hardly else 'is worth its trouble'}."
    )
    return Verdict(claim, text)


CHAPTER = Chapter(
    name="without",
    title="Without the sideslip, without the speed",
    paper_says=(
        "The sideslip is the hardest signal to estimate; a picture shows the regressors without it and its rate beside "
        "the others, without a figure in the text. Leaving out the speed hardly changes the accuracy, from which "
        "the paper concludes that no shortcut was learned, that is, that the driver's speed does not give the friction "
        "away."
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET,),
)

"""How many roads it takes: the error on roads never seen against the number of roads that were learned from."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from roadgrip.units import FloatArray
from training.accuracy import mape_ratio
from training.dataset import DatasetError
from training.study.chapter import Arrays, Cell, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import per_cent
from training.study.folds import RANDOM_ROADS_SET, learner, roads_of, rows_by_name, side_by_side
from training.study.paper_features import PAPER_FEATURES
from training.study.picture import Axis, Line, Lines
from training.study.recipes import BEST_RECIPE, PAPER_RECIPE, Recipe
from training.study.wording import by_grade, leading_grade
from vehicle_client.simulator.plan import SensorGrade

PAPER, PAPER_FEATURES_OURS, BEST = "paper_config", "paper_features", "best"
CURVES: Mapping[str, Recipe] = {
    PAPER: PAPER_RECIPE,
    PAPER_FEATURES_OURS: BEST_RECIPE.on(PAPER_FEATURES, name="the paper's features, our way"),
    BEST: BEST_RECIPE,
}
"""What is learned ever more from, by the name of its figures."""
JUDGED_FRAC = 0.2
"""Share of the roads that all are judged on, and nobody learns from."""
ROADS_COUNTS = (25, 50, 100, 200, 400, 800)
"""And all there are."""
DRAWS_COUNT = 3
"""Few roads are a lucky hand or not: so many hands are dealt."""
DRAWN_ONCE_COUNT = 300
"""From here on one hand of roads is much like another."""
SATURATED_FRAC = 0.03
"""Twice the roads for less than this much less error is not worth driving them."""


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Learn from ever more roads."""
    curves = {name: _curve(bench, grade, recipe) for name, recipe in CURVES.items()}
    counts = next(iter(curves.values()))["roads_count"]
    figures = {
        f"mape.{name}.{count:.0f}": float(value)
        for name, found in curves.items()
        for count, value in zip(counts, found["mape_ratio"], strict=True)
    }
    for name, found in curves.items():
        figures[f"last_doubling.{name}"] = last_doubling_frac(counts, found["mape_ratio"])
        figures[f"most.{name}"] = float(found["mape_ratio"][-1])
        figures[f"least.{name}"] = float(found["mape_ratio"][0])
    rows: list[tuple[Cell, ...]] = []
    for place, count in enumerate(counts):
        rows.append((int(count), *(per_cent(found["mape_ratio"][place]) for found in curves.values())))
    return Result(
        figures=figures,
        sizes={
            "roads judged on": int(next(iter(curves.values()))["judged_roads_count"][0]),
            "passages judged": int(next(iter(curves.values()))["judged_count"][0]),
            "roads learned from, at most": int(counts[-1]),
            "hands of few roads": DRAWS_COUNT,
            "seed": bench.seed,
        },
        tables=(
            Table(
                "MAPE on roads never seen by number of roads learned from, in %",
                ("roads", *(f"{recipe.name} ({name})" for name, recipe in CURVES.items())),
                tuple(rows),
                note=f"11 drives on each road, one per base friction. Always the same roads to be judged on. Up to "
                f"{DRAWN_ONCE_COUNT} roads the mean over {DRAWS_COUNT} hands of roads.",
            ),
        ),
        pictures=(
            Lines(
                f"Error on roads never seen against roads learned from, {grade} sensors",
                Axis("roads learned from", logarithmic=True),
                Axis("MAPE in %", low=0.0),
                tuple(
                    Line(
                        CURVES[name].name,
                        tuple(counts.tolist()),
                        tuple(per_cent(value) for value in found["mape_ratio"].tolist()),
                        low=tuple(per_cent(value) for value in found["lowest_ratio"].tolist()),
                        high=tuple(per_cent(value) for value in found["highest_ratio"].tolist()),
                    )
                    for name, found in curves.items()
                ),
            ),
        ),
    )


def last_doubling_frac(roads_count: FloatArray, mape_of_count_ratio: FloatArray) -> float:
    """Return by which share the error fell when the number of roads was doubled for the last time.

    Args:
        roads_count: Ascending. (n,)
        mape_of_count_ratio: The error after so many roads; linear between them on a logarithmic axis. (n,)
    """
    half = np.interp(np.log(roads_count[-1] / 2.0), np.log(roads_count), mape_of_count_ratio)
    return float(1.0 - mape_of_count_ratio[-1] / half)


def _curve(bench: Workbench, grade: SensorGrade, recipe: Recipe) -> Arrays:
    def work() -> Arrays:
        runs = bench.runs(RANDOM_ROADS_SET, grade)
        rows = rows_by_name(runs)
        features, label = runs.columns(recipe.features)[rows], runs.labels["label_mu"][rows]
        roads, road = np.unique(roads_of(runs, rows), return_inverse=True)
        dealt = np.random.default_rng([bench.seed, len(roads)]).permutation(len(roads))
        judged_count = max(1, round(JUDGED_FRAC * len(roads)))
        judged, rest = np.isin(road, dealt[:judged_count]), dealt[judged_count:]
        if len(rest) == 0:
            raise DatasetError(f"{len(roads)} roads are too few to learn from some and be judged on others")
        counts = [*(count for count in ROADS_COUNTS if count < len(rest)), len(rest)]
        hands = [
            (place, np.random.default_rng([bench.seed, count, draw]).permutation(rest)[:count])
            for place, count in enumerate(counts)
            for draw in range(DRAWS_COUNT if count < min(DRAWN_ONCE_COUNT, len(rest)) else 1)
        ]
        found = np.full(len(hands), np.nan)

        def learn(number: int) -> None:
            learned = np.isin(road, hands[number][1])
            mu = learner(bench, recipe.learn)(features[learned], label[learned])(features[judged])
            found[number] = mape_ratio(label[judged], mu)

        side_by_side(
            [partial(learn, number) for number in range(len(hands))],
            on_done=lambda done: bench.report(f"learning curve, {recipe.name}, {grade}", done, len(hands)),
        )
        place = np.array([place for place, _ in hands])
        return {
            "roads_count": np.array(counts, dtype=np.float64),
            "mape_ratio": np.array([found[place == i].mean() for i in range(len(counts))]),
            "lowest_ratio": np.array([found[place == i].min() for i in range(len(counts))]),
            "highest_ratio": np.array([found[place == i].max() for i in range(len(counts))]),
            "judged_roads_count": np.array([float(judged_count)]),
            "judged_count": np.array([float(judged.sum())]),
        }

    return bench.remembered(f"learning-curve-{grade}-{recipe.key}-{bench.seed}", work)


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Say how many roads it takes, and whether more would help."""
    grade = leading_grade(results)
    figures = results[grade].figures
    roads = results[grade].sizes["roads learned from, at most"]
    saturated = {name: figures[f"last_doubling.{name}"] < SATURATED_FRAC for name in (PAPER, BEST)}
    more = "more roads would hardly help" if saturated[BEST] else "more roads would help further"
    data_or_features = (
        "no number of such roads makes up for the features"
        if figures[f"most.{PAPER_FEATURES_OURS}"] > figures[f"least.{BEST}"]
        else "roads make up for some of what the features lack"
    )
    text = (
        f"From {ROADS_COUNTS[0]} to {roads} roads the best regressor's error on roads never seen falls from "
        f"{by_grade(results, f'least.{BEST}')} to {by_grade(results, f'most.{BEST}')}, the paper's configuration's "
        f"from {by_grade(results, f'least.{PAPER}')} to {by_grade(results, f'most.{PAPER}')}; its features, learned as "
        f"the best regressor learns, come to {by_grade(results, f'most.{PAPER_FEATURES_OURS}')}: {data_or_features}. "
        f"The last doubling takes {by_grade(results, f'last_doubling.{BEST}')} of the best regressor's error away: "
        f"{more}."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="learning_curve",
    title="How many roads it takes",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=(RANDOM_ROADS_SET,),
)

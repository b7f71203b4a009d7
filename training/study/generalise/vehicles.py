"""What a car must know of itself: its constants declared exactly, declared wrong, or learned from its own drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from roadgrip.units import FloatArray
from training.accuracy import mape_ratio, relative_rms_ratio
from training.car_lives import FEW_COUNT, Telling
from training.cars import WRONG_RATIO
from training.dataset import Runs
from training.everyday import EVERYDAY_COUNT
from training.regressor import RowIndices
from training.study.chapter import Arrays, Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import per_cent
from training.study.folds import FOLDS_COUNT, learner, road_folds, side_by_side
from training.study.generalise.held_out import UTILISATION_BANDS, band_name, band_of
from training.study.picture import Axis, Bars
from training.study.recipes import BEST_RECIPE, PAPER_RECIPE, SPEED_ONLY_RECIPE, Recipe
from training.study.wording import by_grade, leading_grade
from vehicle_client.simulator.plan import SensorGrade

FLEET_SET, PAPER_CAR_SET = "lives-fleet", "lives-paper"
SETS: Mapping[str, str] = {FLEET_SET: "a fleet of cars", PAPER_CAR_SET: "the paper's car"}
WORDS: Mapping[Telling, str] = {
    Telling.MATCHED: "declared exactly",
    Telling.REMEMBERED: f"declared exactly, sensors known from {EVERYDAY_COUNT} passages",
    Telling.WRONG: f"every constant {100 * WRONG_RATIO:.0f} % wrong",
    Telling.IDENTIFIED_FEW: f"the same, {FEW_COUNT} passages remembered",
    Telling.IDENTIFIED: f"the same, {EVERYDAY_COUNT} passages remembered",
}
LIKE, EXACT = "like", "exact"
"""Who taught the regressor: cars that tell alike, or cars that are declared exactly and remember nothing."""
BASELINES: Mapping[str, Recipe] = {"paper_config": PAPER_RECIPE, "speed_only": SPEED_ONLY_RECIPE}
"""What they go by no declaration touches."""


@dataclass(frozen=True, slots=True)
class Estimated:
    """What strangers to cars and roads make of the passages of one data set.

    Attributes:
        label_mu: The truth, of every passage that every telling has. (n,)
        utilisation_ratio: Largest share of the grip that each used. (n,)
        mu: Estimates by recipe, or for the best one by telling and teacher. Each (n,)
    """

    label_mu: FloatArray
    utilisation_ratio: FloatArray
    mu: Mapping[str, FloatArray]

    def mape_ratio(self, name: str, band: tuple[float, float] = (0.0, np.inf)) -> float:
        """Return the mean relative error within a band of utilisation; NaN where there is nothing."""
        chosen = band_of(self.utilisation_ratio, band)
        return mape_ratio(self.label_mu[chosen], self.mu[name][chosen]) if chosen.any() else np.nan


def rows_by_telling(runs: Runs) -> dict[Telling, RowIndices]:
    """Return the rows of every telling, the same passages in the same order: those that all tellings have."""
    usable = runs.usable
    passage = np.array([key.rpartition("/")[0] for key in runs.run_key])
    told = np.array(runs.scenario)
    rows = {}
    for telling in Telling:
        mine = np.flatnonzero(told == telling.value)
        rows[telling] = mine[np.argsort(passage[mine], kind="stable")]
    everywhere = np.logical_and.reduce([usable[mine] for mine in rows.values()])
    return {telling: mine[everywhere] for telling, mine in rows.items()}


def group_of(run_key: str) -> str:
    """Return the group of cars that a run belongs to; its roads are driven by no other."""
    return run_key.split("/")[1].partition("-")[0]


def key_of(telling: Telling, teacher: str) -> str:
    """Return the name of the best recipe's estimates."""
    return f"{telling}.{teacher}"


def estimated(bench: Workbench, grade: SensorGrade, name: str) -> Estimated:
    """Return what strangers to cars and roads make of a data set.

    Args:
        bench: Where the data comes from.
        grade: Sensors.
        name: Of the data set.
    """

    def work() -> Arrays:
        runs = bench.runs(name, grade)
        rows = rows_by_telling(runs)
        exact = rows[Telling.MATCHED]
        label = runs.labels["label_mu"][exact]
        fold = road_folds([group_of(runs.run_key[i]) for i in exact.tolist()], seed=bench.seed)
        told = {telling: runs.columns(BEST_RECIPE.features)[mine] for telling, mine in rows.items()}
        found = {key_of(telling, teacher): np.full(len(label), np.nan) for telling in told for teacher in (LIKE, EXACT)}

        def judge(telling: Telling, number: int) -> None:
            out = fold == number
            estimator = learner(bench, BEST_RECIPE.learn)(told[telling][~out], label[~out])
            found[key_of(telling, LIKE)][out] = estimator(told[telling][out])
            if telling is Telling.MATCHED:
                for other, features in told.items():
                    found[key_of(other, EXACT)][out] = estimator(features[out])

        def judge_by(recipe_name: str, number: int) -> None:
            out, recipe = fold == number, BASELINES[recipe_name]
            features = runs.columns(recipe.features)[exact]
            found[recipe_name][out] = learner(bench, recipe.learn)(features[~out], label[~out])(features[out])

        found |= {recipe_name: np.full(len(label), np.nan) for recipe_name in BASELINES}
        folds = np.unique(fold).tolist()
        jobs = [partial(judge, telling, number) for telling in told for number in folds]
        jobs += [partial(judge_by, recipe_name, number) for recipe_name in BASELINES for number in folds]
        what = f"{name}, {grade}"
        side_by_side(jobs, on_done=lambda done: bench.report(what, done, len(jobs)))
        utilisation = runs.labels["peak_utilisation_ratio"][exact]
        return {"label_mu": label, "utilisation_ratio": utilisation, **found}

    recipes = "-".join(recipe.key for recipe in (BEST_RECIPE, *BASELINES.values()))
    kept = dict(bench.remembered(f"vehicles-{name}-{grade}-{recipes}-{bench.seed}", work))
    return Estimated(kept.pop("label_mu"), kept.pop("utilisation_ratio"), kept)


def headline_telling(fleet: Estimated) -> Telling:
    """Return by which telling the study's headline goes: what a car learned, unless that is worse than wrong."""
    identified, wrong = (fleet.mape_ratio(key_of(one, LIKE)) for one in (Telling.IDENTIFIED, Telling.WRONG))
    return Telling.IDENTIFIED if identified < wrong else Telling.WRONG


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return the errors for every telling, on the fleet and on the paper's car."""
    found = {name: estimated(bench, grade, name) for name in SETS}
    figures = {
        f"mape.{name}.{key}": judged.mape_ratio(key) for name, judged in found.items() for key in sorted(judged.mu)
    }
    figures |= {
        f"band.{name}.{telling}.{band_name(band)}": judged.mape_ratio(key_of(telling, LIKE), band)
        for name, judged in found.items()
        for telling in Telling
        for band in UTILISATION_BANDS
        if band_of(judged.utilisation_ratio, band).any()
    }
    fleet = found[FLEET_SET]
    best = headline_telling(fleet)
    figures["headline.best.unseen_fleet_mape"] = fleet.mape_ratio(key_of(best, LIKE))
    figures |= {f"headline.{name}.unseen_fleet_mape": fleet.mape_ratio(name) for name in BASELINES}
    return Result(
        figures=figures,
        sizes={
            **{f"passages judged, {SETS[name]}": len(judged.label_mu) for name, judged in found.items()},
            "passages remembered": EVERYDAY_COUNT,
            "folds, by cars and roads": FOLDS_COUNT,
            "seed": bench.seed,
        },
        tables=(*(_table(name, judged) for name, judged in found.items()),),
        pictures=(
            Bars(
                f"MAPE on unseen roads by what a car knows of itself, {grade} sensors",
                "cars",
                Axis("MAPE in %", low=0.0),
                tuple(SETS.values()),
                tuple(
                    (
                        WORDS[telling],
                        tuple(per_cent(judged.mape_ratio(key_of(telling, LIKE))) for judged in found.values()),
                    )
                    for telling in Telling
                ),
            ),
        ),
    )


def _table(name: str, judged: Estimated) -> Table:
    bands = [band for band in UTILISATION_BANDS if band_of(judged.utilisation_ratio, band).any()]
    lines = [(WORDS[telling], key_of(telling, LIKE), key_of(telling, EXACT)) for telling in Telling]
    lines += [(recipe.name, key, "") for key, recipe in BASELINES.items()]
    rows = tuple(
        (
            words,
            per_cent(judged.mape_ratio(key)),
            per_cent(relative_rms_ratio(judged.label_mu, judged.mu[key])),
            *(per_cent(judged.mape_ratio(key, band)) for band in bands),
            per_cent(judged.mape_ratio(other)) if other else None,
        )
        for words, key, other in lines
    )
    return Table(
        f"Errors on unseen roads, {SETS[name]}",
        (
            "what the car goes by",
            "MAPE %",
            "relative RMS %",
            *(f"utilisation {band_name(band)}, MAPE %" for band in bands),
            "taught by exactly declared cars, MAPE %",
        ),
        rows,
        note=(
            f"The same {len(judged.label_mu)} passages in every line, of cars and on roads that taught nothing. "
            "The regressor was taught by cars that tell alike; in the last column by cars that are declared exactly "
            "and remember nothing. What was learned of the own car was learned without knowing any friction."
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return what wrong constants cost, and what a memory wins back."""
    figures = results[leading_grade(results)].figures
    parts = []
    for name, words in SETS.items():
        exact, wrong, learned = (
            figures[f"mape.{name}.{key_of(telling, LIKE)}"]
            for telling in (Telling.MATCHED, Telling.WRONG, Telling.IDENTIFIED)
        )
        lost, back = wrong - exact, wrong - learned
        if lost <= 0.0:
            won = "wrong constants cost nothing"
        elif back <= 0.0:
            won = "a memory wins nothing of that back"
        else:
            won = f"a memory of {EVERYDAY_COUNT} passages wins {100.0 * back / lost:.0f} % of the loss back"
        parts.append(
            f"{words}: declared exactly {by_grade(results, f'mape.{name}.{key_of(Telling.MATCHED, LIKE)}')}, "
            f"every constant {100 * WRONG_RATIO:.0f} % wrong "
            f"{by_grade(results, f'mape.{name}.{key_of(Telling.WRONG, LIKE)}')}, "
            f"wrong and learned {by_grade(results, f'mape.{name}.{key_of(Telling.IDENTIFIED, LIKE)}')}, "
            f"exact with sensors learned {by_grade(results, f'mape.{name}.{key_of(Telling.REMEMBERED, LIKE)}')}: {won}"
        )
    by = {
        "what the car has learned of itself"
        if figures_of["headline.best.unseen_fleet_mape"]
        == figures_of[f"mape.{FLEET_SET}.{key_of(Telling.IDENTIFIED, LIKE)}"]
        else "wrong constants, since learning does not help"
        for figures_of in (result.figures for result in results.values())
    }
    text = (
        f"MAPE on unseen roads. {'. '.join(part[0].upper() + part[1:] for part in parts)}. The headline for the fleet "
        f"goes by {' or '.join(sorted(by))}: {by_grade(results, 'headline.best.unseen_fleet_mape')}; the paper's "
        f"features give {by_grade(results, 'headline.paper_config.unseen_fleet_mape')}."
    )
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="vehicles",
    title="What a car must know of itself",
    paper_says="",
    compute=compute,
    verdict=verdict,
    needs=tuple(SETS),
)

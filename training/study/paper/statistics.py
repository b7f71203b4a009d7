"""Which statistics of the signals a summary should hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from training.study.chapter import Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.distributions import box_of, per_cent
from training.study.feature_selection import selected_features
from training.study.folds import FOLDS_COUNT, PAPER_SET, paper_split, recipe_fold_mape_ratio
from training.study.paper_features import (
    MEAN_AND_STD,
    PAPER_FEATURES,
    QUANTILES,
    SHAPES,
    of_statistics,
)
from training.study.picture import Axis, Boxes
from training.study.recipes import PAPER_RECIPE, SPEED_ONLY_RECIPE
from training.study.wording import leading_grade, per_cent_words
from vehicle_client.simulator.plan import SensorGrade

ALL, MEANS, QUANTS, CHOSEN, SHAPE = "all", "mean and std", "quantiles", "15 selected", "skewness and kurtosis"
ORDER = (ALL, MEANS, QUANTS, CHOSEN, SHAPE)
SPEED = "speed only"


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return how summaries of different statistics do with one grade of sensors."""
    variants = {
        ALL: PAPER_FEATURES,
        MEANS: of_statistics(PAPER_FEATURES, MEAN_AND_STD),
        QUANTS: of_statistics(PAPER_FEATURES, QUANTILES),
        CHOSEN: selected_features(bench, grade),
        SHAPE: of_statistics(PAPER_FEATURES, SHAPES),
    }
    recipes = {name: replace(PAPER_RECIPE, features=features) for name, features in variants.items()}
    recipes[SPEED] = SPEED_ONLY_RECIPE
    found = {name: recipe_fold_mape_ratio(bench, grade, recipe) for name, recipe in recipes.items()}
    return Result(
        figures={f"median_mape.{name}": float(np.median(values)) for name, values in found.items()},
        sizes={
            "rows": len(paper_split(bench, grade).train_rows),
            "folds": FOLDS_COUNT,
            "seed": bench.seed,
            **{f"features, {name}": len(recipe.features) for name, recipe in recipes.items()},
        },
        tables=(
            Table(
                "MAPE of eight folds by what a summary holds",
                ("summary", "features", "median %", "best fold %", "worst fold %"),
                tuple(
                    (
                        name,
                        len(recipe.features),
                        per_cent(np.median(found[name])),
                        per_cent(found[name].min()),
                        per_cent(found[name].max()),
                    )
                    for name, recipe in recipes.items()
                ),
                note="Of the five signals and the two profiles of the road; the section's length only in `all`. "
                "Smallest, middle and largest value count as quantiles.",
            ),
        ),
        pictures=(
            Boxes(
                f"MAPE of eight folds by what a summary holds, {grade} sensors",
                "summary",
                Axis("MAPE in %", low=0.0),
                tuple(box_of(100.0 * found[name], name=name, group=str(grade)) for name in ORDER),
            ),
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return what to make of it: do the selected features beat all formats, and quantiles mean and deviation."""
    grade = leading_grade(results)
    median = {name: results[grade].figures[f"median_mape.{name}"] for name in (*ORDER, SPEED)}
    beaten = [name for name in (MEANS, QUANTS, SHAPE) if median[CHOSEN] < median[name]]
    beats_formats, beats_all = len(beaten) == 3, median[CHOSEN] < median[ALL]
    quantiles_win = median[QUANTS] < median[MEANS]
    kept = (beats_formats, beats_all, quantiles_win)
    claim = Claim.CONFIRMED if all(kept) else Claim.PARTLY if any(kept) else Claim.NOT_CONFIRMED
    figures = ", ".join(f"{name} {per_cent_words(median[name])}" for name in ORDER)
    text = (
        f"Median MAPE with {grade} sensors: {figures}; from the speed alone {per_cent_words(median[SPEED])}. "
        f"The 15 selected features {'beat' if beats_formats else 'do not beat'} every single format of statistics, as "
        f"the paper finds, {'and' if beats_all == beats_formats else 'but'} they "
        f"{'also beat' if beats_all else 'do not beat'} all {len(PAPER_FEATURES)} together. "
        f"{'' if beats_all else 'Its own figures (1.68 % with all features, about 2.5 % with 15) say the same. '}"
        f"Quantiles are {'better' if quantiles_win else 'no better'} than mean and standard deviation."
    )
    return Verdict(claim, text)


CHAPTER = Chapter(
    name="statistics",
    title="Variations of the statistical summary",
    paper_says=(
        "Summaries of all statistics, of mean and standard deviation, of quantiles, of skewness and kurtosis, and the "
        "15 selected features, each judged by eight folds: the selected features beat all others, and quantiles mostly "
        "beat mean and standard deviation. The figures are only in a picture."
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET,),
)

"""How much the figures hang on amplitudes that the paper does not give: of the road's surface and of sensor errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from roadgrip.units import FloatArray
from training.dataset import Runs
from training.regressor import RowIndices
from training.study.chapter import Cell as TableCell
from training.study.chapter import Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.datasets import SENSITIVITY_QUICK_SIZE, SENSITIVITY_SIZE
from training.study.distributions import per_cent
from training.study.folds import FOLDS_COUNT, PAPER_SET, cross_validated, learner, rows_by_name
from training.study.paper.drivers import Error, error_of
from training.study.picture import Axis, Bars
from training.study.recipes import PAPER_RECIPE, SPEED_ONLY_RECIPE, Recipe
from training.study.wording import leading_grade
from vehicle_client.simulator.plan import SensorGrade

USUAL = "as usual"
CONTROL = "as usual, other drives"
"""Nothing but chance changes here: the next runs of the same cells."""
SETTINGS: Mapping[str, str] = {
    "roughness halved": "roughness-halved",
    "roughness doubled": "roughness-doubled",
    "sensor errors halved": "sensors-halved",
    "sensor errors doubled": "sensors-doubled",
}
SENSOR_SETTINGS = ("sensor errors halved", "sensor errors doubled")
ALL, SPEED = "78 features", "speed only"
RECIPES = {ALL: PAPER_RECIPE, SPEED: SPEED_ONLY_RECIPE}
RESAMPLES_COUNT = 2000
CONFIDENCE_FRAC = 0.95


@dataclass(frozen=True, slots=True)
class Judged:
    """What strangers made of the drives of a setting.

    Attributes:
        error: Over all of them.
        error_ratio: Magnitude of the error of each drive, relative to the truth, by the drive's name.
    """

    error: Error
    error_ratio: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Change:
    """By which share the MAPE of a setting differs from the usual one.

    Attributes:
        ratio: Positive where it is larger.
        low_ratio: Lower end of its confidence interval.
        high_ratio: Upper end.
        both_count: Drives that were judged in both settings.
    """

    ratio: float
    low_ratio: float
    high_ratio: float
    both_count: int


def change_between(
    rng: np.random.Generator, usual_ratio: Mapping[str, float], other_ratio: Mapping[str, float]
) -> Change:
    """Return how the mean of some errors differs from that of others, with what chance might have made of it.

    Drives are drawn with replacement, each with all the errors it has: what a driver, a tyre and a surface do to both
    settings is no difference between them.

    Args:
        rng: Source of chance.
        usual_ratio: Errors as usual, by the names of the drives.
        other_ratio: Errors in the other setting, of the same drives as far as they were driven there.

    References:
        Efron, Tibshirani, An Introduction to the Bootstrap, 1993, chapters 8 and 13 (percentile intervals).
    """
    names = sorted({*usual_ratio, *other_ratio})
    sides = [np.array([side.get(name, np.nan) for name in names]) for side in (usual_ratio, other_ratio)]
    there = np.isfinite(sides)
    error = np.where(there, sides, 0.0)
    drawn = np.empty(RESAMPLES_COUNT)
    for number in range(RESAMPLES_COUNT):
        times = np.bincount(rng.integers(len(names), size=len(names)), minlength=len(names))
        usual, other = (error @ times) / (there @ times)
        drawn[number] = other / usual - 1.0
    usual, other = error.sum(axis=1) / there.sum(axis=1)
    tail_frac = (1.0 - CONFIDENCE_FRAC) / 2.0
    low, high = np.quantile(drawn, [tail_frac, 1.0 - tail_frac]).tolist()
    return Change(float(other / usual - 1.0), low, high, int(there.all(axis=0).sum()))


def first_rows(runs: Runs, *, kept_count: int, skipped_count: int = 0) -> RowIndices:
    """Return the first usable rows of every scenario at every base friction, by the number of the attempt.

    Args:
        runs: The table.
        kept_count: How many of each, at most.
        skipped_count: How many of each are left out before.
    """
    hundredths = np.rint(100.0 * runs.labels["base_friction_mu"]).astype(np.intp)

    def cell(row: int) -> tuple[str, int]:
        return runs.scenario[row], int(hundredths[row])

    rows = sorted(
        np.flatnonzero(runs.usable).tolist(), key=lambda row: (*cell(row), runs.labels["attempt_number"][row])
    )
    some = slice(skipped_count, skipped_count + kept_count)
    return np.array([row for _, group in groupby(rows, key=cell) for row in list(group)[some]], dtype=np.intp)


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return the errors in every setting, learned and judged within it, with one grade of sensors."""
    # Exact sensors twice as exact are the same drives: nothing to drive.
    settings = [name for name in SETTINGS if grade is not SensorGrade.IDEAL or name not in SENSOR_SETTINGS]
    shown = (USUAL, CONTROL, *settings)
    found: dict[tuple[str, str], Judged] = {}
    for done, setting in enumerate(shown):
        bench.report(f"amplitudes, {grade}", done, len(shown))
        found |= {(setting, name): _judged(bench, grade, setting, recipe) for name, recipe in RECIPES.items()}
    usual = found[USUAL, ALL].error_ratio
    changes = {
        setting: change_between(np.random.default_rng(bench.seed), usual, found[setting, ALL].error_ratio)
        for setting in (CONTROL, *settings)
    }
    errors = {key: judged.error for key, judged in found.items()}
    figures = {f"mape.{name}.{setting}": error.mape_ratio for (setting, name), error in errors.items()}
    figures |= {f"relative_rms.{name}.{setting}": error.relative_rms_ratio for (setting, name), error in errors.items()}
    for setting, change in changes.items():
        figures[f"change.{setting}"] = change.ratio
        figures[f"change_low.{setting}"], figures[f"change_high.{setting}"] = change.low_ratio, change.high_ratio
    return Result(
        figures=figures,
        sizes={
            "kept runs per cell": _kept_count(bench),
            "folds": FOLDS_COUNT,
            "resamples": RESAMPLES_COUNT,
            "seed": bench.seed,
            **{f"runs, {setting}": errors[setting, ALL].rows_count for setting in shown},
            **{f"of them as usual too, {setting}": changes[setting].both_count for setting in settings},
        },
        tables=(_table(errors, changes, shown),),
        pictures=(
            Bars(
                f"MAPE at other amplitudes, {grade} sensors",
                "amplitudes",
                Axis("MAPE in %", low=0.0),
                shown,
                tuple(
                    (name, tuple(per_cent(errors[setting, name].mape_ratio) for setting in shown)) for name in RECIPES
                ),
            ),
        ),
    )


def _kept_count(bench: Workbench) -> int:
    return (SENSITIVITY_QUICK_SIZE if bench.quick else SENSITIVITY_SIZE).runs_count


def _judged(bench: Workbench, grade: SensorGrade, setting: str, recipe: Recipe) -> Judged:
    """Return the cross-validated errors in a setting; in the usual ones on as many runs of the paper's set."""
    count = _kept_count(bench)
    runs = bench.runs(SETTINGS.get(setting, PAPER_SET), grade)
    chosen = runs.rows(first_rows(runs, kept_count=count, skipped_count=count if setting == CONTROL else 0))
    rows = rows_by_name(chosen)
    features, label_mu = chosen.columns(recipe.features)[rows], chosen.labels["label_mu"][rows]

    def work() -> dict[str, FloatArray]:
        judged = cross_validated(learner(bench, recipe.learn), features, label_mu, seed=bench.seed)
        return {"estimate_mu": judged.estimate_mu}

    name = f"amplitudes-{setting}-{count}-{grade}-{recipe.key}-{bench.seed}"
    estimate_mu = bench.remembered(name, work)["estimate_mu"]
    names = [chosen.run_key[row] for row in rows.tolist()]
    error_ratio = dict(zip(names, np.abs(estimate_mu / label_mu - 1.0).tolist(), strict=True))
    return Judged(error_of(chosen, rows, estimate_mu), error_ratio)


def _table(errors: Mapping[tuple[str, str], Error], changes: Mapping[str, Change], shown: tuple[str, ...]) -> Table:
    rows: list[tuple[TableCell, ...]] = []
    for setting in shown:
        error, change = errors[setting, ALL], changes.get(setting)
        ends = (change.ratio, change.low_ratio, change.high_ratio) if change else (None, None, None)
        rows.append(
            (
                setting,
                per_cent(error.mape_ratio),
                *(None if end is None else per_cent(end) for end in ends),
                per_cent(error.relative_rms_ratio),
                per_cent(error.worst_mape_ratio),
                error.worst_scenario,
                per_cent(errors[setting, SPEED].mape_ratio),
                error.rows_count,
            )
        )
    return Table(
        "Errors at other amplitudes, learned and judged within each",
        (
            "amplitudes",
            "MAPE %",
            "change %",
            "from %",
            "to %",
            "relative RMS %",
            "worst scenario %",
            "which",
            "speed only, MAPE %",
            "runs",
        ),
        tuple(rows),
        note=(
            "The same drivers, tyres and draws of chance throughout, but for the other drives as usual, which show "
            f"what chance alone may do. Few runs, so all errors are larger than those of the whole data set; what "
            f"counts is the change. From and to: {per_cent(CONFIDENCE_FRAC):.0f} % of {RESAMPLES_COUNT} changes of "
            "drives drawn anew with replacement, each with its errors in both settings; a change is beyond chance if "
            "both have its sign. Roughness: heights of the surface, whose usual spectrum is the middle of class A of "
            "ISO 8608; doubling them is the middle of class B. Sensor errors include those of the map."
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return how much of the figures is a matter of amplitudes, as far as it is not a matter of chance."""
    text = (
        "The paper adds noise like that of good asphalt and gives no amplitude, so how near any figure comes to its "
        "own is partly a matter of what is assumed. By how much the MAPE changes (and the range that chance in the "
        f"drives leaves it): {'; '.join(_told(results, setting) for setting in (*SETTINGS, CONTROL))}."
    )
    lead = leading_grade(results)
    figures = results[lead].figures
    told = [name for name in SETTINGS if _is_beyond_chance(figures, name)]
    if told:
        strongest = max(told, key=lambda name: abs(figures[f"change.{name}"]))
        text += f" The strongest of those beyond chance with {lead} sensors: {strongest}."
    else:
        text += f" With {lead} sensors none of them changes the MAPE beyond chance."
    if _is_beyond_chance(figures, CONTROL):
        text += " But so do other drives under the usual amplitudes: the ranges are too narrow."
    return Verdict(Claim.NOT_CLAIMED, text)


def _is_beyond_chance(figures: Mapping[str, float], setting: str) -> bool:
    """Return whether a setting was tried and both ends of the range of its change have the same sign."""
    low, high = (figures.get(f"change_{end}.{setting}", np.nan) for end in ("low", "high"))
    return low > 0.0 or high < 0.0


def _told(results: Mapping[SensorGrade, Result], setting: str) -> str:
    words = []
    for grade, result in results.items():
        if (ratio := result.figures.get(f"change.{setting}")) is not None:
            low, high = (100.0 * result.figures[f"change_{end}.{setting}"] for end in ("low", "high"))
            told = f"{100.0 * ratio:+.1f} % ({low:+.1f} to {high:+.1f}, {grade})"
            beyond = _is_beyond_chance(result.figures, setting)
            words.append(told if beyond else f"no difference beyond chance, {told}")
    return f"{setting}: {' and '.join(words) or 'not tried'}"


CHAPTER = Chapter(
    name="sensitivity",
    title="Amplitudes of road and sensors",
    paper_says=(
        "Noise is added that is similar to driving on good asphalt; its amplitude is not given, and other amplitudes "
        "are not tried."
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET, *(name for setting, name in SETTINGS.items() if setting not in SENSOR_SETTINGS)),
    automotive_needs=tuple(SETTINGS[setting] for setting in SENSOR_SETTINGS),
)

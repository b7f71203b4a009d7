"""How much the figures hang on amplitudes that the paper does not give: of the road's surface and of sensor errors."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby

import numpy as np

from roadgrip.units import FloatArray
from training.dataset import Runs
from training.regressor import RowIndices
from training.study.chapter import Cell as TableCell
from training.study.chapter import Chapter, Claim, Result, Table, Verdict, Workbench
from training.study.datasets import SENSITIVITY_QUICK_SIZE, SENSITIVITY_SIZE
from training.study.distributions import per_cent
from training.study.folds import FOLDS_COUNT, PAPER_SET, cross_validated
from training.study.paper.drivers import Error, error_of, ordered_rows
from training.study.picture import Axis, Bars
from training.study.recipes import PAPER_RECIPE, SPEED_ONLY_RECIPE, Recipe
from training.study.wording import by_grade, leading_grade
from vehicle_client.simulator.plan import SensorGrade

USUAL = "as usual"
SETTINGS: Mapping[str, str] = {
    "roughness halved": "roughness-halved",
    "roughness doubled": "roughness-doubled",
    "sensor errors halved": "sensors-halved",
    "sensor errors doubled": "sensors-doubled",
}
SENSOR_SETTINGS = ("sensor errors halved", "sensor errors doubled")
RECIPES = {"78 features": PAPER_RECIPE, "speed only": SPEED_ONLY_RECIPE}


def first_rows(runs: Runs, *, kept_count: int) -> RowIndices:
    """Return the first usable rows of every scenario at every base friction, by the number of the attempt.

    Args:
        runs: The table.
        kept_count: How many of each, at most.
    """
    hundredths = np.rint(100.0 * runs.labels["base_friction_mu"]).astype(np.intp)

    def cell(row: int) -> tuple[str, int]:
        return runs.scenario[row], int(hundredths[row])

    rows = sorted(
        np.flatnonzero(runs.usable).tolist(), key=lambda row: (*cell(row), runs.labels["attempt_number"][row])
    )
    return np.array([row for _, group in groupby(rows, key=cell) for row in list(group)[:kept_count]], dtype=np.intp)


def compute(bench: Workbench, grade: SensorGrade) -> Result:
    """Return the errors in every setting, learned and judged within it, with one grade of sensors."""
    found = {(USUAL, name): _error(bench, grade, None, recipe) for name, recipe in RECIPES.items()}
    # Exact sensors twice as exact are the same drives: nothing to drive.
    settings = [name for name in SETTINGS if grade is not SensorGrade.IDEAL or name not in SENSOR_SETTINGS]
    for done, setting in enumerate(settings):
        found |= {(setting, name): _error(bench, grade, SETTINGS[setting], recipe) for name, recipe in RECIPES.items()}
        bench.report(f"amplitudes, {grade}", done + 1, len(settings))
    figures = {f"mape.{name}.{setting}": error.mape_ratio for (setting, name), error in found.items()}
    figures |= {f"relative_rms.{name}.{setting}": error.relative_rms_ratio for (setting, name), error in found.items()}
    figures |= {
        f"change.{setting}": found[setting, "78 features"].mape_ratio / found[USUAL, "78 features"].mape_ratio - 1.0
        for setting in settings
    }
    return Result(
        figures=figures,
        sizes={
            "kept runs per cell": _kept_count(bench),
            "folds": FOLDS_COUNT,
            "seed": bench.seed,
            **{f"runs, {setting}": found[setting, "78 features"].rows_count for setting in (USUAL, *settings)},
        },
        tables=(_table(found, (USUAL, *settings)),),
        pictures=(
            Bars(
                f"MAPE at other amplitudes, {grade} sensors",
                "amplitudes",
                Axis("MAPE in %", low=0.0),
                (USUAL, *settings),
                tuple(
                    (name, tuple(per_cent(found[setting, name].mape_ratio) for setting in (USUAL, *settings)))
                    for name in RECIPES
                ),
            ),
        ),
    )


def _kept_count(bench: Workbench) -> int:
    return (SENSITIVITY_QUICK_SIZE if bench.quick else SENSITIVITY_SIZE).runs_count


def _error(bench: Workbench, grade: SensorGrade, data_set: str | None, recipe: Recipe) -> Error:
    """Return the cross-validated errors on a data set; on as many runs of the paper's set without one."""
    runs = bench.runs(data_set or PAPER_SET, grade)
    chosen = runs.rows(first_rows(runs, kept_count=_kept_count(bench)))
    rows = ordered_rows(chosen)

    def work() -> dict[str, FloatArray]:
        judged = cross_validated(
            recipe.learn,
            chosen.columns(recipe.features)[rows],
            chosen.labels["label_mu"][rows],
            seed=bench.seed,
        )
        return {"estimate_mu": judged.estimate_mu}

    kept = bench.remembered(f"amplitudes-{data_set or 'usual'}-{grade}-{recipe.key}-{bench.seed}", work)
    return error_of(chosen, rows, kept["estimate_mu"])


def _table(found: Mapping[tuple[str, str], Error], settings: tuple[str, ...]) -> Table:
    rows: list[tuple[TableCell, ...]] = []
    for setting in settings:
        error, speed = found[setting, "78 features"], found[setting, "speed only"]
        rows.append(
            (
                setting,
                per_cent(error.mape_ratio),
                per_cent(error.mape_ratio / found[USUAL, "78 features"].mape_ratio - 1.0),
                per_cent(error.relative_rms_ratio),
                per_cent(error.worst_mape_ratio),
                error.worst_scenario,
                per_cent(speed.mape_ratio),
                error.rows_count,
            )
        )
    return Table(
        "Errors at other amplitudes, learned and judged within each",
        (
            "amplitudes",
            "MAPE %",
            "change %",
            "relative RMS %",
            "worst scenario %",
            "which",
            "speed only, MAPE %",
            "runs",
        ),
        tuple(rows),
        note=(
            "The same drivers, tyres and draws of chance throughout. Few runs, so all errors are larger than those of "
            "the whole data set; what counts is the change. Roughness: heights of the surface, whose usual spectrum is "
            "the middle of class A of ISO 8608; doubling them is the middle of class B. Sensor errors include those of "
            "the map."
        ),
    )


def verdict(results: Mapping[SensorGrade, Result]) -> Verdict:
    """Return how much of the figures is a matter of amplitudes."""
    rough = by_grade(results, "change.roughness doubled")
    smooth = by_grade(results, "change.roughness halved")
    text = (
        "The paper adds noise like that of good asphalt and gives no amplitude, so how near any figure comes to its "
        f"own is partly a matter of what is assumed. Roads twice as uneven change the MAPE by {rough}, roads half as "
        f"uneven by {smooth}."
    )
    if SensorGrade.AUTOMOTIVE in results:
        figures = results[SensorGrade.AUTOMOTIVE].figures
        text += (
            f" Sensor errors twice as large change it by {100.0 * figures['change.sensor errors doubled']:.3g} %, half "
            f"as large by {100.0 * figures['change.sensor errors halved']:.3g} % (automotive)."
        )
    lead = results[leading_grade(results)].figures
    largest = max(
        (name for name in SETTINGS if f"change.{name}" in lead),
        key=lambda name: abs(lead[f"change.{name}"]),
    )
    text += f" The strongest of them with {leading_grade(results)} sensors: {largest}."
    return Verdict(Claim.NOT_CLAIMED, text)


CHAPTER = Chapter(
    name="sensitivity",
    title="Amplitudes of road and sensors",
    paper_says=(
        "Noise is added that is similar to driving on good asphalt; its amplitude is not given, and other amplitudes "
        "are not tried."
    ),
    compute=compute,
    verdict=verdict,
    needs=(PAPER_SET, *SETTINGS.values()),
)

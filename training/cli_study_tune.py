"""The command that searches for the best regressor's settings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from training.cli_designs import AsJson, console, progress_bar
from vehicle_client.simulator.plan import SensorGrade

# Trees take seconds to import: they are where they are needed.
if TYPE_CHECKING:
    from training.study.tuning import Tuned

DEFAULT_TRIALS_COUNT = 40
DEFAULT_MINUTES = 30.0
DEFAULT_ROADS_COUNT = 400
DEFAULT_WORK = Path("build/study")
DEFAULT_QUICK_WORK = Path("build/study-quick")
DEFAULT_OUT = Path("docs/results/study/tuning.json")
JOURNAL_NAME = "tuning.journal"


def tune_recipe(
    *,
    quick: Annotated[bool, typer.Option("--quick", help="On the small data sets.")] = False,
    sensors: Annotated[
        list[SensorGrade] | None,
        typer.Option("--sensors", help="Only this grade of sensors; repeatable.", show_default="both"),
    ] = None,
    trials: Annotated[
        int, typer.Option(metavar="N", min=1, help="Settings to try in all, those of earlier searches included.")
    ] = DEFAULT_TRIALS_COUNT,
    minutes: Annotated[
        float, typer.Option(metavar="N", min=0.0, help="Begin no further trial after so long.")
    ] = DEFAULT_MINUTES,
    roads: Annotated[
        int, typer.Option(metavar="N", min=1, help="Random roads to search on, half of all there are at most.")
    ] = DEFAULT_ROADS_COUNT,
    seed: Annotated[int, typer.Option(metavar="N", min=1, help="Of the study and of the search.")] = 1,
    work: Annotated[
        Path | None,
        typer.Option(
            "--work",
            metavar="FOLDER",
            help="Where the study's drives lie, and the search's journal.",
            show_default=f"{DEFAULT_WORK}, {DEFAULT_QUICK_WORK} with --quick",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="For what was found.",
            show_default=f"{DEFAULT_OUT}; with --quick a file inside --work",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Search for the settings of the best regressor, on random roads; goes on where it was stopped.

    What is found is held against what the search began with on roads of which it knows nothing.

    Example: roadgrip-train study tune --trials 60 --minutes 45
    """
    from training.study.folds import RANDOM_ROADS_SET
    from training.study.recipes import BEST_RECIPE
    from training.study.tuning import document_of, grounds_of, tune
    from training.study.workbench import StudyWorkbench

    folder = work or (DEFAULT_QUICK_WORK if quick else DEFAULT_WORK)
    bench = StudyWorkbench(folder, quick=quick, seed=seed)
    with progress_bar() as bar:
        task = bar.add_task("driving what is missing", total=None, rate="")
        grades = [grade for grade in SensorGrade if grade in (sensors or SensorGrade)]
        grounds = {
            grade: grounds_of(bench.runs(RANDOM_ROADS_SET, grade), BEST_RECIPE.features, roads_count=roads, seed=seed)
            for grade in grades
        }
        bar.update(task, description="trying settings", total=trials)

        def show(done_count: int, score_ratio: float) -> None:
            bar.update(task, completed=done_count, rate=f"{100.0 * score_ratio:.2f} %")

        found = tune(
            BEST_RECIPE,
            grounds,
            folder / JOURNAL_NAME,
            trials_count=trials,
            limit_s=60.0 * minutes,
            seed=seed,
            on_trial=show,
        )
    document = document_of(found, grounds, seed=seed)
    place = out or (folder / DEFAULT_OUT.name if quick else DEFAULT_OUT)
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    if as_json:
        typer.echo(json.dumps(document))
        return
    _print(found)
    typer.echo(str(place))
    if not found.improved:
        console.print("[yellow]warning:[/yellow] on the other roads what was found is no better", highlight=False)


def _print(found: Tuned) -> None:
    table = Table("MAPE, %", "began with", "found", title=f"{found.trials_count} settings tried", title_justify="left")
    for where, errors in (("searched on", found.searched_mape_ratio), ("other roads", found.other_mape_ratio)):
        for grade, (start, best) in errors.items():
            table.add_row(f"{where}, {grade.value}", f"{100.0 * start:.2f}", f"{100.0 * best:.2f}")
    Console().print(table)
    parameters = found.learn.parameters
    typer.echo(
        f"{parameters.trees_count} trees of depth {parameters.depth_count}, learning rate "
        f"{parameters.learning_rate_ratio:g}, {100.0 * parameters.row_share_frac:.0f} % of the rows and "
        f"{100.0 * parameters.column_share_frac:.0f} % of the features each, at a branching "
        f"{100.0 * parameters.node_column_share_frac:.0f} % of those, at least {parameters.leaf_rows_count:g} rows in "
        f"a leaf, weights by certainty to the power {parameters.certainty_power_ratio:g}, of {parameters.target.value}"
        f"{', relative to the truth' if found.learn.relative else ''}"
    )

"""`roadgrip-train default-bundle` and `card`: the bundle that comes with roadgrip, and what a bundle says of itself."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.progress import Progress

from roadgrip.bundle import MANIFEST_NAME
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError
from training.accuracy import FEWEST_ROADS
from training.bundle_card import CARD_NAME, card_of
from training.cars import Garage
from training.cells import cells_of
from training.cli_designs import (
    DEFAULT_SEED,
    AsJson,
    RunsCount,
    Seed,
    Workers,
    drive,
    print_cells,
    progress_bar,
    title_of,
)
from training.dataset import Runs, joined
from training.designs import EXACT_SUFFIX, Size, named_design
from training.fit_parameters import FitParameters
from training.friction_profiles import HIGHER_BY_MU
from training.marked_tables import marks_of, with_tables
from training.scenarios import Design, Terms
from vehicle_client.simulator.plan import SensorGrade

# Trees and mixtures take seconds to import: they are where they are needed.
if TYPE_CHECKING:
    from training.bundle_making import Show

BUNDLE_NAME = "roadgrip-global"
DEFAULT_BUNDLE_FOLDER = Path(str(files("rsu_app") / "default_bundle"))
DEFAULT_RUNS_COUNT = 160
DEFAULT_RANDOM_ROADS_COUNT = 360
RANDOM_RUNS_COUNT = 2
FRESH_ROADS_SHARE = 1 / 6
"""Roads that only judge, for every random road that is learned from."""
FEWEST_FRESH_ROADS = 4
FRESH_RUNS_COUNT = 2
EXACT_ROADS_SHARE = 0.5
"""Roads that are driven with exact sensors, too, for every random road."""
ROADS_PER_GROUP = 15
"""Random roads for each group of cars that drive them."""
FRESH_CARS: Mapping[str, tuple[SensorGrade, bool]] = {
    "automotive": (SensorGrade.AUTOMOTIVE, False),
    "automotive_remembering": (SensorGrade.AUTOMOTIVE, True),
    "ideal": (SensorGrade.IDEAL, False),
}
"""Who drives the roads that only judge: sensors, and whether the cars have learned what theirs get wrong. The drives
are the same for all."""
DESIGN_NAME = "default-bundle"
_TOOLS = ("roadgrip", "numpy", "scikit-learn", "xgboost-cpu", "onnx", "onnxmltools", "onnxruntime")
_INTENDED_USE = (
    "the demo, and a first unit on a curve of an ordinary rural road. It is a starting point for a road authority's "
    "own model, not a substitute for one"
)
_LIMITS = (
    "learned from simulated drives alone, of one kind of car (an XC90) that declares its masses and tyres rightly, on "
    "maps as surveyed; a car that uses little of the grip there is says little about how much there would be"
)


def default_bundle(
    *,
    out: Annotated[
        Path, typer.Option("--out", help="Folder for the bundle.", show_default="the packaged bundle's")
    ] = DEFAULT_BUNDLE_FOLDER,
    work: Annotated[Path, typer.Option("--work", help="Folder for the runs; goes on where it was.")] = Path(
        "build/default-bundle"
    ),
    runs: RunsCount = DEFAULT_RUNS_COUNT,
    random_roads: Annotated[int, typer.Option(min=FEWEST_ROADS, help="Random roads.")] = DEFAULT_RANDOM_ROADS_COUNT,
    seed: Seed = DEFAULT_SEED,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Remake the bundle that comes with roadgrip: simulate, fit, judge, export, bundle.

    The paper's three roads with many vehicles, random roads with a few, drivers of any speed and turns of different
    friction among them, automotive sensors. A model for each feature table, each with the error to expect of it. Other
    random roads only judge.
    """
    from training.bundle_making import failed_words, made_bundle
    from training.table_models import best_plan, learned_drives, paper_plan

    command = f"roadgrip-train default-bundle --runs {runs} --random-roads {random_roads} --seed {seed}"
    size = Size(runs, random_roads_count=random_roads, random_runs_count=RANDOM_RUNS_COUNT)
    fresh_size = Size(
        FRESH_RUNS_COUNT, random_roads_count=max(FEWEST_FRESH_ROADS, round(FRESH_ROADS_SHARE * random_roads))
    )
    terms = Terms(DESIGN_NAME, seed, SensorGrade.AUTOMOTIVE, garage=_half_schooled(random_roads))
    design = named_design(DESIGN_NAME, terms, size)
    usual = drive(design, work / "runs", workers=workers, command=command)
    exact = drive(_exact_design(seed, size), work / "exact", workers=workers, command=command)
    driven = joined([usual, exact])
    fresh = {
        # Other roads than those above.
        name: drive(
            named_design(
                "random-roads",
                Terms("random-roads", seed + 1, grade, garage=_garage(fresh_size, schooled=schooled)),
                fresh_size,
            ),
            work / f"fresh-{name}",
            workers=workers,
            command=command,
        )
        for name, (grade, schooled) in FRESH_CARS.items()
    }
    judging = {f"fresh_roads_{name}": some.rows(np.flatnonzero(some.usable)) for name, some in fresh.items()}
    with progress_bar() as bar:
        manifest = made_bundle(
            learned_drives(driven, seed=FitParameters().seed),
            (best_plan(seed=FitParameters().seed), paper_plan(FitParameters())),
            out,
            name=BUNDLE_NAME,
            fresh=judging,
            unseen=judging["fresh_roads_automotive"],
            provenance={
                "command": command,
                "intended_use": _INTENDED_USE,
                "limits": _LIMITS,
                "learned_from": _learned_from(driven, size, exact_count=len(exact)),
                "failed": failed_words(driven),
                "judged_on": (
                    "drives on the three roads by regressors that had not seen the drive, on random roads by such that "
                    f"had not seen the road; {fresh_size.random_roads_count} fresh roads by the finished models"
                ),
                "dataset_digest": driven.digest(),
                **tools_provenance(),
            },
            with_references=True,
            show=shown_on(bar),
        ).manifest
    if as_json:
        typer.echo(json.dumps({"bundle_id": manifest.bundle_id, "folder": str(out), "metrics": manifest.metrics}))
        return
    print_cells(usual, cells_of(usual), title=title_of(work / "runs"))
    typer.echo(f"{card_of(manifest)}\nbundle {manifest.name} {manifest.bundle_id} in {out}")


def card(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="Folder of a bundle.")],
    *,
    into: Annotated[
        Path | None, typer.Option("--into", metavar="PAGE", help="Write it between the marks of this page instead.")
    ] = None,
) -> None:
    """Print the card of a bundle as Markdown: what it is for, what it learned from, how good it is and where not.

    Example: roadgrip-train card build/bundle
    """
    path = bundle / MANIFEST_NAME
    if not path.is_file():
        raise BundleError(f"no bundle in {bundle}: it has no {MANIFEST_NAME}")
    text = card_of(manifest_from_json(path.read_text(encoding="utf-8")))
    if into is None:
        typer.echo(text)
        return
    page = into.read_text(encoding="utf-8")
    if CARD_NAME not in marks_of(page):
        raise BundleError(f"{into} has no marks of the table {CARD_NAME}")
    into.write_text(with_tables(page, {CARD_NAME: text}.get), encoding="utf-8")


def shown_on(bar: Progress) -> Show:
    """Return what shows each stage of the making of a bundle as a bar."""

    def begin(title: str, steps_count: int) -> Callable[[int], None]:
        task = bar.add_task(title, total=steps_count, rate="")
        return lambda done: bar.update(task, completed=done)

    return begin


def tools_provenance() -> dict[str, str]:
    """Return what a bundle was made with."""
    return {"python": platform.python_version(), **{f"version.{tool}": _version_of(tool) for tool in _TOOLS}}


def _exact_design(seed: int, size: Size) -> Design:
    """Return drives on some of the random roads with exact sensors: models that never saw any expect too much noise."""
    roads_count = max(FEWEST_ROADS, round(EXACT_ROADS_SHARE * size.random_roads_count))
    terms = Terms(f"{DESIGN_NAME}-exact", seed, SensorGrade.IDEAL)
    design = named_design("random-roads", terms, Size(1, random_roads_count=roads_count))
    named = tuple(replace(scenario, name=f"{scenario.name}{EXACT_SUFFIX}") for scenario in design.scenarios)
    return replace(design, scenarios=named)


def _half_schooled(random_roads_count: int) -> Garage:
    """Return cars half of which have learned what their sensors get wrong, as a unit meets new ones and old ones."""
    half_count = max(1, random_roads_count // (2 * ROADS_PER_GROUP))
    return Garage(2 * half_count, half_count)


def _garage(size: Size, *, schooled: bool) -> Garage:
    groups_count = max(1, size.random_roads_count // ROADS_PER_GROUP)
    return Garage(groups_count, groups_count if schooled else 0)


def _learned_from(driven: Runs, size: Size, *, exact_count: int) -> str:
    quarter_count, few_count = -(-size.runs_count // 4), -(-size.random_runs_count // 4)
    return (
        f"{len(driven)} simulated drives: at each of 11 base frictions the paper's three roads with {size.runs_count} "
        f"usual vehicles and {quarter_count} of any speed, {size.random_roads_count} random roads with "
        f"{size.random_runs_count} and {few_count}, what has two like turns once more with {HIGHER_BY_MU} more "
        "friction in one of them; one kind of car (an XC90), automotive sensors, half of the cars remember what theirs "
        "get wrong, maps as surveyed, prudent drivers, tyre wear 0.8 to 1; of all drives "
        f"{exact_count} have exact sensors and maps"
    )


def _version_of(distribution: str) -> str:
    try:
        return version(distribution)
    except ModuleNotFoundError:
        return "not installed under this name"

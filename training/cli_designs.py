"""The commands that drive designs and say what became of them."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from roadgrip.sections import read_section
from training import simulation
from training.cells import Cell, by_friction, cells_of, to_json, to_text
from training.dataset import RUNS_FILE_NAME, SHARDS_FOLDER_NAME, DatasetError, Runs, read_description, read_runs
from training.designs import DESIGNS, Size, named_design, sections_design
from training.machine import origin_of_drives
from training.scenarios import Design, Terms
from vehicle_client.simulator.plan import DriverKind, SensorGrade

DEFAULT_DESIGN = "paper"
DEFAULT_SEED = 20_260_701
SECTIONS_DESIGN_NAME = "sections"
PICTURES = (".svg", ".png", ".pdf")
_MOST_ROWS_COUNT = 100
_RAW_BYTES_PER_S = 10_000.0

console = Console(stderr=True)

Grade = Annotated[
    SensorGrade, typer.Option("--sensors", help="ideal: the paper's setting. automotive: what a car has.")
]
Kind = Annotated[
    DriverKind, typer.Option("--driver", help="prudent: also judges the surface by its looks. reacting: does not.")
]
RunsCount = Annotated[
    int, typer.Option("--runs", metavar="N", min=1, help="Runs per cell: kept ones where the design asks for them.")
]
Seed = Annotated[
    int, typer.Option("--seed", metavar="N", min=0, help="Changes every run; the same seed gives the same runs.")
]
Workers = Annotated[
    int | None, typer.Option("--workers", metavar="N", min=1, help="Processes; all processors if left out.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON, for machines.")]
CellsFile = Annotated[
    Path | None, typer.Option("--cells", metavar="FILE", help="Write the table of cells to this JSON file.")
]


def simulate(
    *,
    out: Annotated[Path, typer.Option("--out", metavar="FOLDER", help="For the Parquet files; goes on where it was.")],
    design: Annotated[
        str | None,
        typer.Option("--design", metavar="NAME", help="See `roadgrip-train designs`.", show_default=DEFAULT_DESIGN),
    ] = None,
    section: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Drive the paper's matrix on this section file instead; repeatable."),
    ] = None,
    sensors: Grade = SensorGrade.AUTOMOTIVE,
    driver: Kind = DriverKind.PRUDENT,
    runs: RunsCount = 20,
    random_roads: Annotated[
        int, typer.Option(metavar="N", min=0, help="Random roads of the designs that have some.")
    ] = 30,
    random_runs: Annotated[
        int, typer.Option(metavar="N", min=1, help="Runs per base friction on each random road of the mixed designs.")
    ] = 4,
    seed: Seed = DEFAULT_SEED,
    workers: Workers = None,
    raw: Annotated[bool, typer.Option("--raw", help="Keep traces and true motions too: megabytes per run.")] = False,
    cells: CellsFile = None,
    as_json: AsJson = False,
) -> None:
    """Drive a design and write one row of features and truth per run.

    Runs that leave the road stay in the table with their outcome. A killed run goes on where it was when the
    command is given again.

    Example: roadgrip-train simulate --design paper --sensors ideal --runs 100 --out build/ideal
    """
    size = Size(runs, random_roads_count=random_roads, random_runs_count=random_runs)
    chosen = _design(design, section or [], Terms(design or DEFAULT_DESIGN, seed, sensors, driver), size)
    _check_holds_no_other(out, chosen)
    if raw:
        _warn_of_size(chosen)
    command = _command(chosen, size, section or [], raw=raw)
    driven = drive(chosen, out, workers=workers, raw=raw, command=command)
    table = cells_of(driven, kept_wanted_count=_kept_wanted_count(out))
    if cells is not None:
        _write_json(_document({title_of(out): (out, table)}), cells)
    if as_json:
        outcomes = {name: driven.outcome.count(name) for name in sorted(set(driven.outcome))}
        infeasible_count = sum(not cell.feasible for cell in table)
        typer.echo(
            json.dumps(
                {
                    "runs_count": len(driven),
                    "outcomes": outcomes,
                    "infeasible_cells_count": infeasible_count,
                    "dataset_digest": driven.digest(),
                }
            )
        )
    else:
        print_cells(driven, table, title=title_of(out))
        typer.echo(f"{len(driven)} runs in {out}, data set {driven.digest()}")


def designs(*, as_json: AsJson = False) -> None:
    """List the designs that `simulate` drives, with what each is for.

    Example: roadgrip-train designs
    """
    if as_json:
        typer.echo(json.dumps({name: named.description for name, named in DESIGNS.items()}))
        return
    for name, named in DESIGNS.items():
        typer.echo(f"{name:<16} {named.description}")


def cells(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER", help="Folders of finished designs.")],
    *,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Write the tables to this JSON file.")
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help=f"Draw the tables: {', '.join(PICTURES)}.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say what became of finished designs, cell by cell: runs, outcomes, interventions, grip used.

    Example: roadgrip-train cells build/ideal --out build/cells.json --plot build/cells.svg
    """
    if plot is not None and plot.suffix not in PICTURES:
        raise typer.BadParameter(f"{plot} must end in one of {', '.join(PICTURES)}", param_hint="--plot")
    driven = {title: (folder, read_runs(folder)) for title, folder in _titles_of(folders).items()}
    tables = {
        title: (folder, cells_of(runs, kept_wanted_count=_kept_wanted_count(folder)))
        for title, (folder, runs) in driven.items()
    }
    if out is not None:
        _write_json(_document(tables), out)
    if plot is not None:
        from training.cell_pictures import draw_cells

        plot.parent.mkdir(parents=True, exist_ok=True)
        draw_cells({title: table for title, (_, table) in tables.items()}, plot)
    if as_json:
        typer.echo(json.dumps(_document(tables)))
        return
    for title, (_, table) in tables.items():
        print_cells(driven[title][1], table, title=title)


def drive(design: Design, folder: Path, *, workers: int | None, command: str, raw: bool = False) -> Runs:
    """Drive a design behind a progress bar and return its runs."""
    with progress_bar() as bar:
        task = bar.add_task(f"driving {design.name}, compiling first", total=None, rate="")

        def show(now: simulation.Progress) -> None:
            elapsed_s = bar.tasks[task].elapsed or 0.0
            rate = f"{now.driven_now_count / elapsed_s:.0f} drives/s" if now.driven_now_count else ""
            doing = f"driving {design.name}" if now.attempts_count else None
            bar.update(task, description=doing, total=now.wanted_count, completed=now.done_count, rate=rate)

        return simulation.drive_design(
            design,
            folder,
            workers_count=workers,
            with_drives=raw,
            provenance=origin_of_drives(command),
            on_progress=show,
        )


def print_cells(runs: Runs, table: tuple[Cell, ...], *, title: str) -> None:
    """Print a row per cell, or per base friction where there are too many cells to read."""
    infeasible = [f"{cell.scenario} at {cell.base_friction_mu:.2f}" for cell in table if not cell.feasible]
    if len(table) > _MOST_ROWS_COUNT:
        table = cells_of(by_friction(runs))
    names = ("scenario", "base", "drives", "kept", "left\nroad", "spun", "refused", "ESC", "grip\nused")
    shown = Table(*names, title=title, caption="shares in %", padding=(0, 0))
    for cell, following in zip(table, (*table[1:], None), strict=True):
        share = [cell.left_road_frac, cell.spun_frac, cell.rejected_frac, cell.esc_runs_frac]
        used = None if cell.utilisation_ratio is None else cell.utilisation_ratio["q50"]
        kept = f"{cell.kept_count}" if cell.feasible else f"{cell.kept_count} infeasible"
        shown.add_row(
            cell.scenario,
            f"{cell.base_friction_mu:.2f}",
            str(cell.attempts_count),
            kept,
            *("-" if value is None else f"{100 * value:.0f}" for value in (*share, used)),
            end_section=following is None or following.scenario != cell.scenario,
        )
    # A narrow terminal breaks lines, but never drops figures.
    terminal = Console()
    needed = Measurement.get(terminal, terminal.options.update(max_width=1000), shown).maximum
    Console(width=max(terminal.width, needed)).print(shown)
    if infeasible:
        typer.echo(f"infeasible, {len(infeasible)} cells: {', '.join(infeasible)}")


def title_of(folder: Path) -> str:
    """Return what a finished design's folder holds, in few words.

    Raises:
        DatasetError: It holds no finished design.
    """
    origin = _origin(folder)
    if "design" not in origin:
        raise DatasetError(f"{folder / RUNS_FILE_NAME} does not say which design it is")
    named = DESIGNS.get(origin["design"])
    drivers = "test" if named is not None and named.test_drivers else origin["driver_kind"]
    return f"{origin['design']}, {drivers} drivers, {origin['sensor_grade']} sensors"


def _titles_of(folders: list[Path]) -> dict[str, Path]:
    """Return folders by what they hold; those that hold the like, on two seeds perhaps, by their place as well."""
    titles = {folder: title_of(folder) for folder in folders}
    found = Counter(titles.values())
    return {title if found[title] == 1 else f"{title} ({folder})": folder for folder, title in titles.items()}


def _check_holds_no_other(folder: Path, design: Design) -> None:
    """Keep a finished table from being replaced by that of other drives; more of the same may take its place.

    Raises:
        DatasetError: The folder holds other drives.
    """
    try:
        origin = _origin(folder)
    except DatasetError:  # nothing there, or something that a crash cut short
        return
    terms = design.terms
    asked = {
        "design": design.name,
        "seed": str(terms.seed),
        "sensor_grade": terms.sensor_grade.value,
        "driver_kind": terms.driver_kind.value,
    }
    if any(origin.get(name) != value for name, value in asked.items()):
        raise DatasetError(
            f"{folder} holds other drives ({title_of(folder)}, seed {origin.get('seed')}); "
            f"choose another folder, or remove it"
        )


def _design(name: str | None, sections: list[Path], terms: Terms, size: Size) -> Design:
    if sections:
        if name is not None:
            raise typer.BadParameter("a design has its own sections; give one or the other", param_hint="--section")
        roads = tuple(read_section(path) for path in sections)
        found = Counter(road.section_id for road in roads)
        if twice := [section_id for section_id, count in found.items() if count > 1]:
            raise typer.BadParameter(f"{', '.join(twice)} is given more than once", param_hint="--section")
        return sections_design(
            roads, Terms(SECTIONS_DESIGN_NAME, terms.seed, terms.sensor_grade, terms.driver_kind), size
        )
    if terms.design_name not in DESIGNS:
        known = ", ".join(DESIGNS)
        raise typer.BadParameter(f"no design {terms.design_name!r}; there are {known}", param_hint="--design")
    if DESIGNS[terms.design_name].test_drivers and terms.driver_kind is not DriverKind.PRUDENT:
        raise typer.BadParameter(f"{terms.design_name} has test drivers of its own", param_hint="--driver")
    chosen = named_design(terms.design_name, terms, size)
    if not chosen.scenarios:
        raise typer.BadParameter(f"{terms.design_name} has nothing but random roads", param_hint="--random-roads")
    return chosen


def _command(design: Design, size: Size, sections: list[Path], *, raw: bool) -> str:
    """Return the command that drives the design anywhere, without the places of this machine."""
    terms = design.terms
    words = ["roadgrip-train simulate"]
    words += [f"--section {path.name}" for path in sections] or [f"--design {design.name}"]
    words += [f"--sensors {terms.sensor_grade.value} --driver {terms.driver_kind.value} --runs {size.runs_count}"]
    named = DESIGNS.get(design.name)
    if named is not None and named.random_roads:
        words.append(f"--random-roads {size.random_roads_count}")
    if named is not None and named.random_runs:
        words.append(f"--random-runs {size.random_runs_count}")
    words.append(f"--seed {terms.seed}")
    return " ".join([*words, *(["--raw"] if raw else [])])


def _origin(folder: Path) -> dict[str, str]:
    path = folder / RUNS_FILE_NAME
    if not path.is_file():
        begun = (folder / SHARDS_FOLDER_NAME).is_dir()
        way = "give its `roadgrip-train simulate` again" if begun else "drive one with `roadgrip-train simulate`"
        raise DatasetError(f"no finished design in {folder}; {way}")
    return read_description(path)


def _kept_wanted_count(folder: Path) -> int | None:
    text = _origin(folder).get("kept_wanted_count", "")
    return int(text) if text else None


def _document(tables: dict[str, tuple[Path, tuple[Cell, ...]]]) -> dict[str, Any]:
    return {
        "designs": [
            {"title": title, **to_json(table, origin=_origin(folder))} for title, (folder, table) in tables.items()
        ]
    }


def _write_json(document: dict[str, Any], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(to_text(document), encoding="utf-8")


def _warn_of_size(design: Design) -> None:
    per_friction = sum(
        (scenario.quota.kept_count or scenario.quota.attempts_limit_count)
        * (scenario.section.length_m + 140.0)
        / scenario.section.speed_limit_mps
        for scenario in design.scenarios
    )
    size_gb = per_friction * len(design.base_frictions_mu) * _RAW_BYTES_PER_S / 1e9
    console.print(f"[yellow]raw drives will take about {size_gb:.1f} GB, more where drives fail[/yellow]")


def progress_bar() -> Progress:
    """Return a bar with count, rate and time left; tasks have a field `rate`, which may be blank."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )

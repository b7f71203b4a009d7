"""`roadgrip-train data`: data sets of the laboratory, from simulated designs and from the road."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from roadgrip.features import TABLES, FeatureTable
from roadgrip.sections import read_section
from training.cli_designs import AsJson, Seed, Workers, drive, progress_bar
from training.cli_shelf import Lab, RefusedFile, day_of, print_refused, print_whole, write_refused
from training.data.data_shelf import DataCard, DataKind, Role, add_data_set, data_cards, read_data_set, to_json
from training.data.exported_passages import Export, RefusedPassage, read_export
from training.data.ground_truth_shelf import GroundTruthSet, ground_truth_cards, read_ground_truth_set
from training.data.hold_outs import (
    DEFAULT_RANDOM_ROADS_COUNT,
    DEFAULT_RUNS_COUNT,
    HOLD_OUT_SEED,
    HoldOut,
    hold_outs,
)
from training.data.measured_passages import (
    DEFAULT_SLACK_S,
    DEFAULT_WEAR_RATIO,
    WEAR_LIMIT_RATIO,
    Joined,
    measured_runs,
)
from training.data.shelf import ShelfError
from training.dataset import RUNS_FILE_NAME, read_description, read_runs
from training.laboratory import DEFAULT_FOLDER, Laboratory
from training.simulation import design_description

SIMULATED_LABEL = "simulated friction"
OWN_LICENCE = "Apache-2.0"
_TOLD_OF_DESIGNS = ("command", "design", "design_identity", "seed", "sensor_grade", "code_digest")

data_app = typer.Typer(
    name="data",
    help="Data sets of the laboratory: named by their content, described, never changed. docs/data-sets.md tells more.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Name = Annotated[str, typer.Option("--name", metavar="NAME", help="What to call it; no two are called the same.")]
Ref = Annotated[str, typer.Argument(metavar="REF", help="Digest, name, or beginning of a digest.")]


@data_app.command("add")
def add_command(
    runs: Annotated[Path, typer.Argument(metavar="RUNS", help="Folder of a finished design, or a Parquet file.")],
    *,
    name: Name,
    licence: Annotated[str, typer.Option("--licence", metavar="TEXT", help="Who may do what with it.")],
    role: Annotated[Role, typer.Option("--role", help="All but training are hold-outs, never learned from.")] = (
        Role.TRAINING
    ),
    origin: Annotated[
        str | None,
        typer.Option("--origin", metavar="TEXT", help="Who or what made it.", show_default="the design's command"),
    ] = None,
    lab: Lab = DEFAULT_FOLDER,
    as_json: AsJson = False,
) -> None:
    """Put simulated drives on the shelf.

    Example: roadgrip-train data add build/mixed --name mixed-2026 --licence Apache-2.0
    """
    driven, told = read_runs(runs), _told_of_design(runs)
    if origin is None and "command" not in told:
        raise typer.BadParameter(f"{runs} does not say what made it", param_hint="--origin")
    card = add_data_set(
        Laboratory(lab),
        driven,
        name=name,
        kind=DataKind.SIMULATED,
        role=role,
        origin=origin or told["command"],
        licence=licence,
        label_kind=SIMULATED_LABEL,
        made_from=told,
    )
    _print_added([card], as_json=as_json)


@data_app.command("join")
def join_command(
    *,
    ground_truth: Annotated[
        str, typer.Option("--ground-truth", metavar="REF", help="Digest or name; see `ground-truth list`.")
    ],
    export: Annotated[
        list[Path], typer.Option("--export", metavar="FILE", help="What `roadgrip-rsu export` wrote; repeatable.")
    ],
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="What to call it; -v1 or -v2 is added, for the feature table.")
    ],
    role: Annotated[Role, typer.Option("--role", help="training, or measured for a hold-out.")] = Role.TRAINING,
    slack_s: Annotated[
        float,
        typer.Option("--slack-s", metavar="S", min=0.0, help="A measurement also speaks so long before and after."),
    ] = DEFAULT_SLACK_S,
    wear_ratio: Annotated[
        float,
        typer.Option(
            "--wear-ratio", min=0.01, max=WEAR_LIMIT_RATIO, help="What a car finds of what the trailer's tyre found."
        ),
    ] = DEFAULT_WEAR_RATIO,
    table: Annotated[
        int | None,
        typer.Option("--table", metavar="N", help="Cut all rows to this feature table.", show_default="each its own"),
    ] = None,
    section: Annotated[
        list[Path] | None,
        typer.Option("--section", metavar="FILE", help="A map that no export holds any more, as a file; repeatable."),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option("--origin", metavar="TEXT", help="Where it is from.", show_default="the trailer's, and the units"),
    ] = None,
    licence: Annotated[
        str | None, typer.Option("--licence", metavar="TEXT", help="For whom.", show_default="the ground truth's")
    ] = None,
    lab: Lab = DEFAULT_FOLDER,
    refused: RefusedFile = None,
    as_json: AsJson = False,
) -> None:
    """Give passages that units exported the friction that was measured meanwhile, one data set per feature table.

    Exit code 1 if no passage got one.

    Example: roadgrip-train data join --ground-truth week-5 --export bend-7.ndjson.gz --name week-5
    """
    laboratory = Laboratory(lab)
    truth = read_ground_truth_set(laboratory, ground_truth)
    chosen_table = None if table is None else _table_of_version(table)
    exports = _read_exports(export)
    found = measured_runs(
        exports,
        truth.measurements,
        slack_s=slack_s,
        wear_ratio=wear_ratio,
        table=chosen_table,
        sections=[read_section(file) for file in section or []],
    )
    path = write_refused(laboratory, refused, name=name, text=_refused_csv(found.refused)) if found.refused else None
    made_from = _made_from(truth, exports) | {"slack_s": f"{slack_s:g}", "wear_ratio": f"{wear_ratio:g}"}
    units = ", ".join(sorted({each.head.unit for each in exports}))
    cards = [
        add_data_set(
            laboratory,
            runs,
            name=f"{name}-v{runs.table.version}",
            kind=DataKind.MEASURED,
            role=role,
            origin=origin or f"{truth.card.origin}; passages of {units}",
            licence=licence or truth.card.licence,
            label_kind=f"trailer measurement times {wear_ratio:g} for wear",
            label_sd_mu=found.label_sd_mu[digest],
            made_from=made_from,
        )
        for digest, runs in found.runs_by_table.items()
    ]
    if as_json:
        counts = {reason.value: count for reason, count in found.refused_count.items()}
        told = {"data_sets": [asdict(card) for card in cards], "refused": counts}
        typer.echo(json.dumps({**told, "refused_file": None if path is None else str(path)}))
    else:
        if path is not None:
            print_refused(_examples(found), path=path)
        _print_added(cards, as_json=False)
    if not cards:
        if not as_json:
            typer.echo("no passage got a measured friction")
        raise typer.Exit(1)


@data_app.command("list")
def list_command(*, lab: Lab = DEFAULT_FOLDER, as_json: AsJson = False) -> None:
    """List all data sets: names, digests, roles, rows.

    Example: roadgrip-train data list
    """
    cards = data_cards(Laboratory(lab))
    if as_json:
        typer.echo(json.dumps([asdict(card) for card in cards]))
        return
    tables = {each.digest: f"v{each.version}" for each in TABLES.values()}
    shown = Table("name", "digest", "role", "kind", "table", "rows", "usable", "sections", "added")
    for card in cards:
        counts = (card.rows_count, card.usable_count, len(card.sections))
        table = tables.get(card.table_digest, card.table_digest)
        shown.add_row(card.name, card.digest, card.role, card.kind, table, *map(str, counts), day_of(card.added_unix_s))
    print_whole(shown)


@data_app.command("show")
def show_command(ref: Ref, *, lab: Lab = DEFAULT_FOLDER) -> None:
    """Print the card of a data set, as JSON; its content is checked first.

    Example: roadgrip-train data show week-5-v2
    """
    typer.echo(to_json(read_data_set(Laboratory(lab), ref).card), nl=False)


@data_app.command("verify")
def verify_command(*, lab: Lab = DEFAULT_FOLDER, as_json: AsJson = False) -> None:
    """Read everything on the shelves and say whether it still is what its digest names. Exit code 1 if not.

    Example: roadgrip-train data verify
    """
    laboratory = Laboratory(lab)
    data, truths = data_cards(laboratory), ground_truth_cards(laboratory)
    read_by_digest: dict[str, Callable[[Laboratory, str], object]] = {card.digest: read_data_set for card in data}
    read_by_digest |= {card.digest: read_ground_truth_set for card in truths}
    changed: dict[str, str] = {}
    with progress_bar() as bar:
        task = bar.add_task("reading", total=len(read_by_digest), rate="")
        for digest, read in read_by_digest.items():
            try:
                read(laboratory, digest)
            except ShelfError as error:
                changed[digest] = str(error)
            bar.advance(task)
    if as_json:
        typer.echo(json.dumps({"checked_count": len(data) + len(truths), "changed": changed}))
    else:
        for problem in changed.values():
            typer.echo(problem)
        typer.echo(f"{len(data)} data sets and {len(truths)} tables of ground truth, {len(changed)} of them changed")
    if changed:
        raise typer.Exit(1)


@data_app.command("holdouts")
def holdouts_command(
    *,
    seed: Seed = HOLD_OUT_SEED,
    runs: Annotated[
        int, typer.Option("--runs", metavar="N", min=1, help="Kept runs per cell on known roads.")
    ] = DEFAULT_RUNS_COUNT,
    random_roads: Annotated[
        int, typer.Option("--random-roads", metavar="N", min=1, help="Roads that nobody learns from.")
    ] = DEFAULT_RANDOM_ROADS_COUNT,
    work: Annotated[
        Path, typer.Option("--work", metavar="FOLDER", help="Folder for the drives; goes on where it was.")
    ] = Path("build/holdouts"),
    workers: Workers = None,
    lab: Lab = DEFAULT_FOLDER,
    as_json: AsJson = False,
) -> None:
    """Drive the hold-outs that every candidate is judged on: known roads, unseen roads, manoeuvres.

    Once for a laboratory: hold-outs that are there stay as they are.

    Example: roadgrip-train data holdouts --lab lab
    """
    command = f"roadgrip-train data holdouts --seed {seed} --runs {runs} --random-roads {random_roads}"
    laboratory = Laboratory(lab)
    held = {card.name: card for card in data_cards(laboratory)}
    cards = [
        _same_hold_out(held[each.name], command)
        if each.name in held
        else _driven_hold_out(laboratory, each, work, command=command, workers=workers)
        for each in hold_outs(seed=seed, runs_count=runs, random_roads_count=random_roads)
    ]
    _print_added(cards, as_json=as_json)


def _driven_hold_out(lab: Laboratory, hold_out: HoldOut, work: Path, *, command: str, workers: int | None) -> DataCard:
    design = hold_out.design
    folder = work / f"{hold_out.name}-{design.terms.seed}"
    driven = drive(design, folder, workers=workers, command=command)
    return add_data_set(
        lab,
        driven,
        name=hold_out.name,
        kind=DataKind.SIMULATED,
        role=hold_out.role,
        origin=command,
        licence=OWN_LICENCE,
        label_kind=SIMULATED_LABEL,
        made_from={"command": command, **_told(design_description(design))},
    )


def _same_hold_out(card: DataCard, command: str) -> DataCard:
    """Return a hold-out that is there, if it is the one that is asked for."""
    made_by = card.made_from.get("command", "something else")
    if made_by != command:
        raise ShelfError(
            f"the laboratory has a hold-out {card.name} already, made by {made_by}; hold-outs are frozen, so that "
            "candidates of all times are judged alike"
        )
    return card


def _read_exports(paths: Sequence[Path]) -> list[Export]:
    exports = []
    with progress_bar() as bar:
        task = bar.add_task("reading exports", total=len(paths), rate="")
        for path in paths:
            exports.append(read_export(path))
            bar.advance(task)
    return exports


def _made_from(truth: GroundTruthSet, exports: Sequence[Export]) -> dict[str, str]:
    ledgers = {f"ledger_head.{each.head.unit}": each.head.ledger_hash for each in exports if each.head.ledger_hash}
    digests = ", ".join(sorted(each.digest for each in exports))
    return {"ground_truth": truth.card.digest, "exports": digests, **ledgers}


def _told_of_design(runs: Path) -> dict[str, str]:
    path = runs / RUNS_FILE_NAME if runs.is_dir() else runs
    return _told(read_description(path)) if path.is_file() else {}


def _told(description: dict[str, str]) -> dict[str, str]:
    return {name: description[name] for name in _TOLD_OF_DESIGNS if name in description}


def _table_of_version(number: int) -> FeatureTable:
    spoken = {table.version: table for table in TABLES.values()}
    if number not in spoken:
        known = ", ".join(str(each) for each in sorted(spoken))
        raise typer.BadParameter(f"no feature table {number}; there are {known}", param_hint="--table")
    return spoken[number]


def _examples(found: Joined) -> dict[str, tuple[int, str]]:
    first: dict[str, RefusedPassage] = {}
    for each in found.refused:
        first.setdefault(each.reason.value, each)
    return {
        reason.value: (count, f"{first[reason].export}, line {first[reason].line_number}: {first[reason].message}")
        for reason, count in found.refused_count.items()
    }


def _refused_csv(refused: Sequence[RefusedPassage]) -> str:
    written = io.StringIO()
    rows = csv.writer(written, lineterminator="\n")
    rows.writerow(["export", "line_number", "reason", "message"])
    rows.writerows([each.export, each.line_number, each.reason.value, each.message] for each in refused)
    return written.getvalue()


def _print_added(cards: Sequence[DataCard], *, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps([asdict(card) for card in cards]))
        return
    for card in cards:
        typer.echo(
            f"data set {card.name} {card.digest}: {card.usable_count} usable rows of {card.rows_count}, {card.role}"
        )

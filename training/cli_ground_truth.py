"""`roadgrip-train ground-truth`: what friction-measuring trailers found comes into the laboratory."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from training.cli_designs import AsJson
from training.cli_shelf import Lab, RefusedFile, day_of, print_refused, print_whole, write_refused
from training.data.ground_truth import RefusedRow, read_ground_truth, refused_csv, text_of_table
from training.data.ground_truth_shelf import add_ground_truth, ground_truth_cards
from training.laboratory import DEFAULT_FOLDER, Laboratory

ground_truth_app = typer.Typer(
    name="ground-truth",
    help="What friction-measuring trailers found: bring it in, list it. docs/data-sets.md has the columns.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@ground_truth_app.command("import")
def import_command(
    table: Annotated[
        Path, typer.Argument(metavar="CSV", help="section_id,from_utc,until_utc,mu,mu_sd,instrument[,note]")
    ],
    *,
    origin: Annotated[str, typer.Option("--origin", metavar="TEXT", help="Who measured.")],
    licence: Annotated[str, typer.Option("--licence", metavar="TEXT", help="Who may do what with it.")],
    name: Annotated[
        str | None, typer.Option("--name", metavar="NAME", help="What to call it.", show_default="the file's name")
    ] = None,
    lab: Lab = DEFAULT_FOLDER,
    refused: RefusedFile = None,
    as_json: AsJson = False,
) -> None:
    """Check a trailer's table and keep what can be used; refused rows are told with their reasons.

    Exit code 1 if all of them are refused.

    Example: roadgrip-train ground-truth import week-5.csv --origin "county road authority" --licence CC-BY-4.0
    """
    laboratory = Laboratory(lab)
    content = table.read_bytes()
    truth = read_ground_truth(text_of_table(content), now_unix_s=time.time())
    called = name or table.stem.lower().replace(" ", "-")
    examples = _examples(truth.refused)
    path = write_refused(laboratory, refused, name=called, text=refused_csv(truth.refused)) if truth.refused else None
    card = None
    if truth.measurements:
        card = add_ground_truth(laboratory, truth, name=called, origin=origin, licence=licence, source=content)
    if as_json:
        counts = {reason: count for reason, (count, _) in examples.items()}
        told = {"card": None if card is None else asdict(card), "refused": counts}
        typer.echo(json.dumps({**told, "refused_file": None if path is None else str(path)}))
    else:
        if path is not None:
            print_refused(examples, path=path)
        if card is None:
            typer.echo(f"nothing of {table} can be used")
        else:
            typer.echo(
                f"ground truth {card.name} {card.digest}: {card.measurements_count} measurements on "
                f"{len(card.sections)} sections"
            )
    if card is None:
        raise typer.Exit(1)


@ground_truth_app.command("list")
def list_command(*, lab: Lab = DEFAULT_FOLDER, as_json: AsJson = False) -> None:
    """List what trailers found: names, digests, sections, times.

    Example: roadgrip-train ground-truth list
    """
    cards = ground_truth_cards(Laboratory(lab))
    if as_json:
        typer.echo(json.dumps([asdict(card) for card in cards]))
        return
    shown = Table("name", "digest", "measurements", "sections", "from", "until", "licence")
    for card in cards:
        shown.add_row(
            card.name,
            card.digest,
            str(card.measurements_count),
            str(len(card.sections)),
            day_of(card.from_unix_s),
            day_of(card.until_unix_s),
            card.licence,
        )
    print_whole(shown)


def _examples(refused: tuple[RefusedRow, ...]) -> dict[str, tuple[int, str]]:
    """Return how many rows were refused by reason, and what was said of the first of each."""
    found: dict[str, tuple[int, str]] = {}
    for row in refused:
        count, example = found.get(row.reason.value, (0, f"line {row.line_number}: {row.message}"))
        found[row.reason.value] = (count + 1, example)
    return found

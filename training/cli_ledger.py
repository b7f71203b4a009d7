"""`roadgrip-train ledger`: what was done to models, by whom and why."""

from __future__ import annotations

import json
import re
from datetime import UTC, datetime
from typing import Annotated

import typer

from roadgrip.errors import RoadgripError
from roadgrip.ledger import LedgerEntry, LedgerError, chain_problems, entry_to_json
from training.cli_designs import AsJson
from training.cli_promote import SHORT_ID_CHARS, LabFolder
from training.laboratory import DEFAULT_FOLDER, Laboratory

_DIGEST = re.compile(r"[0-9a-f]{64}")

ledger_app = typer.Typer(
    name="ledger",
    help="Read the laboratory's ledger, and check that nobody mended it.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@ledger_app.command(name="show")
def ledger_show(
    *,
    lab: LabFolder = DEFAULT_FOLDER,
    limit: Annotated[int | None, typer.Option("--limit", min=1, metavar="N", help="Only the newest.")] = None,
    entry: Annotated[
        str | None, typer.Option("--entry", metavar="HASH", help="Only this one, by the beginning of its hash.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List who did what to which bundle, when and why; JSON is one entry a line, with its hash.

    Example: roadgrip-train ledger show --limit 10
    """
    entries = Laboratory(lab).ledger()
    shown = entries if limit is None else entries[-limit:]
    if entry is not None:
        shown = [each for each in entries if each.entry_hash.startswith(entry.lower())]
        if not shown:
            raise LedgerError(f"no entry has a hash that begins with {entry[:80]!r}")
    if as_json:
        typer.echo("".join(f"{entry_to_json(entry)}\n" for entry in shown), nl=False)
        return
    for each in shown:
        when = f"{datetime.fromtimestamp(each.at_unix_s, tz=UTC):%Y-%m-%d %H:%M:%S} UTC"
        evidence = ", ".join(f"{name} {_short(value)}" for name, value in each.evidence.items())
        typer.echo(f"{each.sequence_number}. {when}, {each.actor}: {each.action.value} {each.subject}")
        typer.echo("".join(f"   {line}\n" for line in (each.reason, evidence) if line), nl=False)
    if entries:
        typer.echo(f"head: {entries[-1].entry_hash}")


@ledger_app.command(name="verify")
def ledger_verify(
    *,
    lab: LabFolder = DEFAULT_FOLDER,
    head: Annotated[
        list[str] | None,
        typer.Option("--head", metavar="HASH", help="A hash that was told elsewhere; again for more."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check the chain of the ledger, and that it holds every release of the repository; exit code 1 with problems.

    Example: roadgrip-train ledger verify --head 5d41402abc4b2a76b9719d911017c592...
    """
    laboratory = Laboratory(lab)
    try:
        entries = laboratory.ledger()
    except LedgerError as error:
        entries, problems = [], [str(error)]
    else:
        problems = [*chain_problems(entries, known_heads=head or ()), *_beginning_problems(entries)]
        problems += _release_problems(laboratory, entries)
    last = entries[-1].entry_hash if entries else None
    if as_json:
        typer.echo(json.dumps({"entries_count": len(entries), "head": last, "problems": problems}))
    else:
        typer.echo("".join(f"{problem}\n" for problem in problems), nl=False)
        if not problems:
            typer.echo(f"{len(entries)} entries hold together" + (f"; head {last}" if last else ""))
    if problems:
        raise typer.Exit(1)


def _short(value: str) -> str:
    return " ".join(f"{word[:SHORT_ID_CHARS]}…" if _DIGEST.fullmatch(word) else word for word in value.split(" "))


def _beginning_problems(entries: list[LedgerEntry]) -> list[str]:
    # A unit's ledger may have been cut by its budget; a laboratory's never is.
    cut = bool(entries) and entries[0].sequence_number != 1
    return [f"the ledger begins with entry {entries[0].sequence_number}"] if cut else []


def _release_problems(lab: Laboratory, entries: list[LedgerEntry]) -> list[str]:
    from training.promotion.publication import ledger_problems

    try:
        return ledger_problems(lab, entries)
    except RoadgripError as error:
        return [f"the repository cannot be asked: {error}"]

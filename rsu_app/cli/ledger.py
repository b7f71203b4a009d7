"""`roadgrip-rsu ledger`: what was done to the models of a unit, and whether that record was tampered with."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from roadgrip.ledger import LedgerEntry, LedgerError, entry_to_json, provenance_at
from rsu_app.moments import shown_moment, unix_s_of
from rsu_app.settings import CONFIG_VARIABLE, load_settings

SHOWN_HASH_CHARS = 12
WHOLE_LEDGER_COUNT = 100_000
"""As many entries as a unit keeps."""
NOT_WHOLE = 1

ledger_app = typer.Typer(
    help="Look at what was done to the models of this unit: when, by whom, why.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

ConfigFile = Annotated[
    Path | None, typer.Option("--config", "-c", envvar=CONFIG_VARIABLE, help="TOML file with settings.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Write JSON for a machine.")]


@ledger_app.command("show")
def show_ledger(
    *,
    limit: Annotated[int, typer.Option("--limit", "-n", min=1, help="So many of the newest entries.")] = 20,
    config_file: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Show the newest entries, newest first. The unit may run meanwhile.

    **Example**

        roadgrip-rsu ledger show --limit 5
    """
    from rsu_app.records_wiring import ledger_entries

    settings = load_settings(config_file)
    entries = ledger_entries(settings, limit_count=limit)
    if as_json:
        told = [json.loads(entry_to_json(entry)) for entry in entries]
        typer.echo(json.dumps({"unit": settings.export.unit_name, "entries": told}, indent=1))
        return
    table = Table("no.", "when", "who", "what", "which", "why", "hash")
    for entry in entries:
        table.add_row(
            str(entry.sequence_number),
            shown_moment(entry.at_unix_s),
            _shown(entry.actor),
            entry.action.value,
            _shown(entry.subject),
            _grounds(entry),
            _shown(entry.entry_hash[:SHOWN_HASH_CHARS]),
        )
    Console().print(table)


@ledger_app.command("at")
def ledger_at(
    moment: Annotated[
        str, typer.Argument(metavar="ISO", help="Such as `2026-01-31T06:00Z`; without a zone it is UTC.")
    ],
    *,
    config_file: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Say which bundle was live at a moment of the past, who let it out, and on what evidence.

    The laboratory knows the rest by the hash: `roadgrip-train ledger show --entry HASH`.

    **Example**

        roadgrip-rsu ledger at 2026-01-31T06:00Z
    """
    from rsu_app.records_wiring import ledger_entries

    try:
        at_unix_s = unix_s_of(moment)
    except ValueError as error:
        raise LedgerError(f"{moment[:40]!r} is no moment: {error}") from error
    entries = ledger_entries(load_settings(config_file), limit_count=WHOLE_LEDGER_COUNT)
    found = provenance_at(entries[::-1], at_unix_s)
    if found is None:
        typer.echo(f"the ledger knows of no live bundle before {shown_moment(at_unix_s)}")
        raise typer.Exit(NOT_WHOLE)
    if as_json:
        told = {
            name: None if entry is None else json.loads(entry_to_json(entry))
            for name, entry in (("live", found.live), ("installed", found.installed))
        }
        typer.echo(json.dumps(told, indent=1))
        return
    console = Console(soft_wrap=True)
    console.print(_shown(f"bundle {found.live.subject}, live since {shown_moment(found.live.at_unix_s)}"))
    console.print(_shown(f"{found.live.action.value} by {found.live.actor}: {found.live.reason}"))
    if found.installed is None:
        console.print("the unit was delivered with it, or its settings name it")
    else:
        console.print(_shown(f"installed {shown_moment(found.installed.at_unix_s)} by {found.installed.actor}:"))
        console.print(_grounds(found.installed))


@ledger_app.command("verify")
def verify_ledger(
    *,
    heads: Annotated[
        list[str] | None,
        typer.Option("--head", metavar="HASH", help="A head of this ledger that an export told; may be repeated."),
    ] = None,
    config_file: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Say whether the ledger holds together; exit code 1 if an entry was changed, left out or slipped in.

    A ledger whose newest entries were cut off still holds together. Whoever has an old head finds out with `--head`.

    **Example**

        roadgrip-rsu ledger verify --head 9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08
    """
    from rsu_app.records_wiring import verdict_on_ledger

    known_heads = [_hash(head) for head in heads or ()]
    settings = load_settings(config_file)
    # A full ledger takes seconds; said on the other channel, and to a person only.
    with Console(stderr=True).status("verifying"):
        verdict = verdict_on_ledger(settings, known_heads=known_heads)
    if as_json:
        told = {
            "ok": not verdict.problems,
            "entries_count": verdict.entries_count,
            "head": verdict.head_hash,
            "problems": verdict.problems,
        }
        typer.echo(json.dumps(told, indent=1))
    elif verdict.problems:
        for problem in verdict.problems:
            typer.echo(problem)
    else:
        typer.echo(f"{verdict.entries_count} entries hold together; the head is {verdict.head_hash or 'not there yet'}")
    raise typer.Exit(NOT_WHOLE if verdict.problems else 0)


def _hash(text: str) -> str:
    if not re.fullmatch(r"[0-9a-fA-F]{64}", text):
        raise LedgerError(f"--head: {text[:80]!r} is no hash of an entry, which has 64 hexadecimal digits")
    return text.lower()


def _grounds(entry: LedgerEntry) -> Text:
    lines = [entry.reason, *(f"{name}: {value}" for name, value in entry.evidence.items())]
    return Text("\n").join(_shown(line) for line in lines if line)


def _shown(text: str) -> Text:
    """Return a text as it may go to a terminal: what others wrote is no markup and moves no cursor."""
    return Text("".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text))

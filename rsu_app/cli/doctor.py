"""`roadgrip-rsu doctor`: what keeps a box from serving its road, and what mends it."""

from __future__ import annotations

import json
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from rsu_app.cli.rollout import AsJson, ConfigFile
from rsu_app.doctor.findings import Finding, Level, exit_code

BACKUPS = Path("/var/backups/roadgrip")
_STYLES = {Level.OK: "green", Level.WARN: "yellow", Level.FAIL: "bold red"}


def doctor(
    config_file: ConfigFile = None,
    *,
    offline: Annotated[bool, typer.Option("--offline", help="Do not look at the repository of releases.")] = False,
    backups: Annotated[Path, typer.Option("--backups", help="Folder where backups are put.")] = BACKUPS,
    as_json: AsJson = False,
) -> None:
    """Examine this box, with the unit running or not: what was seen of each thing, and what mends it.

    Reads the whole database and writes a small file beside it, which it removes. Give it as the unit's account.
    Exit code 0 if all is well, 1 with warnings, 2 with failures.
    """
    from rsu_app.doctor.examination import examine

    told = Console(stderr=True)
    with told.status("looking ...") if told.is_terminal and not as_json else nullcontext() as spinner:
        findings = list(
            examine(
                config_file,
                visit=not offline,
                backups=backups,
                on_step=lambda step: spinner.update(f"looking at the {step} ...") if spinner is not None else None,
            )
        )
    if as_json:
        typer.echo(json.dumps([asdict(finding) for finding in findings], indent=1))
    else:
        Console().print(findings_table(findings))
    raise typer.Exit(exit_code(findings))


def findings_table(findings: list[Finding]) -> Table:
    """Return the findings as people read them: what is wrong with its remedy below it."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for finding in findings:
        level = Text(finding.level.value.upper() if finding.level is Level.FAIL else finding.level.value)
        level.stylize(_STYLES[finding.level])
        words = Text(finding.seen)
        if finding.remedy:
            words.append(f"\n-> {finding.remedy}", style="bold")
        table.add_row(level, finding.name, words)
    return table

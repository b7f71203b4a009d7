"""`roadgrip-rsu export`: the passages that a unit kept, for the laboratory."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from rsu_app.cli.interruption import ended_like_ctrl_c
from rsu_app.export_file import ExportFailedError
from rsu_app.moments import shown_moment, unix_s_of
from rsu_app.settings import CONFIG_VARIABLE, load_settings

FILE_ENDING = ".gz"


def export(
    *,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.ndjson.gz", help="The file to write.")],
    since: Annotated[
        str | None,
        typer.Option(
            metavar="ISO", help="Passages received from then on, such as `2026-01-31` or `2026-01-31T06:00Z`."
        ),
    ] = None,
    until: Annotated[str | None, typer.Option(metavar="ISO", help="And before this; left out, to the newest.")] = None,
    section: Annotated[str | None, typer.Option("--section", metavar="ID", help="Of this section alone.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace FILE if it is there.")] = False,
    config_file: Annotated[
        Path | None, typer.Option("--config", "-c", envvar=CONFIG_VARIABLE, help="TOML file with settings.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Write JSON for a machine.")] = False,
) -> None:
    """Write stored passages into a file for the laboratory, without anything that names a vehicle.

    Needs `export.enabled`. Times without a zone are UTC; bounds are taken to ten seconds. The unit may run meanwhile.

    **Example**

        roadgrip-rsu export --since 2026-01-30 --until 2026-01-31 --out fv27-2026-01-30.ndjson.gz
    """
    from rsu_app.records_wiring import ExportRequest, export_passages

    settings = load_settings(config_file)
    if not out.name.endswith(FILE_ENDING):
        raise ExportFailedError(f"{out}: the file is packed; let its name end in .ndjson{FILE_ENDING}")
    if out.exists() and not force:
        raise ExportFailedError(f"{out} is there already; --force replaces it")
    request = ExportRequest(_moment("--since", since), _moment("--until", until), section)
    with ended_like_ctrl_c(), _progress_bar() as bar:
        task = bar.add_task("exporting", total=None)
        head, count = export_passages(
            settings,
            request,
            out,
            now_unix_s=time.time(),
            on_written=lambda written, total: bar.update(task, completed=written, total=total),
        )
    if as_json:
        told = {
            "file": str(out),
            "bytes": out.stat().st_size,
            "passages_count": count,
            "unit": head.unit,
            "since_unix_s": head.since_unix_s,
            "until_unix_s": head.until_unix_s,
            "bundle_id": head.bundle_id,
            "ledger_hash": head.ledger_hash,
        }
        typer.echo(json.dumps(told, indent=1))
        return
    bounds = f"{shown_moment(head.since_unix_s)} to {shown_moment(head.until_unix_s)}"
    typer.echo(f"written: {out}, {count} passages of {head.unit}, {bounds}, {out.stat().st_size} bytes")


def _moment(option: str, text: str | None) -> float | None:
    try:
        return None if text is None else unix_s_of(text)
    except (ValueError, OverflowError) as error:
        raise ExportFailedError(f"{option}: {text!r} is no moment; write it like 2026-01-31T06:00Z") from error


def _progress_bar() -> Progress:
    # On the other channel, so that --json stays JSON.
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=(console := Console(stderr=True)),
        disable=not console.is_terminal,
        transient=True,
    )

"""`roadgrip-train drift`: has the traffic of the units moved, and is it time to train again?"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.progress import Progress, TaskID
from rich.table import Table

from roadgrip.bundle import MANIFEST_NAME, BundleManifest
from roadgrip.bundle_json import manifest_from_json
from roadgrip.errors import BundleError, ConfigurationError
from training.cli_designs import AsJson, progress_bar
from training.data.exported_passages import Export, read_export
from training.drift.drift import DAY_S, Advice, Drift, drift_of
from training.drift.report import document_of

REPORT_NAME, PAGE_NAME = "drift.json", "drift.html"
MOST_ROWS_COUNT = 40
"""A terminal shows so many sections; all of them are in the files."""


def drift(
    exports: Annotated[
        list[Path], typer.Argument(metavar="EXPORT...", help="What units exported, compressed by gzip or not.")
    ],
    *,
    bundle: Annotated[Path, typer.Option(metavar="FOLDER", help="The bundle that the units ran.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help=f"Write {REPORT_NAME} and {PAGE_NAME}, with pictures.")
    ] = None,
    days: Annotated[float, typer.Option(min=0.01, help="Length of a period that is judged as a whole.")] = 7.0,
    as_json: AsJson = False,
) -> None:
    """Say whether traffic moved away from what a bundle was trained on, and whether to keep, watch or retrain.

    Each section's latest passages are held against its first ones under this bundle, at like friction, so that weather
    is no drift; and all against the bundle's training. Exit code 1 if retraining is recommended. docs/drift.md says
    what raises an alarm.

    Example: roadgrip-train drift unit-*.ndjson.gz --bundle build/bundle --out build/drift
    """
    manifest = _manifest(bundle)
    with progress_bar() as bar:
        read = _read(exports, bar)
        judging = bar.add_task("judging sections", total=None, rate="")
        found = drift_of(read, manifest, period_s=days * DAY_S, on_section=partial(_show, bar, judging))
    document = document_of(found)
    if out is not None:
        _write(out, document)
    if as_json:
        typer.echo(json.dumps(document, allow_nan=False))
    else:
        _print(found, document, out)
    if found.advice is Advice.RETRAIN:
        raise typer.Exit(1)


def _manifest(folder: Path) -> BundleManifest:
    path = folder / MANIFEST_NAME
    if not path.is_file():
        raise BundleError(f"no bundle in {folder}: it has no {MANIFEST_NAME}")
    return manifest_from_json(path.read_text(encoding="utf-8"))


def _read(paths: list[Path], bar: Progress) -> list[Export]:
    exports = []
    for path in bar.track(paths, task_id=bar.add_task("reading exports", total=len(paths), rate="")):
        try:
            exports.append(read_export(path))
        except OSError as error:
            raise ConfigurationError(f"cannot read {path}: {error.strerror or error}") from error
    return exports


def _show(bar: Progress, task: TaskID, done: int, total: int) -> None:
    bar.update(task, completed=done, total=total)


def _write(folder: Path, document: dict[str, Any]) -> None:
    from training.drift.page import page_of

    folder.mkdir(parents=True, exist_ok=True)
    (folder / REPORT_NAME).write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    (folder / PAGE_NAME).write_text(page_of(document), encoding="utf-8")


def _print(found: Drift, document: dict[str, Any], out: Path | None) -> None:
    table = Table("section", "unit", "passages", "latest", "outside\nenvelope %", "moved\n% of own", "median", "alarms")
    for each in document["sections"][:MOST_ROWS_COUNT]:
        latest = each["periods"][-1]
        own = latest["own_traffic"]
        moved = "-" if own["features_count"] is None else f"{100.0 * own['drifted_count'] / own['features_count']:.0f}"
        table.add_row(
            escape(each["section_id"]),
            escape(each["unit"]),
            str(each["passages_count"]),
            str(latest["passages_count"]),
            f"{100.0 * latest['out_of_envelope_frac']:.1f}",
            moved,
            "-" if latest["median_mu"] is None else f"{latest['median_mu']:.3f}",
            ", ".join(latest["alarms"]).replace("_", " "),
        )
    # A narrow terminal breaks lines, but never drops figures.
    terminal = Console()
    needed = Measurement.get(terminal, terminal.options.update(max_width=1000), table).maximum
    Console(width=max(terminal.width, needed)).print(table)
    if len(found.sections) > MOST_ROWS_COUNT:
        typer.echo(f"and {len(found.sections) - MOST_ROWS_COUNT} sections more; --out FOLDER or --json has all")
    for why, count in found.left_out.items():
        typer.echo(f"left out, {why.replace('_', ' ')}: {count}")
    typer.echo(f"{found.advice.value}:")
    for reason in found.reasons:
        typer.echo(f"  {reason}")
    if out is not None:
        typer.echo(f"written: {out / REPORT_NAME}, {out / PAGE_NAME}")

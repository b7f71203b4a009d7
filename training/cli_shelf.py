"""What the commands about data sets and ground truth share: which laboratory, and the report of refused rows."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from training.laboratory import LAB_VARIABLE, Laboratory

REFUSED_FOLDER_NAME = "refused"
"""Where reports of refused rows go, in the folder of data."""

Lab = Annotated[Path, typer.Option("--lab", metavar="FOLDER", envvar=LAB_VARIABLE, help="The laboratory.")]
RefusedFile = Annotated[
    Path | None,
    typer.Option(
        "--refused", metavar="FILE", help="Where to write all refused rows.", show_default="LAB/data/refused/NAME.csv"
    ),
]


def write_refused(lab: Laboratory, asked: Path | None, *, name: str, text: str) -> Path:
    """Return where all refused rows were written."""
    path = asked or lab.data_folder / REFUSED_FOLDER_NAME / f"{Path(name).name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8", errors="backslashreplace")
    return path


def print_refused(examples: Mapping[str, tuple[int, str]], *, path: Path) -> None:
    """Print how many rows were refused for each reason, with an example of each.

    Args:
        examples: By the reason: how many rows, and what was said of the first.
        path: Where all of them are.
    """
    shown = Table("refused as", "rows", "the first of them", title="Refused rows")
    for reason, (count, example) in examples.items():
        shown.add_row(reason, str(count), escape(example))
    Console().print(shown)
    typer.echo(f"all of them, with their lines, in {path}")


def print_whole(table: Table) -> None:
    """Print a table that a narrow terminal may break, but never cuts: digests are there to be copied."""
    terminal = Console()
    needed = Measurement.get(terminal, terminal.options.update(max_width=1000), table).maximum
    Console(width=max(terminal.width, needed)).print(table)


def day_of(unix_s: float) -> str:
    """Return a moment for a person."""
    return f"{datetime.fromtimestamp(unix_s, UTC):%Y-%m-%d %H:%M} UTC"

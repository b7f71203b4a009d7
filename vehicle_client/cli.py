"""The command line `roadgrip-vehicle`: each command lives in a module of its own and is registered here."""

from __future__ import annotations

import sys
from importlib.metadata import version as distribution_version
from typing import Annotated

import typer

from roadgrip.errors import RoadgripError
from vehicle_client.cli_drive import drive
from vehicle_client.cli_fleet import fleet
from vehicle_client.cli_live import live
from vehicle_client.cli_recording import inspect, replay, signals, survey

USAGE_ERROR = 2

app = typer.Typer(
    name="roadgrip-vehicle",
    help="The vehicle's side: turns a drive through a curve into 55 numbers and sends them to a road side unit.\n\n"
    "Start a unit with `roadgrip-rsu serve`, then try `roadgrip-vehicle drive` (no unit needed) and "
    "`roadgrip-vehicle fleet`.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"roadgrip {distribution_version('roadgrip')}")
        raise typer.Exit


@app.callback()
def _root(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version and leave.")
    ] = False,
) -> None:
    """Hold the options that come before a command."""


app.command()(fleet)
app.command()(replay)
app.command()(inspect)
app.command()(signals)
app.command()(survey)
app.command()(drive)
app.command()(live)


def run() -> None:
    """Run the command; a promise broken by the input is one line and exit code 2, never a traceback."""
    try:
        app()
    except RoadgripError as error:
        print(f"roadgrip-vehicle: {error}", file=sys.stderr)
        sys.exit(USAGE_ERROR)

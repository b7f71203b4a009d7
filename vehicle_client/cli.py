"""The command line `roadgrip-vehicle`: each command lives in a module of its own and is registered here."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable
from importlib.metadata import version as distribution_version
from typing import Annotated

import typer

from roadgrip.errors import RoadgripError

USAGE_ERROR = 2
COMMANDS = {
    "fleet": "vehicle_client.cli_fleet",
    "replay": "vehicle_client.cli_recording",
    "inspect": "vehicle_client.cli_recording",
    "signals": "vehicle_client.cli_recording",
    "survey": "vehicle_client.cli_recording",
    "drive": "vehicle_client.cli_drive",
    "live": "vehicle_client.cli_live",
    "memory": "vehicle_client.cli_memory",
}
"""Name of each command's function, and the module that holds it, in the order of the help."""


def _version(wanted: bool) -> None:
    if wanted:
        print(f"roadgrip {distribution_version('roadgrip')}")
        raise typer.Exit


def _root(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version and leave.")
    ] = False,
) -> None:
    """Hold the options that come before a command."""


def app_of(names: Iterable[str] = COMMANDS) -> typer.Typer:
    """Return the command line with these commands; the modules of others are not loaded."""
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
    # With a callback a command line of one command still wants its name.
    app.callback()(_root)
    for name in names:
        app.command()(getattr(importlib.import_module(COMMANDS[name]), name))
    return app


def run() -> None:
    """Run the command; a promise broken by the input is one line and exit code 2, never a traceback.

    A command that is named first is loaded alone: what runs in a car has no memory to spare for the others.
    """
    named = sys.argv[1] if len(sys.argv) > 1 else ""
    try:
        app_of([named] if named in COMMANDS else COMMANDS)()
    except RoadgripError as error:
        print(f"roadgrip-vehicle: {error}", file=sys.stderr)
        sys.exit(USAGE_ERROR)

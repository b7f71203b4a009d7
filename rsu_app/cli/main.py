"""The command line `roadgrip-rsu`: serve, look after the database, make and look at maps, check settings."""

from __future__ import annotations

import json
from importlib.metadata import version as distribution_version
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from rsu_app.cli.backup import backup, restore
from rsu_app.cli.doctor import doctor
from rsu_app.cli.export import export
from rsu_app.cli.ledger import ledger_app
from rsu_app.cli.rollout import rollback, switch, update
from rsu_app.cli.section import section_app
from rsu_app.cli.serving import one_line_complaints
from rsu_app.cli.serving import serve as serve_unit
from rsu_app.cli.status import status
from rsu_app.cli.token import token_app
from rsu_app.settings import CONFIG_VARIABLE, load_settings, settings_rows, settings_table, shown_value

app = typer.Typer(
    name="roadgrip-rsu",
    help="The road side unit: gathers what vehicles felt in a curve, says how slippery it is and how fast to go.\n\n"
    "Start with `roadgrip-rsu serve`: it needs no configuration and listens on this machine only.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)
database = typer.Typer(help="Look after the database.", no_args_is_help=True)
config = typer.Typer(help="Check and show settings.", no_args_is_help=True)
app.add_typer(database, name="db")
app.add_typer(config, name="config")
app.add_typer(section_app, name="section")
app.add_typer(ledger_app, name="ledger")
app.add_typer(token_app, name="token")
for command in (status, doctor, update, switch, rollback, export, backup, restore):
    app.command()(command)

ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        envvar=CONFIG_VARIABLE,
        help="TOML file with settings; without one the defaults hold. Environment variables overrule both.",
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Write JSON for a machine.")]


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


@app.command()
def serve(config_file: ConfigFile = None) -> None:
    """Run the unit until it is told to stop (Ctrl-C or SIGTERM).

    Migrates the database, restores the window, then listens: frames over UDP, and HTTP with the same frames, JSON, an
    event stream, health and metrics. Logs go to standard output, one JSON object a line.
    """
    serve_unit(config_file)


@database.command()
def upgrade(config_file: ConfigFile = None) -> None:
    """Bring the database to the schema of this software; creates it where there is none. `serve` does the same."""
    from rsu_app.bootstrap import upgrade_database

    path = load_settings(config_file).database.path
    print(f"{path}: schema {upgrade_database(path)}")


@database.command()
def check(config_file: ConfigFile = None, as_json: AsJson = False) -> None:
    """Say whether the database is sound and of this software's schema; exit code 1 if not. Changes nothing."""
    from rsu_app.bootstrap import check_database

    path = load_settings(config_file).database.path
    problems = check_database(path)
    if as_json:
        print(json.dumps({"path": str(path), "ok": not problems, "problems": problems}))
    else:
        print(f"{path}: " + ("sound" if not problems else "; ".join(problems)))
    raise typer.Exit(1 if problems else 0)


@config.command("check")
def check_config(config_file: ConfigFile = None) -> None:
    """Say whether the settings hold together: files exist, keys load, sections and the bundle can be read."""
    from rsu_app.bootstrap import check_settings

    for line in check_settings(load_settings(config_file)):
        print(line)


@config.command("show")
def show_config(config_file: ConfigFile = None, as_json: AsJson = False) -> None:
    """Show every setting as it would hold now."""
    settings = load_settings(config_file)
    values = settings.model_dump(mode="json")
    if as_json:
        print(json.dumps(values, indent=1))
        return
    table = Table("setting", "value", "meaning")
    for number, section in enumerate(values["sections"]):
        table.add_row(f"sections[{number}]", json.dumps(section), "A section this unit serves.")
    for row in settings_rows():
        group, _, name = row.name.partition(".")
        if name and not group.startswith("sections"):
            table.add_row(row.name, shown_value(values[group][name]), row.description)
    Console().print(table)


@config.command("table")
def table_of_config() -> None:
    """Write the Markdown table of all settings that deploy/README.md holds."""
    print(settings_table(), end="")


@config.command("metrics")
def table_of_metrics() -> None:
    """Write the Markdown table of all metrics that deploy/README.md holds."""
    from rsu_app.observability import metrics_table

    print(metrics_table(), end="")


def run() -> None:
    """Run the command; a promise broken by the input is one line and exit code 2, never a traceback."""
    with one_line_complaints():
        app()

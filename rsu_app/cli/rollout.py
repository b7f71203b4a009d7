"""`roadgrip-rsu status`, `update`, `switch` and `rollback`: what an operator asks of a unit, running or not."""

from __future__ import annotations

import asyncio
import getpass
import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import structlog
import typer
from rich.console import Console
from rich.table import Table

from rsu_app.control_client import ask
from rsu_app.settings import CONFIG_VARIABLE, Settings, load_settings

NOT_DONE = 1

ConfigFile = Annotated[
    Path | None, typer.Option("--config", "-c", envvar=CONFIG_VARIABLE, help="TOML file with settings.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Write JSON for a machine.")]
Reason = Annotated[str, typer.Option("--reason", help="Why; it goes into the ledger.")]
Actor = Annotated[str, typer.Option("--by", help="Who; it goes into the ledger.", show_default="this account")]


def status(config_file: ConfigFile = None, *, as_json: AsJson = False) -> None:
    """Show the running unit: readiness, sections, which bundle is live and what is being tried out, refusals.

    Exit code 1 when no unit runs or it is not ready.
    """
    from rsu_app.rollout_wiring import socket_path

    settings = load_settings(config_file)
    said = ask(socket_path(settings), "/status")
    if said is None:
        typer.echo(f"no unit runs here (nothing answers at {socket_path(settings)})")
        raise typer.Exit(NOT_DONE)
    if as_json:
        typer.echo(json.dumps(said, indent=1))
    else:
        _print_status(said)
    raise typer.Exit(0 if said["ready"] else NOT_DONE)


def update(
    config_file: ConfigFile = None,
    *,
    source: Annotated[
        str,
        typer.Option("--from", help="A repository's folder or URL, such as a USB stick; left out: the configured one."),
    ] = "",
    actor: Actor = "",
    as_json: AsJson = False,
) -> None:
    """Look for a release now, verify it and put it into the shadow. The unit may run meanwhile, or not.

    Exit code 0 with or without news, 1 when a release was refused.
    """
    from rsu_app.operation import checked_source

    settings = load_settings(config_file)
    address = checked_source(settings, str(Path(source).resolve()) if source and "://" not in source else source)
    _order(settings, "/update", {"source": address, "actor": actor or _account()}, as_json=as_json)


def switch(config_file: ConfigFile = None, *, reason: Reason, actor: Actor = "", as_json: AsJson = False) -> None:
    """Make the bundle in the shadow live now, without waiting for its passages; it is still on probation."""
    _order(load_settings(config_file), "/switch", {"reason": reason, "actor": actor or _account()}, as_json=as_json)


def rollback(config_file: ConfigFile = None, *, reason: Reason, actor: Actor = "", as_json: AsJson = False) -> None:
    """Undo the newest step: take the bundle in the shadow off, or else go back to the bundle before the live one."""
    _order(load_settings(config_file), "/rollback", {"reason": reason, "actor": actor or _account()}, as_json=as_json)


def _order(settings: Settings, path: str, order: dict[str, Any], *, as_json: bool) -> None:
    """Give an order to the running unit, or else to one that is put together for it; say what came of it."""
    from rsu_app.rollout_wiring import socket_path

    outcome = ask(socket_path(settings), path, order)
    if outcome is None:
        outcome = asyncio.run(_alone(settings, path, order))
    if as_json:
        typer.echo(json.dumps(outcome))
    else:
        refused = f"{outcome['reason']}: " if outcome.get("reason") else ""
        typer.echo(f"{refused}{outcome.get('detail', outcome)}")
    raise typer.Exit(NOT_DONE if outcome.get("reason") or "done" not in outcome else 0)


async def _alone(settings: Settings, path: str, order: dict[str, Any]) -> dict[str, Any]:
    from rsu_app.adapters.http.control import obey
    from rsu_app.operation import out_of_service

    # What the parts of a unit have to say is no part of the answer.
    structlog.configure(logger_factory=lambda *_: structlog.PrintLogger(sys.stderr))
    return await out_of_service(settings, lambda desk: obey(desk, path, order))


def _account() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # no such account, as in some containers
        return f"uid {os.getuid()}"


def _print_status(said: dict[str, Any]) -> None:
    console = Console()
    console.print(f"roadgrip {said['version']} at {said['at']}: " + ("ready" if said["ready"] else "NOT READY"))
    for condition in said["conditions"]:
        if condition["required"] or not condition["ok"]:
            console.print(f"  {'ok ' if condition['ok'] else 'NO '} {condition['name']}: {condition['detail']}")
    table = Table("section", "vehicles", "interval", "advice", "why")
    for section in said["sections"]:
        interval = "-" if section["mu_new"] is None else f"{section['mu_low']:.2f} to {section['mu_new']:.2f}"
        advised = "-" if section["advised_mps"] is None else f"{3.6 * section['advised_mps']:.0f} km/h"
        table.add_row(
            section["section_id"], str(section["passages_count"]), interval, advised, str(section["advice_reason"])
        )
    console.print(table)
    for section in said["sections"]:
        _print_drift(console, section["section_id"], section["drift"])
    _print_model(console, said["model"])
    passages = said["passages"]
    outcomes = ", ".join(f"{count} {outcome}" for outcome, count in sorted(passages["outcomes"].items()))
    console.print(f"passages since the start: {outcomes or 'none'}")
    for reason, share in passages["refused_frac"].items():
        console.print(f"  {share:.1%} refused: {reason}")


def _print_drift(console: Console, section_id: str, drift: dict[str, Any] | None) -> None:
    if drift is None:
        return
    alarms = ", ".join(drift["alarms"]) or "none"
    moved = ", ".join(each["feature"] for each in drift["worst"])
    console.print(
        f"drift at {section_id}: alarms {alarms}; {drift['own_drifted_count']} features moved against "
        f"{drift['own_rows_count']} passages of like friction, {drift['out_of_envelope_frac']:.1%} outside the envelope"
        + (f"; most: {moved}" if moved else "")
    )


def _print_model(console: Console, model: dict[str, Any]) -> None:
    table = Table("bundle", "is", "release", "gate")
    for role in ("live", "previous", "candidate"):
        if (bundle := model[role]) is not None:
            bundle_id = model["live_bundle_id"] if role == "live" else bundle["bundle_id"]
            release = str(bundle["sequence_number"]) if bundle["sequence_number"] else "factory"
            table.add_row(str(bundle_id), role, release, bundle["gate"])
    console.print(table)
    console.print(f"ring {model['ring']}, {model['stage']}; feature tables {', '.join(model['table_digests'])}")
    if (found := model["comparison"]) is not None:
        apart = "" if found["median_ratio"] is None else f", in the median {found['median_ratio']:+.1%} apart"
        console.print(f"compared by {found['passages_count']} of {model['wanted_count']} passages{apart}")
    if (refusal := model["last_refusal"]) is not None:
        console.print(f"the last release was refused: {refusal['reason']}: {refusal['detail']}")

"""`roadgrip-rsu update`, `switch` and `rollback`: what an operator orders of a unit, running or not."""

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

from rsu_app.control_client import ask
from rsu_app.settings import CONFIG_VARIABLE, Settings, load_settings

NOT_DONE = 1

ConfigFile = Annotated[
    Path | None, typer.Option("--config", "-c", envvar=CONFIG_VARIABLE, help="TOML file with settings.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Write JSON for a machine.")]
Reason = Annotated[str, typer.Option("--reason", help="Why; it goes into the ledger.")]
Actor = Annotated[str, typer.Option("--by", help="Who; it goes into the ledger.", show_default="this account")]


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
    _order(settings, "/update", {"source": address, "actor": actor or this_account()}, as_json=as_json)


def switch(config_file: ConfigFile = None, *, reason: Reason, actor: Actor = "", as_json: AsJson = False) -> None:
    """Make the bundle in the shadow live now, without waiting for its passages; it is still on probation."""
    _order(load_settings(config_file), "/switch", {"reason": reason, "actor": actor or this_account()}, as_json=as_json)


def rollback(config_file: ConfigFile = None, *, reason: Reason, actor: Actor = "", as_json: AsJson = False) -> None:
    """Undo the newest step: take the bundle in the shadow off, or else go back to the bundle before the live one."""
    _order(
        load_settings(config_file), "/rollback", {"reason": reason, "actor": actor or this_account()}, as_json=as_json
    )


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


def this_account() -> str:
    """Return who gives the command, as this machine knows it."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # no such account, as in some containers
        return f"uid {os.getuid()}"

"""`roadgrip-rsu status`: the running unit at a glance, once or for as long as one likes to look."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable
from typing import Annotated, Any

import typer
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from rsu_app.cli.rollout import NOT_DONE, AsJson, ConfigFile
from rsu_app.cli.status_picture import picture
from rsu_app.control_client import ControlError, ask
from rsu_app.settings import load_settings

LOOK_PERIOD_S = 1.0
ANSWER_TIMEOUT_S = 15.0
"""A unit whose disk hangs still answers within seconds; one whose loop stands still does not."""


def status(
    config_file: ConfigFile = None,
    *,
    once: Annotated[bool, typer.Option("--once", help="Show it once and leave, as into a pipe.")] = False,
    as_json: AsJson = False,
) -> None:
    """Show the running unit: readiness, sections, model, clock, disk, traffic, the last refusals; anew every second.

    Ctrl-C ends it. Into a pipe, or with --once, it is shown once. Exit code 1 when no unit runs or it is not ready.
    """
    from rsu_app.rollout_wiring import socket_path

    path = socket_path(load_settings(config_file))
    said = ask(path, "/status", timeout_s=ANSWER_TIMEOUT_S)
    if said is None:
        absence = f"no unit runs here (nothing answers at {path})"
        typer.echo(json.dumps({"ready": False, "running": False, "detail": absence}) if as_json else absence)
        raise typer.Exit(NOT_DONE)
    console = Console()
    if as_json:
        typer.echo(json.dumps(said, indent=1))
    elif once or not console.is_terminal or console.is_dumb_terminal:
        console.print(shown(said, console, whole=True))
    else:
        said = watch(said, lambda: ask(path, "/status", timeout_s=ANSWER_TIMEOUT_S), console, pause=_pause)
    raise typer.Exit(0 if said["ready"] else NOT_DONE)


def watch(
    said: dict[str, Any],
    ask_again: Callable[[], dict[str, Any] | None],
    console: Console,
    *,
    pause: Callable[[], bool],
) -> dict[str, Any]:
    """Return what the unit said last, after showing it for as long as somebody looks.

    Args:
        said: Its first answer.
        ask_again: Returns its next one; None while it does not run.
        console: A terminal.
        pause: Waits for the next look; false when nobody looks any more, as after Ctrl-C.
    """
    live = Live(shown(said, console), console=console, screen=True, auto_refresh=False)
    with live, contextlib.suppress(KeyboardInterrupt):
        silent_since = ""
        while pause():
            trouble = "no unit runs here any more"
            try:
                answer = ask_again()
            except ControlError as error:
                answer, trouble = None, str(error)
            if answer is None:
                silent_since = silent_since or time.strftime("%H:%M:%S")
                live.update(
                    shown(said, console, warning=f"since {silent_since}: {trouble}; below is old"), refresh=True
                )
            else:
                said, silent_since = answer, ""
                live.update(shown(said, console), refresh=True)
    return said


def shown(said: dict[str, Any], console: Console, *, whole: bool = False, warning: str = "") -> Group:
    """Return the status as a console prints it.

    Args:
        said: What the unit answered.
        console: Where; its size bounds the picture.
        whole: Not its height, though.
        warning: A line that comes first.
    """
    above = [Text(warning[: console.width], style="bold red")] if warning else []
    height_count = None if whole else console.height - len(above)
    lines = [*above, *picture(said, width_count=console.width, height_count=height_count)]
    for line in lines:
        line.no_wrap = True
    return Group(*lines)


def _pause() -> bool:
    time.sleep(LOOK_PERIOD_S)
    return True

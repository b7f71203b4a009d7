"""`roadgrip-rsu token`: what lets operators and their machines in over HTTP."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from rsu_app.operator_tokens import TokenScope, new_token

token_app = typer.Typer(help="Make tokens for operators.", no_args_is_help=True)


@token_app.callback()
def _root() -> None:
    """Keep `new` a command of its own."""


@token_app.command()
def new(
    scopes: Annotated[
        list[TokenScope],
        typer.Option(
            "--scope",
            "-s",
            help="What it opens: `metrics` (GET /metrics), `health` (GET /health/ready), `detections` "
            "(POST .../detections). May be given several times.",
        ),
    ],
    note: Annotated[str, typer.Option(help="Who has it, for whoever reads the file.")] = "",
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Write JSON for a machine.")] = False,
) -> None:
    """Make a token: it is shown this once and kept nowhere. Its line goes into the file of `operators.tokens_file`.

    The token alone goes to standard output, so that `roadgrip-rsu token new --scope metrics > token` makes a file for
    Prometheus (`bearer_token_file`, or `authorization: credentials_file`); the line goes to standard error.
    """
    token, line = new_token(scopes, note=note)
    if as_json:
        print(json.dumps({"token": token, "line": line}))
        return
    print(token)
    print(f"the line for the file of operators.tokens_file:\n{line}", file=sys.stderr)

"""How a play of this folder is started and left: through every `finally`, so that the units it started stop, too."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable

from roadgrip.errors import RoadgripError

USAGE_ERROR = 2


def run_play(app: Callable[[], object], *, name: str) -> None:
    """Run a play; what cannot be is one line and exit code 2, never a traceback.

    Args:
        app: The play.
        name: What the line begins with.
    """
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _leave)
    try:
        app()
    except RoadgripError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(USAGE_ERROR)


def _leave(number: int, _: object) -> None:
    sys.exit(128 + number)

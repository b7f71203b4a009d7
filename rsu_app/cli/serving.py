"""The way into the unit that runs for years: `serve`, without what only a command line needs.

typer, rich and the other commands would stay in its memory, some 14 MB of them, and make its start longer.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from roadgrip.errors import RoadgripError
from rsu_app.settings import CONFIG_VARIABLE, load_settings

USAGE_ERROR = 2


def config_of_plain_serve(arguments: Sequence[str], environment: Mapping[str, str]) -> list[Path] | None:
    """Return the file of settings that a plain `serve` is to read, none or one; None for anything else that was asked.

    Anything else, slips included, is for the whole command line to answer.

    Args:
        arguments: What follows the name of the program.
        environment: Names the file where no argument does.
    """
    match list(arguments):
        case ["serve"]:
            path = environment.get(CONFIG_VARIABLE, "")
            return [Path(path)] if path else []
        case ["serve", "-c" | "--config", path] if path and not path.startswith("-"):
            return [Path(path)]
        case ["serve", word] if word.startswith("--config=") and word != "--config=":
            return [Path(word.removeprefix("--config="))]
        case _:
            return None


def serve_plainly(config_files: Sequence[Path]) -> None:
    """Run the unit until it is told to stop; a promise broken by the input is one line and exit code 2."""
    with one_line_complaints():
        with _log_without_rich():
            import structlog  # noqa: F401
        serve(next(iter(config_files), None))


def serve(config_file: Path | None) -> None:
    """Run the unit until it is told to stop.

    Raises:
        RoadgripError: It cannot start; the message says why.
    """
    from rsu_app.service import run

    run(load_settings(config_file))


@contextmanager
def one_line_complaints() -> Iterator[None]:
    """Turn a promise broken by the input into one line and exit code 2, never a traceback."""
    try:
        yield
    except RoadgripError as error:
        sys.stderr.write(f"roadgrip-rsu: {error}\n")
        sys.exit(USAGE_ERROR)


@contextmanager
def _log_without_rich() -> Iterator[None]:
    """Let structlog be imported as where rich is not installed: it would draw tracebacks for a terminal nobody has.

    It imports rich, and with that a library of programming languages, whenever there is one: 4 MB. An entry of None is
    how Python is told that a module cannot be imported.
    """
    if "rich" in sys.modules:
        yield
        return
    sys.modules["rich"] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules["rich"]

"""What the benchmarks share: roads, the cost of a call, a table to print, figures to keep, the name of the machine."""

from __future__ import annotations

import argparse
import json
import platform
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

ROADS = ("long-turn", "s-turn", "sharp-turn")
_RESULTS_FOLDER = Path(__file__).resolve().parent / "results"


def cost_s(work: Callable[[], object], *, clock: Callable[[], float], rounds_count: int, budget_s: float) -> float:
    """Return what one call costs: the best of some rounds, each of about `budget_s`.

    Args:
        work: What is called.
        clock: Seconds, of the wall or of a processor.
        rounds_count: How many rounds.
        budget_s: How long one round takes.
    """
    started_s = clock()
    work()
    calls_count = max(1, int(budget_s / max(1e-7, clock() - started_s)))
    best_s = float("inf")
    for _ in range(rounds_count):
        started_s = clock()
        for _ in range(calls_count):
            work()
        best_s = min(best_s, clock() - started_s)
    return best_s / calls_count


def table_of(rows: Sequence[Mapping[str, str | float]], *, number_format: str) -> str:
    """Return rows with the same keys as a table."""
    columns = list(rows[0])
    lines = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    for row in rows:
        cells = [value if isinstance(value, str) else format(value, number_format) for value in row.values()]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def parser_of(documentation: str | None, *, results_name: str) -> argparse.ArgumentParser:
    """Return a parser that knows `--out`, described by the first line of a script's docstring."""
    parser = argparse.ArgumentParser(description=(documentation or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=_RESULTS_FOLDER / results_name)
    return parser


def keep_figures(path: Path, figures: Mapping[str, object]) -> None:
    """Write figures as JSON; the folder is made if missing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


def processor() -> str:
    """Return the processor's model where the system tells it."""
    told = Path("/proc/cpuinfo")
    if told.is_file():
        for entry in told.read_text(encoding="utf-8").splitlines():
            if entry.startswith("model name"):
                return entry.partition(":")[2].strip()
    return platform.processor() or "unknown"

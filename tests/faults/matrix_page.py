"""What came of the scenarios, as figures to keep and as a page to read."""

from __future__ import annotations

import json
import os
import platform
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.faults.matrix import Performance
from tests.faults.scenario import Scenario
from training.marked_tables import table, with_tables

PROBLEMS_KEPT_COUNT = 5
TABLE_NAME, CONTROLS_NAME = "faults", "faults_controls"


def conditions() -> dict[str, Any]:
    """Return where the scenarios were performed."""
    return {
        "cores_count": os.cpu_count(),
        "load_at_the_end": round(os.getloadavg()[0], 1),
        "python": platform.python_version(),
        "sqlite": sqlite3.sqlite_version,
        "system": f"{platform.system()} {platform.machine()}",
    }


def figures_of(performance: Performance) -> dict[str, Any]:
    """Return what is kept of a scenario's runs."""
    scenario, found = performance.scenario, performance.finding
    return {
        "scenario": scenario.name,
        "promise": scenario.promise,
        "runs": found.runs_count,
        "lost": found.lost_count,
        "duplicated": found.duplicated_count,
        "passed": found.passed,
        "acknowledged": found.acknowledged_count,
        "problems": found.problems[:PROBLEMS_KEPT_COUNT],
        "problems_count": len(found.problems),
        "figures": found.figures,
        "what_happens": scenario.conditions,
        "first_seed": performance.seed,
        "took_s": round(performance.took_s),
        "conditions": conditions(),
    }


def control_of(performance: Performance, control: str) -> dict[str, Any]:
    """Return what is kept of a scenario that met a broken unit."""
    found = performance.finding
    return {
        "broken": control,
        "noticed": not found.passed,
        "runs": found.runs_count,
        "lost": found.lost_count,
        "duplicated": found.duplicated_count,
        "first_problem": found.problems[0] if found.problems else "",
    }


def merged(known: Iterable[Mapping[str, Any]], fresh: Mapping[str, Any], scenarios: Sequence[Scenario]) -> list[Any]:
    """Return kept figures with those of one scenario in their place; what it lacks stays from before.

    Scenarios that exist no longer go.
    """
    rows = {row["scenario"]: row for row in known}
    rows[fresh["scenario"]] = {**rows.get(fresh["scenario"], {}), **fresh}
    return [rows[scenario.name] for scenario in scenarios if scenario.name in rows]


def read(path: Path) -> list[dict[str, Any]]:
    """Return the figures that are kept; none if there is no file yet."""
    return list(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else []


def keep(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the figures."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def page_with(page: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the page with its tables made anew."""
    return with_tables(page, {TABLE_NAME: _matrix(rows), CONTROLS_NAME: _controls(rows)}.get)


def _matrix(rows: Sequence[Mapping[str, Any]]) -> str:
    performed = [row for row in rows if "runs" in row]
    return table(
        ("scenario", "what happens", "promise", "runs", "acknowledged", "lost", "twice", "kept", "measured"),
        [
            (
                f"`{row['scenario']}`",
                row["what_happens"],
                row["promise"],
                f"{row['runs']:,}",
                f"{row['acknowledged']:,}",
                f"{row['lost']:,}",
                f"{row['duplicated']:,}",
                "yes" if row["passed"] else f"**no**: {row['problems_count']} problems, see the figures",
                ", ".join(f"{name} {value:g}" for name, value in row["figures"].items()),
            )
            for row in performed
        ],
    )


def _controls(rows: Sequence[Mapping[str, Any]]) -> str:
    return table(
        ("scenario", "broken on purpose", "noticed", "after runs", "lost", "twice"),
        [
            (
                f"`{row['scenario']}`",
                control["broken"],
                "yes" if control["noticed"] else "**no**",
                str(control["runs"]),
                f"{control['lost']:,}",
                f"{control['duplicated']:,}",
            )
            for row in rows
            for control in row.get("controls", ())
        ],
    )

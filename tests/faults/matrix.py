"""All scenarios, and how they are performed until each has its runs."""

from __future__ import annotations

import shutil
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.faults import clocks, crowds, damage, disks, kills, power
from tests.faults.scenario import Finding, Scenario, Stage

SCENARIOS: tuple[Scenario, ...] = (
    *kills.SCENARIOS,
    *power.SCENARIOS,
    *disks.SCENARIOS,
    *damage.SCENARIOS,
    *clocks.SCENARIOS,
    *crowds.SCENARIOS,
)
TOLD_CHARACTERS_COUNT = 600


@dataclass(frozen=True)
class Performance:
    """What came of the runs of a scenario."""

    scenario: Scenario
    finding: Finding
    seed: int
    took_s: float


def perform(
    scenario: Scenario,
    *,
    seed: int,
    runs_count: int,
    broken: str = "",
    tell: Callable[[int], None] = lambda _: None,
    enough: Callable[[Finding], bool] = lambda _: False,
) -> Performance:
    """Return what came of a scenario.

    Args:
        scenario: It.
        seed: Of the first performance; the next ones count on.
        runs_count: How often the fault is to happen.
        broken: See `Stage`.
        tell: Called with the number of runs that have been done since it was called last.
        enough: Whether to end early with what was found.
    """
    whole = Finding()
    started_s = time.monotonic()
    number = 0
    while whole.runs_count < runs_count and not enough(whole):
        folder = Path(tempfile.mkdtemp(prefix="roadgrip-fault-"))
        left_count = runs_count - whole.runs_count
        try:
            found = scenario.perform(Stage(folder, seed + number, left_count, broken=broken, tell=tell))
        except Exception as error:  # noqa: BLE001 - a scenario that breaks off has not shown what it is for
            found = Finding(runs_count=1, problems=[f"broke off: {_told(error)}"])
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        found.problems = [f"seed {seed + number}: {problem}" for problem in found.problems]
        whole.add(found)
        number += 1
    return Performance(scenario, whole, seed, time.monotonic() - started_s)


def _told(error: Exception) -> str:
    """Return what went wrong, and where in these scenarios."""
    steps = [step for step in traceback.extract_tb(error.__traceback__) if "/tests/" in step.filename]
    places = " > ".join(f"{Path(step.filename).name}:{step.lineno}" for step in steps)
    return f"{type(error).__name__} at {places}: {str(error)[-TOLD_CHARACTERS_COUNT:]}"


def noticed(scenario: Scenario, control: str, *, seed: int) -> Performance:
    """Return what came of a scenario with a broken unit, ended as soon as it was noticed."""
    return perform(
        scenario,
        seed=seed,
        runs_count=scenario.runs_count,
        broken=control,
        enough=lambda found: found.runs_count > 0 and not found.passed,
    )

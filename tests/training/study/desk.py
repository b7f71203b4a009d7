"""A workbench for tests: made-up runs, nothing on disk, everything remembered as long as the test lasts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tests.training.runs import made_up_runs
from training.dataset import Runs
from training.study.chapter import Arrays
from vehicle_client.simulator.plan import SensorGrade


@dataclass
class Desk:
    data_sets: Mapping[str, Runs] = field(default_factory=lambda: {"paper": made_up_runs(600)})
    quick: bool = True
    seed: int = 1
    folder: Path = Path("nowhere")
    memory: dict[str, Arrays] = field(default_factory=dict)
    reports: list[str] = field(default_factory=list)
    worked: list[str] = field(default_factory=list)

    def runs(self, name: str, grade: SensorGrade) -> Runs:
        return self.data_sets[name]

    def remembered(self, name: str, work: Callable[[], Arrays]) -> Arrays:
        if name not in self.memory:
            self.memory[name] = work()
            self.worked.append(name)
        return self.memory[name]

    def report(self, what: str, done_count: int, wanted_count: int) -> None:
        self.reports.append(what)

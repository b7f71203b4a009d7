"""What a scenario is: a promise, something that happens, and what was found afterwards."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Stage:
    """Where one performance of a scenario takes place.

    Attributes:
        folder: Empty, and its own.
        seed: Decides everything that chance decides here; what the machine's timing decides it cannot.
        runs_count: How often the fault may happen in it at most; a performance may be shorter.
        broken: What of `tests.faults.sabotage` is broken in the unit; empty for nothing.
        tell: Called after each run.
    """

    folder: Path
    seed: int
    runs_count: int
    broken: str = ""
    tell: Callable[[int], None] = lambda _: None

    @property
    def chance(self) -> random.Random:
        """Chance, from its beginning."""
        return random.Random(self.seed)


@dataclass
class Finding:
    """What was found.

    Attributes:
        runs_count: How often the fault happened.
        acknowledged_count: Passages whose senders were told that they are kept.
        lost_count: Of those, how many are not there afterwards.
        duplicated_count: How many passages are there, or count, more than once.
        problems: What else was promised and is not so, a line each.
        figures: What was measured beside.
    """

    runs_count: int = 0
    acknowledged_count: int = 0
    lost_count: int = 0
    duplicated_count: int = 0
    problems: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether the promise was kept."""
        return self.runs_count > 0 and not (self.lost_count or self.duplicated_count or self.problems)

    def expect(self, condition: object, problem: str) -> None:
        """Note a problem unless the condition holds."""
        if not condition:
            self.problems.append(problem)

    def add(self, other: Finding) -> None:
        """Take in what another performance found; of a figure the largest stays."""
        self.runs_count += other.runs_count
        self.acknowledged_count += other.acknowledged_count
        self.lost_count += other.lost_count
        self.duplicated_count += other.duplicated_count
        self.problems += other.problems
        for name, value in other.figures.items():
            self.figures[name] = max(value, self.figures.get(name, value))


@dataclass(frozen=True, slots=True)
class Scenario:
    """A fault, and what the unit promises when it happens.

    Attributes:
        name: For the command line and the table.
        promise: For a person.
        conditions: What exactly happens, and to what.
        runs_count: How often it is made to happen for the table.
        perform: Makes it happen, and looks.
        controls: What of `tests.faults.sabotage` breaks the promise: each must be noticed.
    """

    name: str
    promise: str
    conditions: str
    runs_count: int
    perform: Callable[[Stage], Finding]
    controls: tuple[str, ...]

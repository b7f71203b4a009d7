"""What a chapter of the study is: a question the paper answers, how it is answered here, and what to make of both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Protocol, TypeAlias

from roadgrip.units import FloatArray
from training.dataset import Runs
from training.study.picture import Picture
from vehicle_client.simulator.plan import SensorGrade

Cell: TypeAlias = str | float | int | None
Arrays: TypeAlias = Mapping[str, FloatArray]


class Claim(StrEnum):
    """What became of a claim of the paper."""

    CONFIRMED = "confirmed"
    PARTLY = "partly confirmed"
    NOT_CONFIRMED = "not confirmed"
    NOT_TESTABLE = "not testable here"
    NOT_CLAIMED = "not in the paper"


@dataclass(frozen=True, slots=True)
class Table:
    """A table a person reads.

    Attributes:
        title: What it shows.
        columns: Headings, units in them.
        rows: One cell per column; numbers as numbers, rounded by who prints them to three digits.
        note: Sample sizes and caveats, below it.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Result:
    """What a chapter found with one grade of sensors.

    Attributes:
        figures: Numbers by name, for machines; fractions, not per cent.
        sizes: Sample sizes and seeds by name, printed with the result.
        tables: For people.
        pictures: The same.
    """

    figures: Mapping[str, float]
    sizes: Mapping[str, int]
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()


@dataclass(frozen=True, slots=True)
class Verdict:
    """What to make of the results.

    Attributes:
        claim: What became of the paper's claim.
        text: A paragraph that sets the results beside the paper's numbers; written from the figures, not by hand.
    """

    claim: Claim
    text: str


class Workbench(Protocol):
    """What a chapter works with."""

    @property
    def quick(self) -> bool:
        """Whether a rough answer in minutes is wanted: fewer rows, fewer repetitions."""
        ...

    @property
    def seed(self) -> int:
        """Seed from which every chance of the study follows."""
        ...

    @property
    def folder(self) -> Path:
        """Where drives and caches lie, for what is too large to be a result."""
        ...

    def runs(self, name: str, grade: SensorGrade) -> Runs:
        """Return a data set of the study (`training.study.datasets`), driven now unless it is there."""
        ...

    def remembered(self, name: str, work: Callable[[], Arrays]) -> Arrays:
        """Return arrays that `work` computes, or those it computed before: for what several chapters need.

        The name must hold everything they depend on besides code and data sets, such as the grade of the sensors.
        """
        ...

    def report(self, what: str, done_count: int, wanted_count: int) -> None:
        """Tell how far a long computation is."""
        ...


@dataclass(frozen=True, slots=True)
class Chapter:
    """One question of the study.

    Attributes:
        name: Short, for files and options, such as "algorithms".
        title: For people.
        paper_says: What the paper reports, with its numbers; empty where it does not ask.
        compute: Answers it with one grade of sensors; cached by code and data.
        verdict: What to make of the results, by grade.
        needs: Names of the data sets it takes with any sensors, for the plan of the run.
        automotive_needs: Those that it takes beside them with automotive sensors alone.
    """

    name: str
    title: str
    paper_says: str
    compute: Callable[[Workbench, SensorGrade], Result]
    verdict: Callable[[Mapping[SensorGrade, Result]], Verdict]
    needs: tuple[str, ...] = field(default=())
    automotive_needs: tuple[str, ...] = field(default=())

    def needed(self, grade: SensorGrade) -> tuple[str, ...]:
        """Return the names of the data sets it takes with one grade of sensors."""
        return (*self.needs, *(self.automotive_needs if grade is SensorGrade.AUTOMOTIVE else ()))

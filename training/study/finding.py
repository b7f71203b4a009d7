"""What became of a chapter: its results by grade of sensors, its verdict, and what computing them took."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from training.study.chapter import Chapter, Result, Verdict
from vehicle_client.simulator.plan import SensorGrade

LONGEST_STAGE_S = 45.0 * 60.0
"""A stage that takes longer cannot be gone on with after a break, and is a defect of the study."""


@dataclass(frozen=True, slots=True)
class Timing:
    """What a stage took, its data sets apart.

    Attributes:
        wall_s: From beginning to end.
        cpu_s: Over all threads and ended processes.
    """

    wall_s: float
    cpu_s: float

    @property
    def too_long(self) -> bool:
        """Whether it took longer than a stage may."""
        return self.wall_s > LONGEST_STAGE_S


@dataclass(frozen=True, slots=True)
class Computed:
    """A result, and how it came about.

    Attributes:
        result: The result.
        timing: What computing it took.
        code_digest: Of the code that computed it.
        data: Digest of each data set it is from, by the set's name.
        stale: Whether code or data have changed since.
    """

    result: Result
    timing: Timing
    code_digest: str
    data: Mapping[str, str]
    stale: bool = False


@dataclass(frozen=True, slots=True)
class Finding:
    """All there is about one chapter.

    Attributes:
        chapter: The chapter.
        computed: What was found, by grade; a grade that failed, or was not asked for, is missing.
        verdict: What to make of it; None where there is nothing to judge or judging failed.
        failures: What went wrong, in a line, by grade or "verdict".
    """

    chapter: Chapter
    computed: Mapping[SensorGrade, Computed]
    verdict: Verdict | None
    failures: Mapping[str, str] = field(default_factory=dict)

    @property
    def results(self) -> dict[SensorGrade, Result]:
        """The results alone, ideal sensors first."""
        return {grade: self.computed[grade].result for grade in SensorGrade if grade in self.computed}

    @property
    def defects(self) -> tuple[str, ...]:
        """Everything that a reader of the results must know is wrong with them, a line each."""
        name = self.chapter.name
        late = [
            f"{name}, {grade.value} sensors: took {done.timing.wall_s / 60.0:.0f} minutes, more than a stage may"
            for grade, done in self.computed.items()
            if done.timing.too_long
        ]
        old = [
            f"{name}, {grade.value} sensors: code or data have changed since it was computed"
            for grade, done in self.computed.items()
            if done.stale
        ]
        return (*(f"{name}, {where}: {what}" for where, what in self.failures.items()), *late, *old)

"""The course of a study: what is to be done, and doing it chapter by chapter, whatever one of them does."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from training.study.chapter import Chapter
from training.study.finding import Computed, Finding, Timing
from training.study.workbench import StudyWorkbench
from vehicle_client.simulator.plan import SensorGrade


class State(StrEnum):
    """How far a stage is."""

    DONE = "cached"
    STALE = "to do again"
    MISSING = "to do"


@dataclass(frozen=True, slots=True)
class Stage:
    """One line of the plan.

    Attributes:
        name: Of the data set or chapter.
        grade: Of the sensors.
        state: How far it is.
        took: What it took when it was done, if it was.
        is_data: Whether it is a data set.
    """

    name: str
    grade: SensorGrade
    state: State
    took: Timing | None = None
    is_data: bool = False


class Watcher(Protocol):
    """Is told how a study goes on."""

    def begins(self, what: str) -> None:
        """A stage begins."""
        ...

    def ends(self, what: str, computed: Computed, *, kept: bool) -> None:
        """A chapter has its result, just computed or kept from before."""
        ...

    def fails(self, what: str, details: str) -> None:
        """A stage failed; the study goes on without it."""
        ...

    def found(self, finding: Finding) -> None:
        """A chapter is through, with all grades of sensors."""
        ...


def plan(bench: StudyWorkbench, chapters: tuple[Chapter, ...], grades: tuple[SensorGrade, ...]) -> tuple[Stage, ...]:
    """Return the stages of a study in their order: the data sets that chapters need, then the chapters.

    A chapter that is done needs its data sets no more.
    """
    stages: list[Stage] = []
    needed: dict[tuple[str, SensorGrade], bool] = {}
    for chapter in chapters:
        for grade in grades:
            kept = bench.kept(chapter, grade)
            state = State.MISSING if kept is None else State.STALE if kept.stale else State.DONE
            stages.append(Stage(chapter.name, grade, state, kept.timing if kept is not None else None))
            if state is not State.DONE:
                needed |= {(name, grade): bench.is_driven(name, grade) for name in chapter.needed(grade)}
    data = (
        Stage(name, grade, State.DONE if there else State.MISSING, is_data=True)
        for (name, grade), there in needed.items()
    )
    return (*data, *stages)


def conduct(
    bench: StudyWorkbench, chapters: tuple[Chapter, ...], grades: tuple[SensorGrade, ...], watcher: Watcher
) -> tuple[Finding, ...]:
    """Return what the chapters find; one that fails is named as such and the others go on.

    Args:
        bench: What they work with.
        chapters: In the order in which they are computed.
        grades: Of the sensors.
        watcher: Is told how it goes on.
    """
    findings = []
    for chapter in chapters:
        computed: dict[SensorGrade, Computed] = {}
        failures: dict[str, str] = {}
        for grade in grades:
            what = f"{chapter.name}, {grade.value} sensors"
            watcher.begins(what)
            # A chapter may fail in any way its libraries know; hours of work by the others shall not be lost by it.
            try:
                kept = bench.kept(chapter, grade)
                is_kept = kept is not None and not kept.stale
                for name in chapter.needed(grade) if not is_kept else ():
                    bench.runs(name, grade)
                computed[grade] = bench.computed(chapter, grade)
            except Exception as error:  # noqa: BLE001 - see above
                failures[grade.value] = _in_a_line(error)
                watcher.fails(what, traceback.format_exc())
            else:
                watcher.ends(what, computed[grade], kept=is_kept)
        # With what the other grade found before, or the verdict would say less than is known.
        others = {grade: bench.kept(chapter, grade) for grade in SensorGrade if grade not in grades}
        known = {grade: kept for grade, kept in others.items() if kept is not None}
        finding = _finding(chapter, {**computed, **known}, failures)
        if "verdict" in finding.failures:
            watcher.fails(f"{chapter.name}, verdict", finding.failures["verdict"])
        watcher.found(finding)
        findings.append(finding)
    return tuple(findings)


def kept_findings(bench: StudyWorkbench, chapters: tuple[Chapter, ...]) -> tuple[Finding, ...]:
    """Return what chapters found before, current or not, without computing anything; none for those that never did."""
    kept = {
        chapter.name: {grade: found for grade in SensorGrade if (found := bench.kept(chapter, grade)) is not None}
        for chapter in chapters
    }
    return tuple(_finding(chapter, kept[chapter.name], {}) for chapter in chapters if kept[chapter.name])


def _finding(chapter: Chapter, computed: Mapping[SensorGrade, Computed], failures: Mapping[str, str]) -> Finding:
    if not computed:
        return Finding(chapter, computed, None, failures)
    results = {grade: computed[grade].result for grade in SensorGrade if grade in computed}
    try:
        return Finding(chapter, computed, chapter.verdict(results), failures)
    except Exception as error:  # noqa: BLE001 - a verdict that fails takes nothing from the figures
        where = traceback.extract_tb(error.__traceback__)[-1]
        failure = f"{_in_a_line(error)} (line {where.lineno} of {where.name})"
        return Finding(chapter, computed, None, {**failures, "verdict": failure})


def _in_a_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]

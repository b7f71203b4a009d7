"""How a study shows itself while it runs: a line per stage, bars for what takes long, files and records per chapter."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from roadgrip.errors import ConfigurationError
from training.study.finding import Computed, Finding
from training.tracking import TrackedRun, Tracker

FAILURES_FOLDER_NAME = "failures"
_LINE_EVERY_S = 30.0


class StudyShow:
    """Watches a study (`training.study.course.Watcher`): tells a person, writes each chapter's files, records it.

    Attributes:
        record: Where runs are recorded, once they are.
    """

    def __init__(self, console: Console, *, out: Path, work: Path) -> None:
        """Show on a console.

        Args:
            console: For people.
            out: The folder of all chapters' files.
            work: The study's folder; details of failures go there.
        """
        self.record: StudyRecord | None = None
        self._console = console
        self._out = out
        self._work = work
        self._bars = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console
        )
        self._tasks: dict[str, TaskID] = {}
        self._line_told_s = time.monotonic()

    def __enter__(self) -> Self:
        """Begin to show bars."""
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the bars away."""
        self._bars.stop()

    def report(self, what: str, done_count: int, wanted_count: int) -> None:
        """Show how far a long computation is: a bar on a terminal, a line now and then in a log."""
        if what not in self._tasks:
            self._tasks[what] = self._bars.add_task(what)
        self._bars.update(self._tasks[what], completed=done_count, total=wanted_count)
        if done_count >= wanted_count:
            self._bars.remove_task(self._tasks.pop(what))
        if not self._console.is_terminal and time.monotonic() > self._line_told_s + _LINE_EVERY_S:
            self._line_told_s = time.monotonic()
            self._console.print(f"  {what}: {done_count} of {wanted_count}", highlight=False)

    def begins(self, what: str) -> None:
        """Show what is being computed."""
        self._forget_bars()
        self._tasks[what] = self._bars.add_task(what, total=None)

    def ends(self, what: str, computed: Computed, *, kept: bool) -> None:
        """Say that a stage is done, now or before."""
        self._forget_bars()
        if kept:
            self._console.print(f"[green]kept[/green] {what}", highlight=False)
            return
        took = f"{computed.timing.wall_s:.0f} s, {computed.timing.cpu_s:.0f} s of processor time"
        late = " [red](longer than a stage may take)[/red]" if computed.timing.too_long else ""
        self._console.print(f"[green]done[/green] {what}: {took}{late}", highlight=False)

    def fails(self, what: str, details: str) -> None:
        """Say that a stage failed, and keep the details."""
        self._forget_bars()
        folder = self._work / FAILURES_FOLDER_NAME
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{what.replace(', ', '-').replace(' ', '-')}.txt"
        path.write_text(details, encoding="utf-8")
        reason = details.strip().splitlines()[-1]
        # As text: what stands in brackets in an error is no colour.
        line = Text.assemble(("failed", "red"), f" {what}: {reason} (more in {path})")
        self._console.print(line, highlight=False, soft_wrap=True)

    def found(self, finding: Finding) -> None:
        """Write the chapter's files, and record it."""
        from training.report.small_files import write_chapter

        files = write_chapter(finding, self._out)
        if self.record is not None:
            self.record.chapter(finding, files)

    def _forget_bars(self) -> None:
        for task in self._tasks.values():
            self._bars.remove_task(task)
        self._tasks.clear()


class StudyRecord:
    """The records of one command: a run for it, and one within it for each chapter and grade of sensors.

    Records are for later; a server that goes away while a study runs must not end it. That is said once.
    """

    def __init__(
        self, tracker: Tracker, name: str, parameters: dict[str, str | int | float], *, tell: Callable[[str], None]
    ) -> None:
        """Begin the run of the command.

        Args:
            tracker: The records.
            name: Of the command.
            parameters: What it runs with.
            tell: Tells a person that recording came to an end.

        Raises:
            ConfigurationError: It cannot be recorded at all.
        """
        self._tracker = tracker
        self._parameters = parameters
        self._tell = tell
        self._lost = False
        self._run = tracker.begin(name, parameters=parameters)

    def chapter(self, finding: Finding, files: Sequence[Path]) -> None:
        """Record a chapter: sizes, figures and files."""
        self._try(lambda: self._chapter(finding, files))

    def end(self, files: Sequence[Path], *, well: bool) -> None:
        """End the run of the command with its files."""

        def work() -> None:
            for path in files:
                self._run.file(path)
            self._run.end(well=well)

        self._try(work)

    def _chapter(self, finding: Finding, files: Sequence[Path]) -> None:
        for grade, done in finding.computed.items():
            run: TrackedRun = self._tracker.begin(
                f"{finding.chapter.name} {grade.value}",
                parameters={
                    **self._parameters,
                    "chapter": finding.chapter.name,
                    "sensors": grade.value,
                    "code_digest": done.code_digest,
                    **{f"size.{name}": count for name, count in done.result.sizes.items()},
                    **{f"data.{name}": digest for name, digest in done.data.items()},
                },
                parent=self._run,
                began_ago_s=done.timing.wall_s,
            )
            run.metrics({**done.result.figures, "wall_s": done.timing.wall_s, "cpu_s": done.timing.cpu_s})
            if finding.verdict is not None:
                run.word("claim", finding.verdict.claim.value)
            for path in files:
                if path.name.startswith(grade.value) or path.suffix == ".json":
                    run.file(path)
            run.end()

    def _try(self, work: Callable[[], None]) -> None:
        if self._lost:
            return
        try:
            work()
        except ConfigurationError as error:
            self._lost = True
            self._tell(f"{error}; the study goes on without records")

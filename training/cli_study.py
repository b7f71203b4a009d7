"""The commands of the study: the paper reproduced, and what goes past it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from training.cli_designs import AsJson, console
from training.cli_study_tune import tune_recipe
from training.code_identity import code_digest
from training.marked_tables import with_tables
from training.study.chapter import Chapter
from training.study.course import Stage, State, conduct, kept_findings, plan
from training.study.finding import Finding
from training.study.headlines import summary
from training.study.registry import PART_TITLES, Part, chapters_of
from training.study.workbench import StudyWorkbench
from training.study_show import StudyRecord, StudyShow
from training.tracking import Tracker, local_tracker
from training.workers import kept_workers
from vehicle_client.simulator.plan import SensorGrade

DEFAULT_WORK = Path("build/study")
DEFAULT_QUICK_WORK = Path("build/study-quick")
DEFAULT_OUT = Path("docs/results/study")
DEFAULT_EXPERIMENT = "roadgrip-study"
QUICK_OUT_FOLDER_NAME = "results"

INTRODUCTIONS = {
    Part.PAPER: (
        "Every result of the paper, made again on simulated drives: once with ideal sensors, which is the paper's "
        "setting, and once with what a production car carries. Each chapter sets its figures beside the paper's and "
        "says what became of the claim."
    ),
    Part.GENERALISE: (
        "What the paper leaves open: roads the model has never seen, cars of all kinds, what a passage can and cannot "
        "tell, liars, drivers who follow the advice, and friction that drops within the hour."
    ),
}

study_app = typer.Typer(
    name="study",
    help="Reproduce the paper's every result, and go past it; goes on where it was, computes only what has changed.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Quick = Annotated[
    bool, typer.Option("--quick", help="A rough answer in minutes: smaller data sets, fewer repetitions.")
]
Only = Annotated[
    list[str] | None,
    typer.Option("--only", metavar="NAME", help="Only this chapter; repeatable. See `roadgrip-train study list`."),
]
Sensors = Annotated[
    list[SensorGrade] | None,
    typer.Option("--sensors", help="Only this grade of sensors; repeatable.", show_default="both"),
]
Work = Annotated[
    Path | None,
    typer.Option(
        "--work",
        metavar="FOLDER",
        help="For drives, caches and the report; goes on where it was.",
        show_default=f"{DEFAULT_WORK}, {DEFAULT_QUICK_WORK} with --quick",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        metavar="FOLDER",
        help="For the small files that a repository keeps.",
        show_default=f"{DEFAULT_OUT}; with --quick a folder inside --work",
    ),
]
StudySeed = Annotated[int, typer.Option("--seed", metavar="N", min=1, help="Changes every drive and every split.")]
Experiment = Annotated[str, typer.Option("--experiment", metavar="NAME", help="Under which mlflow keeps the runs.")]
Tracking = Annotated[
    str | None,
    typer.Option(
        "--tracking", metavar="URL", help="An mlflow server, or a database.", show_default="an SQLite file in --work"
    ),
]
NoTracking = Annotated[bool, typer.Option("--no-tracking", help="Keep no records with mlflow.")]
PlanOnly = Annotated[bool, typer.Option("--plan", help="Say what is to be done, and do nothing.")]


_HELPS = {
    Part.PAPER: """Reproduce the paper: every result as table and picture, beside the paper's number.

    Example: roadgrip-train study paper --quick --only algorithms
    """,
    Part.GENERALISE: """Go past the paper: roads and cars never seen, uncertainty, liars, closed loop, change.

    Example: roadgrip-train study generalise --quick
    """,
}


def _add_command(part: Part) -> None:
    @study_app.command(name=part.value, help=_HELPS[part])
    def command(
        *,
        quick: Quick = False,
        only: Only = None,
        sensors: Sensors = None,
        work: Work = None,
        out: Out = None,
        seed: StudySeed = 1,
        experiment: Experiment = DEFAULT_EXPERIMENT,
        tracking: Tracking = None,
        no_tracking: NoTracking = False,
        plan_only: PlanOnly = False,
    ) -> None:
        chapters = _chosen(part, only or [])
        grades = tuple(grade for grade in SensorGrade if grade in (sensors or SensorGrade))
        folder = work or (DEFAULT_QUICK_WORK if quick else DEFAULT_WORK)
        place = out or (folder / QUICK_OUT_FOLDER_NAME if quick else DEFAULT_OUT)
        show = StudyShow(console, out=place, work=folder)
        bench = StudyWorkbench(folder, quick=quick, seed=seed, on_report=show.report)
        stages = plan(bench, chapters, grades)
        _print_plan(stages)
        if plan_only:
            return
        if not no_tracking:
            tracker = _tracker(tracking, folder, experiment)
            parameters: dict[str, str | int | float] = {
                "seed": seed,
                "quick": quick,
                "only": " ".join(only or []),
                "code_version": code_version(),
            }
            show.record = StudyRecord(tracker, f"study {part.value}", parameters, tell=_warn)
        try:
            with show, kept_workers():
                conducted = conduct(bench, chapters, grades, show)
        except BaseException:  # a break by hand is no failure of a chapter, but it is the end of the records
            if show.record is not None:
                show.record.end((), well=False)
            raise
        files = _write_reports(part, bench, conducted, out=place)
        failed = [name for finding in conducted for name in finding.failures]
        if show.record is not None:
            show.record.end(files, well=not failed)
        _print_findings(conducted)
        typer.echo(f"{files[0]}, {files[1]}")
        if failed:
            raise typer.Exit(1)


for _part in Part:
    _add_command(_part)
study_app.command(name="tune")(tune_recipe)


@study_app.command(name="page")
def write_page(
    page: Annotated[Path, typer.Argument(metavar="PAGE", help="Markdown with marks where the tables go.")],
    *,
    results: Annotated[Path, typer.Option("--results", metavar="FOLDER", help="What the study left.")] = DEFAULT_OUT,
) -> None:
    """Write the headlines, and what became of each claim, between the marks of a page.

    Example: roadgrip-train study page docs/study.md
    """
    # Pictures take seconds to import: they are where they are needed.
    from training.report.study_page import study_tables

    link = os.path.relpath(results, page.parent)
    page.write_text(with_tables(page.read_text(encoding="utf-8"), study_tables(results, link=link)), encoding="utf-8")
    typer.echo(str(page))


@study_app.command(name="list")
def list_chapters(*, as_json: AsJson = False) -> None:
    """List the chapters of the study, with the data sets they take.

    Example: roadgrip-train study list
    """
    if as_json:
        listed = {
            part.value: [
                {"name": chapter.name, "title": chapter.title, "needs": list(chapter.needed(SensorGrade.AUTOMOTIVE))}
                for chapter in chapters_of(part)
            ]
            for part in Part
        }
        typer.echo(json.dumps(listed))
        return
    for part in Part:
        typer.echo(f"{part.value}: {PART_TITLES[part]}")
        for chapter in chapters_of(part):
            needed = ", ".join(chapter.needed(SensorGrade.AUTOMOTIVE)) or "no data sets"
            typer.echo(f"  {chapter.name:<18} {chapter.title} ({needed})")


def code_version() -> str:
    """Return the version of roadgrip, and what changes with the code of any chapter."""
    modules = {chapter.compute.__module__ for part in Part for chapter in chapters_of(part)}
    return f"{version('roadgrip')}+{code_digest(*sorted(modules))}"


def _chosen(part: Part, only: list[str]) -> tuple[Chapter, ...]:
    chapters = chapters_of(part)
    names = [chapter.name for chapter in chapters]
    if unknown := [name for name in only if name not in names]:
        raise typer.BadParameter(f"no chapter {', '.join(unknown)}; there are {', '.join(names)}", param_hint="--only")
    return tuple(chapter for chapter in chapters if not only or chapter.name in only)


def _tracker(address: str | None, folder: Path, experiment: str) -> Tracker:
    with console.status("opening the records"):
        if address is None:
            return local_tracker(folder, experiment=experiment)
        return Tracker(address=address, experiment=experiment)


def _write_reports(part: Part, bench: StudyWorkbench, conducted: Sequence[Finding], *, out: Path) -> tuple[Path, ...]:
    """Write the page of the part, and the headlines of both with what the other one found before."""
    # Pictures take seconds to import: they are where they are needed.
    from training.report.plotly_page import PageHead, page_of
    from training.report.small_files import write_summary

    by_name = {finding.chapter.name: finding for finding in conducted}
    findings = {each: _all_findings(each, bench, by_name) for each in Part}
    everything = [finding for each in Part for finding in findings[each]]
    document = summary(everything, seed=bench.seed, quick=bench.quick, version=code_version())
    head = PageHead(
        title=f"roadgrip, the study: {PART_TITLES[part]}",
        introduction=INTRODUCTIONS[part],
        origin=f"roadgrip-train study {part.value}{' --quick' if bench.quick else ''}, seed {bench.seed}, "
        f"code {document['code_version']}",
    )
    page = bench.folder / f"report-{part.value}.html"
    page.write_text(page_of(head, findings[part], document), encoding="utf-8")
    machine, person = write_summary(findings, document, out)
    return page, person, machine


def _all_findings(part: Part, bench: StudyWorkbench, fresh: Mapping[str, Finding]) -> tuple[Finding, ...]:
    """Return the findings of a part in order: those just made, and for other chapters those made before."""
    rest = [chapter for chapter in chapters_of(part) if chapter.name not in fresh]
    found = {**{finding.chapter.name: finding for finding in kept_findings(bench, tuple(rest))}, **fresh}
    return tuple(found[chapter.name] for chapter in chapters_of(part) if chapter.name in found)


def _print_plan(stages: Sequence[Stage]) -> None:
    table = Table("stage", "sensors", "", "took", title="Plan", title_justify="left")
    for stage in stages:
        colour = "green" if stage.state is State.DONE else "yellow"
        took = "" if stage.took is None else f"{stage.took.wall_s:.0f} s"
        name = f"data {stage.name}" if stage.is_data else stage.name
        table.add_row(name, stage.grade.value, f"[{colour}]{stage.state.value}[/{colour}]", took)
    console.print(table)


def _print_findings(findings: Sequence[Finding]) -> None:
    table = Table("chapter", "claim", "minutes", title="Findings", title_justify="left")
    for finding in findings:
        claim = "no verdict" if finding.verdict is None else finding.verdict.claim.value
        took_s = sum(done.timing.wall_s for done in finding.computed.values())
        table.add_row(finding.chapter.name, claim, f"{took_s / 60.0:.1f}")
    Console().print(table)
    for finding in findings:
        for line in finding.defects:
            console.print(Text.assemble(("defect", "red"), f" {line}"), highlight=False, soft_wrap=True)


def _warn(text: str) -> None:
    console.print(Text(text, "yellow"), highlight=False, soft_wrap=True)

"""The command that takes somebody else's recorded drives and says what a bundle makes of them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from roadgrip.errors import ConfigurationError
from roadgrip.section import RoadSection
from roadgrip.sections import packaged_names, read_section
from training.cli_designs import AsJson, console, progress_bar
from training.evaluation import DrivenPassage, Evaluation, driven_passage, evaluated, summarised_on, unreadable
from training.evaluation_figures import Ending, ErrorFigures, EvaluatedPassage
from training.evaluation_report import csv_of, document_of, words_of
from training.reference_drives import ReferenceFormat
from training.trace_folder import TraceFolder, drives_of, open_folder, read_as
from vehicle_client.pipeline import Summarised

MOST_ROWS_COUNT = 40
"""A terminal shows so many drives; all of them are in the files."""
REPORT_NAME, PASSAGES_NAME, PAGE_NAME = "report.json", "passages.csv", "report.html"


def evaluate(  # noqa: PLR0917 - typer reads options by name
    traces: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Recorded drives: CSV or Parquet, or what `simulate --raw` wrote."),
    ] = None,
    bundle: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="The model bundle.", show_default="the packaged one")
    ] = None,
    section: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Section file, or name of a packaged one; repeatable. The first that a drive passed counts.",
            show_default="FOLDER/sections/*.json, else all packaged ones",
        ),
    ] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The car.", show_default="FOLDER/vehicle.toml, else the paper's car"),
    ] = None,
    signals: Annotated[
        Path | None, typer.Option(metavar="FILE", help="signals.toml, if columns have other names or units.")
    ] = None,
    recorded_as: Annotated[
        ReferenceFormat, typer.Option("--format", help="Whose recordings they are.")
    ] = ReferenceFormat.ROADGRIP,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help=f"Write {REPORT_NAME}, {PASSAGES_NAME} and {PAGE_NAME}, with pictures."),
    ] = None,
    example: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write three drives with labels, maps and car there, to see the format."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say what a bundle makes of recorded drives: estimates, errors if friction is known, refusals, intervals.

    The drives may come from another simulator or a real car. They go through the onboard pipeline and the checks of the
    road side unit. Exit code 1 if a file could not be read. docs/evaluate.md has the columns.

    Example: roadgrip-train evaluate --example drives, then roadgrip-train evaluate --traces drives --out report
    """
    if (traces is None) == (example is None):
        raise typer.BadParameter("give recorded drives, or a folder for examples", param_hint="--traces, --example")
    if example is not None:
        _write_examples(example, as_json=as_json)
        return
    if traces is None:
        return
    if signals is not None and recorded_as is not ReferenceFormat.ROADGRIP:
        raise typer.BadParameter("signals.toml says it already; leave out the one or the other", param_hint="--format")
    if out is not None and traces.is_dir() and out.resolve().is_relative_to(traces.resolve()):
        raise typer.BadParameter(
            f"{out} lies inside {traces}: its tables would be drives next time", param_hint="--out"
        )
    from training.evaluation_bundle import judge_of, read_bundle

    loaded = read_bundle(bundle or Path(str(files("rsu_app") / "default_bundle")))
    source = open_folder(traces, read_as(recorded_as=recorded_as, signals=signals), vehicle=vehicle)
    sections = _sections(section or [], source)
    driven = _driven(source, sections)
    evaluation = evaluated(driven, judge_of(loaded))
    _check_something_read(evaluation)
    document = document_of(evaluation, bundle=loaded.manifest, sections=sections, vehicle=source.reading.vehicle)
    if out is not None:
        _write(out, document, evaluation, source, sections)
    if as_json:
        typer.echo(json.dumps(document))
    else:
        _print(evaluation, out)
    broken_count = sum(each.ending is Ending.UNREADABLE for each in evaluation.passages)
    if broken_count:
        first = next(each for each in evaluation.passages if each.ending is Ending.UNREADABLE)
        console.print(
            f"[yellow]warning:[/yellow] {broken_count} could not be read, such as {first.name}: {first.detail}",
            highlight=False,
            soft_wrap=True,
        )
        raise typer.Exit(1)


def _write_examples(folder: Path, *, as_json: bool) -> None:
    from training.example_traces import write_examples

    with console.status("driving, compiling first"):
        written = write_examples(folder)
    if as_json:
        typer.echo(json.dumps({"files": [str(path) for path in written]}))
        return
    for path in written:
        typer.echo(str(path))
    typer.echo(f"now: roadgrip-train evaluate --traces {folder}")


def _sections(named: list[str], source: TraceFolder) -> tuple[RoadSection, ...]:
    sections = tuple(read_section(place) for place in named) or source.sections
    sections = sections or tuple(read_section(name) for name in packaged_names())
    twice = [name for name, count in Counter(each.section_id for each in sections).items() if count > 1]
    if twice:
        raise ConfigurationError(f"section {twice[0]} is given more than once")
    return sections


def _driven(source: TraceFolder, sections: tuple[RoadSection, ...]) -> list[DrivenPassage]:
    driven: list[DrivenPassage] = []
    with progress_bar() as bar:
        task = bar.add_task("reading and matching", total=len(source.files), rate="")
        for count, file in enumerate(source.files, start=1):
            for drive in drives_of(file, source):
                if isinstance(drive, tuple):
                    driven.append(unreadable(*drive))
                    continue
                try:
                    driven.append(driven_passage(drive, sections))
                except ConfigurationError as error:
                    driven.append(unreadable(drive.name, str(error)))
                bar.update(task, rate=f"{len(driven)} drives")
            bar.update(task, completed=count, rate=f"{len(driven)} drives")
    return driven


def _check_something_read(evaluation: Evaluation) -> None:
    broken = [each for each in evaluation.passages if each.ending is Ending.UNREADABLE]
    if len(broken) == len(evaluation.passages):
        more = f"; nor can any of {len(broken) - 1} others" if len(broken) > 1 else ""
        first = f"{broken[0].name}: {broken[0].detail}" if broken else "there is no drive in the files"
        raise ConfigurationError(f"nothing can be read. {first}{more}")


def _write(
    folder: Path,
    document: dict[str, Any],
    evaluation: Evaluation,
    source: TraceFolder,
    sections: tuple[RoadSection, ...],
) -> None:
    from training.evaluation_page import ShownPassage, page_of, shown_of

    folder.mkdir(parents=True, exist_ok=True)
    (folder / REPORT_NAME).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    (folder / PASSAGES_NAME).write_text(csv_of(evaluation.passages), encoding="utf-8")
    chosen, shown = shown_of(evaluation.passages), None
    if chosen is not None:
        passage, why = chosen
        section = next(each for each in sections if each.section_id == passage.section_id)
        # Histories of all drives would fill the memory; one is read again.
        drive = next(
            drive
            for file in source.files
            if passage.name.startswith(file.relative_to(source.folder).as_posix())
            for drive in drives_of(file, source)
            if not isinstance(drive, tuple) and drive.name == passage.name
        )
        outcome = summarised_on(drive, section)
        if isinstance(outcome, Summarised):
            shown = ShownPassage(passage.name, why, drive.trace, section, outcome)
    (folder / PAGE_NAME).write_text(page_of(document, evaluation, shown), encoding="utf-8")


def _print(evaluation: Evaluation, out: Path | None) -> None:
    terminal = Console()
    passages = evaluation.passages
    expecting = any(each.expected_error_ratio is not None for each in passages)
    head = ["drive", "section", "label", "estimate", "error %", *(["expected %"] if expecting else [])]
    shown = Table(*head, "what became of it")
    for each in passages[:MOST_ROWS_COUNT]:
        cells = [each.name.rpartition("#")[2], each.section_id, _number(each.label_mu), _number(each.estimate_mu)]
        cells.append(_per_cent(each.error_ratio))
        cells += [_per_cent(each.expected_error_ratio)] if expecting else []
        shown.add_row(*map(escape, cells), escape(_fate(each)))
    terminal.print(shown)
    if len(passages) > MOST_ROWS_COUNT:
        where = f"all are in {out / PASSAGES_NAME}" if out else "--out FOLDER or --json has all"
        typer.echo(f"and {len(passages) - MOST_ROWS_COUNT} drives more; {where}")
    by = {**evaluation.errors, **evaluation.errors_by_section}
    by |= {f"label {band}": figures for band, figures in evaluation.errors_by_friction.items()}
    if by:
        _print_whole(_errors_table(by), terminal)
    if evaluation.intervals:
        _print_whole(_intervals_table(evaluation), terminal)
    for refusal, count in evaluation.refusals.items():
        typer.echo(f"{refusal.replace('_', ' ')}: {count}")
    if out is not None:
        typer.echo(f"written: {', '.join(str(out / name) for name in (REPORT_NAME, PASSAGES_NAME, PAGE_NAME))}")


def _print_whole(table: Table, terminal: Console) -> None:
    """Print a table of figures: a narrow terminal breaks lines, but never drops one."""
    needed = Measurement.get(terminal, terminal.options.update(max_width=1000), table).maximum
    Console(width=max(terminal.width, needed)).print(table)


def _errors_table(errors: Mapping[str, ErrorFigures]) -> Table:
    table = Table("estimates with a label", "number", "MAPE %", "relative RMS %", "bias %", "worst %")
    for name, each in errors.items():
        ratios = (each.mape_ratio, each.relative_rms_ratio, each.bias_ratio, each.worst_ratio)
        table.add_row(escape(name), str(each.passages_count), *map(_per_cent, ratios))
    return table


def _intervals_table(evaluation: Evaluation) -> Table:
    table = Table("interval by the unit's rule", "counted", "friction", "labels", "midpoint error %", "trust")
    for each in evaluation.intervals[:MOST_ROWS_COUNT]:
        interval = each.interval
        labels = "" if each.label_low_mu is None else f"{each.label_low_mu:.3f} to {each.label_high_mu:.3f}"
        table.add_row(
            escape(", ".join(part for part in (each.section_id, each.group) if part)),
            str(interval.passages_count),
            f"{interval.mu_low:.3f} to {interval.mu_new:.3f}",
            labels,
            _per_cent(each.midpoint_error_ratio),
            interval.confidence.value,
        )
    return table


def _fate(passage: EvaluatedPassage) -> str:
    if passage.ending in {Ending.COUNTED, Ending.NOT_COUNTED}:
        why = f": {', '.join(words_of(passage.flags))}" if passage.flags else ""
        remarks = words_of(passage.quality)
        remarks += [] if passage.at_least_mu is None else [f"doubtful, at least {passage.at_least_mu:.2f}"]
        remark = f" ({', '.join(remarks)})" if remarks else ""
        return f"{passage.ending.value}{why}{remark}".replace("_", " ")
    if passage.ending is Ending.UNREADABLE:
        return f"unreadable: {passage.detail}"
    return f"{passage.ending.value.replace('_', ' ')}: {passage.reason.replace('_', ' ')} ({passage.detail})"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _per_cent(ratio: float | None) -> str:
    return "" if ratio is None else f"{100.0 * ratio:.1f}"

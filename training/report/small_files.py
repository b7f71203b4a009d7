"""The findings as files that a repository keeps: JSON, CSV and SVG per chapter, Markdown for reading on a code host."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from training.report.headline_table import headline_rows
from training.report.svg_picture import svg_of
from training.report.wording import (
    CLAIM_MARKS,
    GRADE_TITLES,
    cell_text,
    is_number,
    pairs_of,
    sizes_text,
    slug,
    without_grade,
)
from training.study.chapter import Table
from training.study.documents import document_of, in_short
from training.study.finding import Finding
from training.study.picture import Picture
from training.study.registry import PART_TITLES, Part
from vehicle_client.simulator.plan import SensorGrade

SUMMARY_FILE_NAME = "summary.json"
INDEX_FILE_NAME = "README.md"
_OURS = re.compile(r"(ideal|automotive)-(table|picture)-\d+-.*\.(csv|svg)")


def write_chapter(finding: Finding, out: Path) -> tuple[Path, ...]:
    """Write one chapter's files into a folder of its name, in place of those of before, and return their paths.

    The folder holds `chapter.json`, a CSV per table, an SVG per picture, and a page that shows them all.

    Args:
        finding: The chapter.
        out: The folder of all chapters.
    """
    folder = out / finding.chapter.name
    files: dict[str, bytes] = {"chapter.json": _json(chapter_document(finding)).encode()}
    for grade, result in finding.results.items():
        for table, name in zip(result.tables, _file_names(grade, "table", result.tables), strict=True):
            files[f"{name}.csv"] = csv_of(table).encode()
        for picture, name in zip(result.pictures, _file_names(grade, "picture", result.pictures), strict=True):
            files[f"{name}.svg"] = svg_of(picture)
    files[INDEX_FILE_NAME] = chapter_page(finding, tuple(files)).encode()
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir():
        if _OURS.fullmatch(old.name) and old.name not in files:
            old.unlink()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return tuple(folder / name for name in files)


def write_summary(
    findings: Mapping[Part, Sequence[Finding]], summary: Mapping[str, Any], out: Path
) -> tuple[Path, Path]:
    """Write the headlines, as JSON and as a page that leads to the chapters, and return the paths of both.

    Args:
        findings: Of both parts, as far as they are there.
        summary: As `training.study.headlines.summary` returns it.
        out: The folder of all chapters; made if missing.
    """
    out.mkdir(parents=True, exist_ok=True)
    machine, person = out / SUMMARY_FILE_NAME, out / INDEX_FILE_NAME
    machine.write_text(_json(summary), encoding="utf-8")
    person.write_text(index_page(findings, summary), encoding="utf-8")
    return machine, person


def chapter_document(finding: Finding) -> dict[str, Any]:
    """Return all there is about a chapter as JSON has it, numbers to six digits, pictures apart: those are files."""
    chapter = finding.chapter
    results = {}
    for grade, done in finding.computed.items():
        document = document_of(done.result)
        del document["pictures"]
        results[grade.value] = {
            **document,
            "code_digest": done.code_digest,
            "data_digests": dict(done.data),
            "wall_s": round(done.timing.wall_s, 1),
            "cpu_s": round(done.timing.cpu_s, 1),
        }
    document = {
        "name": chapter.name,
        "title": chapter.title,
        "paper_says": chapter.paper_says,
        "claim": None if finding.verdict is None else finding.verdict.claim.value,
        "verdict": None if finding.verdict is None else finding.verdict.text,
        "defects": list(finding.defects),
        "results": results,
    }
    plain: dict[str, Any] = in_short(document)
    return plain


def csv_of(table: Table) -> str:
    """Return a table as CSV, numbers to six digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows([["" if cell is None else in_short(cell) for cell in row] for row in table.rows])
    return text.getvalue()


def chapter_page(finding: Finding, file_names: Sequence[str]) -> str:
    """Return the page of a chapter.

    Args:
        finding: The chapter.
        file_names: What stands beside the page.
    """
    chapter = finding.chapter
    parts = [f"# {chapter.title}"]
    if chapter.paper_says:
        parts.append("\n".join(f"> {line}".rstrip() for line in f"The paper: {chapter.paper_says}".split("\n")))
    parts.append(f"**{_claim(finding)}**")
    if finding.verdict is not None:
        parts.append(finding.verdict.text)
    if finding.defects:
        parts.append("Not as it should be:\n\n" + "\n".join(f"- {line}" for line in finding.defects))
    results = finding.results
    for pair in pairs_of({grade: result.tables for grade, result in results.items()}):
        parts.append(f"## {_heading(pair)}")
        parts += [f"**{title}**\n\n{markdown_of(table)}" for title, table in pair]
    places: dict[int, str] = {}
    for grade, result in results.items():
        for picture, name in zip(result.pictures, _file_names(grade, "picture", result.pictures), strict=True):
            places.setdefault(id(picture), name)
    for drawn in pairs_of({grade: result.pictures for grade, result in results.items()}):
        parts.append(f"## {_heading(drawn)}")
        parts += [f"**{title}**\n\n![{_in_cell(picture.title)}]({places[id(picture)]}.svg)" for title, picture in drawn]
    parts.append("## Sample sizes")
    parts.append("\n".join(f"- {GRADE_TITLES[grade]}: {sizes_text(result.sizes)}" for grade, result in results.items()))
    beside = ", ".join(f"[{name}]({name})" for name in file_names if name.endswith((".json", ".csv")))
    return "\n\n".join([*parts, f"For machines: {beside}."]) + "\n"


def index_page(findings: Mapping[Part, Sequence[Finding]], summary: Mapping[str, Any]) -> str:
    """Return the page that leads to the chapters, headlines first.

    Args:
        findings: Of both parts, as far as they are there.
        summary: As `training.study.headlines.summary` returns it.
    """
    origin = (
        f"Made by `roadgrip-train study paper` and `roadgrip-train study generalise`"
        f"{', in their quick way' if summary['quick'] else ''}; seed {summary['seed']}, code "
        f"{summary['code_version']}. For machines: [{SUMMARY_FILE_NAME}]({SUMMARY_FILE_NAME})."
    )
    parts = ["# Results of the study", origin, "## Headlines", headlines_table(summary)]
    if summary["defects"]:
        parts += ["## Not as it should be", "\n".join(f"- {line}" for line in summary["defects"])]
    for part, chapters in findings.items():
        if not chapters:
            continue
        lines = ["| chapter | the paper's claim | |", "|---|---|---|"]
        lines += [
            f"| [{_in_cell(finding.chapter.title)}]({finding.chapter.name}/{INDEX_FILE_NAME}) | {_claim(finding)} | "
            f"{_in_cell(_first_sentence(finding))} |"
            for finding in chapters
        ]
        parts += [f"## {PART_TITLES[part]}", "\n".join(lines)]
    return "\n\n".join(parts) + "\n"


def markdown_of(table: Table) -> str:
    """Return a table as Markdown."""
    numeric = [all(row[i] is None or is_number(row[i]) for row in table.rows) for i in range(len(table.columns))]
    lines = [
        f"| {' | '.join(map(_in_cell, table.columns))} |",
        f"|{'|'.join('---:' if right else '---' for right in numeric)}|",
        *(f"| {' | '.join(_in_cell(cell_text(cell)) for cell in row)} |" for row in table.rows),
    ]
    return "\n".join([*lines, "", table.note] if table.note else lines)


def _heading(pair: Sequence[tuple[str, Table]] | Sequence[tuple[str, Picture]]) -> str:
    title = pair[0][1].title
    for grade in SensorGrade:
        title = without_grade(title, grade)
    return title


def _file_names(grade: SensorGrade, kind: str, things: Sequence[Table] | Sequence[Picture]) -> list[str]:
    return [f"{grade.value}-{kind}-{i}-{slug(thing.title)}" for i, thing in enumerate(things, start=1)]


def headlines_table(summary: Mapping[str, Any]) -> str:
    """Return the headlines beside the paper and the targets as Markdown.

    Args:
        summary: As `training.study.headlines.summary` returns it, or as read from its file.
    """
    heads = [f"{grade.value}: {what}" for grade in SensorGrade for what in ("paper's configuration", "best", "target")]
    lines = [f"| quantity | paper | {' | '.join(heads)} |", f"|---|---|{'---:|' * len(heads)}"]
    for row in headline_rows(summary):
        cells = [_in_cell(row.meaning), _in_cell(row.paper)]
        for grade in SensorGrade:
            at = row.by_grade[grade]
            best = f"**{at.best}**" if at.reached else at.best
            cells += [at.paper_config, best, at.target]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join([*lines, "", "Bold: the target is reached."])


def _claim(finding: Finding) -> str:
    if finding.verdict is None:
        return "no verdict"
    return f"{CLAIM_MARKS[finding.verdict.claim]} {finding.verdict.claim.value}"


def _first_sentence(finding: Finding) -> str:
    if finding.verdict is None:
        return ""
    text = " ".join(finding.verdict.text.split())
    sentence, stop, _ = text.partition(". ")
    return sentence + ("." if stop else "")


def _in_cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def _json(document: Mapping[str, Any]) -> str:
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"

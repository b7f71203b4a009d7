"""The report of one part of the study: one HTML file that needs nothing else, for a screen, a phone and paper."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any, TypeVar

from plotly.offline import get_plotlyjs

from training.report.headline_table import HeadlineRow, headline_rows
from training.report.plotly_picture import FigureSpec, plotly_of
from training.report.wording import CLAIM_MARKS, GRADE_TITLES, cell_text, is_number, pairs_of, sizes_text, slug
from training.study.chapter import Table
from training.study.finding import Finding
from training.study.picture import Picture
from vehicle_client.simulator.plan import SensorGrade

T = TypeVar("T", Table, Picture)


@dataclass(frozen=True, slots=True)
class PageHead:
    """What stands above the chapters.

    Attributes:
        title: Of the page.
        introduction: A paragraph.
        origin: How it was made, in a line: command, version, seed.
    """

    title: str
    introduction: str
    origin: str


def page_of(head: PageHead, findings: Sequence[Finding], summary: Mapping[str, Any]) -> str:
    """Return the page as HTML.

    Args:
        head: What stands above.
        findings: The chapters, in order.
        summary: The headlines, as `training.study.headlines.summary` returns them.
    """
    figures: dict[str, FigureSpec] = {}
    body = [
        f"<header><h1>{escape(head.title)}</h1>",
        f"<p>{escape(head.introduction)}</p>",
        f'<p class="soft">{escape(head.origin)}</p></header>',
        _contents(findings),
        _defects([line for finding in findings for line in finding.defects]),
        _headlines(headline_rows(summary)),
        *(_chapter(number, finding, figures) for number, finding in enumerate(findings, start=1)),
        f'<footer class="soft">{escape(head.origin)}</footer>',
    ]
    # Inside a script a tag would end it, even within a string.
    embedded = json.dumps(figures, allow_nan=False).replace("</", "<\\/")
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(head.title)}</title>",
            f"<style>{_resource('page.css')}</style>",
            f"<script>{get_plotlyjs()}</script></head><body><main>",
            *body,
            "</main>",
            f'<script type="application/json" id="figures">{embedded}</script>',
            f"<script>{_resource('page.js')}</script></body></html>\n",
        ]
    )


def _contents(findings: Sequence[Finding]) -> str:
    lines = [
        f'<li><a href="#{slug(finding.chapter.name)}">{escape(finding.chapter.title)}</a> {_badge(finding)}</li>'
        for finding in findings
    ]
    return f"<nav><h3>Contents</h3><ol>{''.join(lines)}</ol></nav>"


def _badge(finding: Finding) -> str:
    if finding.verdict is None:
        return '<span class="badge">no verdict</span>'
    claim = finding.verdict.claim
    return f'<span class="badge {slug(claim.value)}">{CLAIM_MARKS[claim]} {escape(claim.value)}</span>'


def _defects(lines: Sequence[str]) -> str:
    if not lines:
        return ""
    listed = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f'<div class="defects"><strong>Not as it should be</strong><ul>{listed}</ul></div>'


def _headlines(rows: Sequence[HeadlineRow]) -> str:
    heads = "".join(
        f'<th class="number">{grade.value}: paper\'s configuration</th><th class="number">best</th>'
        f'<th class="number">target</th>'
        for grade in SensorGrade
    )
    lines = []
    for row in rows:
        cells = [f"<td>{escape(row.meaning)}</td>", f"<td>{escape(row.paper)}</td>"]
        for grade in SensorGrade:
            at = row.by_grade[grade]
            state = {None: "number", True: "number reached", False: "number missed"}[at.reached]
            cells += [f'<td class="number">{at.paper_config}</td>', f'<td class="{state}">{at.best}</td>']
            cells += [f'<td class="number">{at.target}</td>']
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return (
        '<section><h3>Headlines</h3><div class="wide"><table><thead><tr><th>quantity</th><th>paper</th>'
        f"{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table></div></section>"
    )


def _chapter(number: int, finding: Finding, figures: dict[str, FigureSpec]) -> str:
    chapter, results = finding.chapter, finding.results
    parts = [f'<section id="{slug(chapter.name)}"><h2>{number}. {escape(chapter.title)}</h2>']
    if chapter.paper_says:
        parts.append(f"<h3>What the paper says</h3><blockquote>{escape(chapter.paper_says)}</blockquote>")
    parts.append(f"<h3>What came of it</h3><p>{_badge(finding)}</p>")
    if finding.verdict is not None:
        parts += [f"<p>{escape(text)}</p>" for text in finding.verdict.text.split("\n\n")]
    parts.append(_defects(finding.defects))
    parts += _pairs({grade: result.tables for grade, result in results.items()}, _table)

    def drawn(picture: Picture) -> str:
        key = f"figure-{len(figures)}"
        figures[key] = plotly_of(picture)
        return (
            f"<figure><figcaption>{escape(picture.title)}</figcaption>"
            f'<div class="plot" data-figure="{key}" role="img" aria-label="{escape(picture.title)}"></div></figure>'
        )

    parts += _pairs({grade: result.pictures for grade, result in results.items()}, drawn)
    sizes = "".join(
        f"<p class='soft'>{GRADE_TITLES[grade]}: {escape(sizes_text(result.sizes))}; computed in "
        f"{finding.computed[grade].timing.wall_s / 60.0:.1f} min</p>"
        for grade, result in results.items()
    )
    return "\n".join([*parts, f"<h3>Sample sizes</h3>{sizes}</section>"])


def _pairs(shown: Mapping[SensorGrade, tuple[T, ...]], draw: Callable[[T], str]) -> list[str]:
    """Return what belongs together side by side, the grades in their order: things of one title are a pair."""
    return [
        f'<div class="pair{"" if len(pair) > 1 else " single"}">'
        + "".join(f'<div><p class="grade">{title}</p>{draw(thing)}</div>' for title, thing in pair)
        + "</div>"
        for pair in pairs_of(shown)
    ]


def _table(table: Table) -> str:
    numeric = [all(row[i] is None or is_number(row[i]) for row in table.rows) for i in range(len(table.columns))]

    def classed(tag: str, text: str, i: int) -> str:
        return f'<{tag} class="number">{escape(text)}</{tag}>' if numeric[i] else f"<{tag}>{escape(text)}</{tag}>"

    heads = "".join(classed("th", name, i) for i, name in enumerate(table.columns))
    rows = "".join(
        f"<tr>{''.join(classed('td', cell_text(cell), i) for i, cell in enumerate(row))}</tr>" for row in table.rows
    )
    note = f'<p class="soft">{escape(table.note)}</p>' if table.note else ""
    return (
        f'<div class="wide"><table><caption>{escape(table.title)}</caption>'
        f"<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>{note}"
    )


def _resource(name: str) -> str:
    return (files("training.report") / name).read_text(encoding="utf-8")

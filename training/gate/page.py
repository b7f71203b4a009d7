"""A verdict as one page that needs no other file: what was asked, what was found, and pictures of it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from importlib.resources import files

from plotly.offline import get_plotlyjs

from training.gate.thresholds import thresholds_sha256
from training.gate.verdict import Check, Verdict, in_order, verdict_digest
from training.report.plotly_picture import plotly_of
from training.report.wording import number_text
from training.study.picture import Picture

_STATES = {True: ("reached", "passed"), False: ("missed", "FAILED")}


def page_of(verdict: Verdict) -> str:
    """Return the page; the verdict alone decides what is on it."""
    title = f"Gate: {verdict.challenger} {'passed' if verdict.passed else 'did not pass'}"
    figures = {f"figure-{number}": plotly_of(picture) for number, picture in enumerate(verdict.pictures)}
    # Inside a script a tag would end it, even within a string.
    embedded = json.dumps(figures, allow_nan=False).replace("</", "<\\/")
    return "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>",
            f"<style>{_resource('page.css')}</style>",
            f"<script>{get_plotlyjs()}</script></head><body><main>",
            _head(verdict),
            _failures(verdict.failures),
            _checks(in_order(verdict.checks)),
            _holdouts(verdict),
            _pictures(verdict.pictures),
            f'<footer class="soft">Thresholds {thresholds_sha256(verdict.thresholds)}</footer>',
            "</main>",
            f'<script type="application/json" id="figures">{embedded}</script>',
            f"<script>{_resource('page.js')}</script></body></html>\n",
        ]
    )


def _head(verdict: Verdict) -> str:
    made = datetime.fromtimestamp(verdict.made_unix_s, tz=UTC).strftime("%Y-%m-%d %H:%M UTC")
    badge, word = ("confirmed", "passed") if verdict.passed else ("not-confirmed", "not passed")
    champion = "there is no champion" if verdict.champion is None else f"champion {escape(verdict.champion)}"
    return (
        f'<header><h1>Challenger {escape(verdict.challenger)} <span class="badge {badge}">{word}</span></h1>'
        f'<p>{champion}</p><p class="soft">{made}, roadgrip {escape(verdict.software_version)}, verdict '
        f"{verdict_digest(verdict)}</p></header>"
    )


def _failures(failures: Sequence[Check]) -> str:
    if not failures:
        return ""
    lines = "".join(
        f"<li><strong>{escape(check.name)}</strong>, {escape(check.subject)}: {escape(check.sentence)}</li>"
        for check in failures
    )
    return f'<div class="defects"><strong>Why it does not pass</strong><ul>{lines}</ul></div>'


def _checks(checks: Sequence[Check]) -> str:
    return "<h2>What was asked</h2>" + _table(
        ("", "check", "of what", "what was found", "figures", "limits"), [_row(check) for check in checks]
    )


def _row(check: Check) -> str:
    kind, word = _STATES[check.passed]
    if not check.required:
        kind, word = "soft", f"{'as it should be' if check.passed else 'not as it should be'}; informs only"
    cells = (check.name, check.subject, check.sentence, _named(check.figures), _named(check.limits))
    return f'<td class="{kind}">{word}</td>' + "".join(f"<td>{escape(cell)}</td>" for cell in cells)


def _named(figures: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {number_text(value)}" for name, value in figures.items())


def _holdouts(verdict: Verdict) -> str:
    rows = [
        f"<td>{escape(each.role)}</td><td>{escape(each.digest)}</td>"
        f'<td class="number">{each.rows_count}</td><td class="number">{each.usable_count}</td>'
        for each in verdict.holdouts
    ]
    return "<h2>What judged</h2>" + _table(("hold-out", "digest", "drives", "usable"), rows)


def _table(heads: Sequence[str], rows: Sequence[str]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = "".join(f"<tr>{row}</tr>\n" for row in rows)
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _pictures(pictures: Sequence[Picture]) -> str:
    drawn = "\n".join(
        f"<figure><figcaption>{escape(picture.title)}</figcaption>"
        f'<div class="plot" data-figure="figure-{number}" role="img" aria-label="{escape(picture.title)}">'
        "</div></figure>"
        for number, picture in enumerate(pictures)
    )
    return f"<h2>Pictures</h2>{drawn}" if pictures else ""


def _resource(name: str) -> str:
    return (files("training.report") / name).read_text(encoding="utf-8")

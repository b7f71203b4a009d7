"""Drift as one page that needs no other file: what to do, why, and how it went period by period."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from typing import Any

import plotly.graph_objects as go

from training.report.html_table import html_table

_MUTED = "#9a9a9a"
_COLOURS = {"keep": "#2a7f3f", "watch": "#b8860b", "retrain": "#b03030"}
_SHOWN_FEATURES_COUNT = 25
_STYLE = """
body { font-family: system-ui, sans-serif; color: #333; max-width: 1200px; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; margin: 1em 0; } td, th { padding: 0.2em 0.7em; text-align: left; }
th { border-bottom: 2px solid #999; } td { border-bottom: 1px solid #ddd; } td.number { text-align: right; }
div.wide { overflow-x: auto; font-size: 85%; } span.advice { color: white; padding: 0.1em 0.5em; border-radius: 3px; }
"""


def page_of(document: Mapping[str, Any]) -> str:
    """Return the page.

    Args:
        document: From `training.drift.report.document_of`.
    """
    sections, advice = document["sections"], document["advice"]
    days = document["period_s"] / 86_400.0
    pictures = [
        trend_figure(sections, title, read, axis)
        for title, axis, read in (
            ("Features that moved against the section's own traffic at like friction", "share, %", _own_drifted),
            ("Passages outside the model's envelope", "share, %", lambda each: 100.0 * each["out_of_envelope_frac"]),
            ("Median estimate", "friction", lambda each: each["median_mu"]),
            ("Median of shadow over live estimate, less one", "%", _shadow),
        )
    ]
    pictures = [picture for picture in [moved_figure(document["moved_most"]), *pictures] if picture is not None]
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in document["reasons"])
    parts = [
        f"<h1>Drift under bundle {escape(document['bundle_id'])}</h1>",
        f'<p>Advice: <span class="advice" style="background: {_COLOURS[advice]}">{escape(advice)}</span></p>',
        f"<ul>{reasons}</ul>",
        f"<p>Passages {_span(document)}, in periods of {days:g} days that end with the last passage.</p>",
        html_table(("left out", "passages"), [[why.replace("_", " "), n] for why, n in document["left_out"].items()]),
        "<h2>Sections in their latest period</h2>",
        '<div class="wide">',
        html_table(_SECTION_HEAD, [_section_row(each) for each in sections]),
        "</div>",
        *(picture.to_html(full_html=False, include_plotlyjs=number == 0) for number, picture in enumerate(pictures)),
        "<h2>All sections together against the training on all roads</h2>",
        "<p>Reported, no ground for alarm: weather moves most features, and so does a road.</p>",
        *(_pooled(each) for each in document["pooled"]),
    ]
    head = f'<meta charset="utf-8"><title>Drift under {escape(document["bundle_id"])}</title><style>{_STYLE}</style>'
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n{chr(10).join(parts)}\n</body></html>\n'


def trend_figure(sections: Sequence[Mapping[str, Any]], title: str, read: Any, axis: str) -> Any:
    """Return a figure of every section over its periods; None without a single value.

    Args:
        sections: Of the document.
        title: Of the picture.
        read: Takes a period and gives the figure, or None.
        axis: What the figure is.
    """
    figure, known = go.Figure(), False
    for section in sections:
        values = [read(period) for period in section["periods"]]
        known |= any(value is not None for value in values)
        figure.add_scatter(
            x=[_moment(period["from_unix_s"]) for period in section["periods"]],
            y=values,
            name=_name(section),
            mode="lines+markers",
            connectgaps=False,
        )
    if not known:
        return None
    figure.update_layout(
        title=title, yaxis_title=axis, xaxis_title="start of the period", template="plotly_white", showlegend=True
    )
    return figure


def moved_figure(moved: Sequence[Mapping[str, Any]]) -> Any:
    """Return at how many sections each feature moved, most first. None if none did."""
    if not moved:
        return None
    shown = list(reversed(moved[:_SHOWN_FEATURES_COUNT]))
    figure = go.Figure()
    figure.add_bar(
        x=[each["sections_count"] for each in shown],
        y=[each["name"] for each in shown],
        orientation="h",
        marker={"color": _MUTED},
    )
    figure.update_layout(
        title="What moved against the sections' own traffic",
        xaxis_title="sections",
        template="plotly_white",
        height=150 + 20 * len(shown),
        margin={"l": 280},
    )
    return figure


_SECTION_HEAD = (
    "unit",
    "section",
    "table",
    "passages",
    "latest",
    "outside envelope, %",
    "own traffic: moved",
    "of features",
    "passages held against it",
    "training: moved",
    "alarms",
    "moved most against own traffic",
)


def _section_row(section: Mapping[str, Any]) -> list[Any]:
    latest = section["periods"][-1]
    own, training = latest["own_traffic"], latest["training"]
    return [
        section["unit"],
        section["section_id"],
        section["table_version"],
        section["passages_count"],
        latest["passages_count"],
        100.0 * latest["out_of_envelope_frac"],
        own["drifted_count"],
        own["features_count"],
        own["rows_count"],
        training["drifted_count"],
        ", ".join(latest["alarms"]).replace("_", " "),
        ", ".join(each["name"] for each in own["worst"] if each["drifted"]),
    ]


def _pooled(pooled: Mapping[str, Any]) -> str:
    training = pooled["training"]
    title = f"<h3>Feature table {pooled['table_version']}, {pooled['passages_count']} passages</h3>"
    if training["features_count"] is None:
        return f"{title}<p>There is no reference in the bundle, or there are too few passages.</p>"
    rows = [
        [each["name"], each["psi_ratio"], each["ks_frac"], "yes" if each["drifted"] else "no"]
        for each in [training["estimate"], *training["worst"]]
    ]
    head = ("feature", "population stability index", "Kolmogorov-Smirnov distance", "moved")
    return f"{title}{html_table(head, rows)}"


def _own_drifted(period: Mapping[str, Any]) -> float | None:
    own = period["own_traffic"]
    return None if own["features_count"] is None else 100.0 * own["drifted_count"] / own["features_count"]


def _shadow(period: Mapping[str, Any]) -> float | None:
    return None if period["shadow"] is None else 100.0 * period["shadow"]["median_ratio"]


def _span(document: Mapping[str, Any]) -> str:
    return f"from {_moment(document['from_unix_s'])} to {_moment(document['until_unix_s'])}"


def _name(section: Mapping[str, Any]) -> str:
    return f"{section['section_id']} ({section['unit']})"


def _moment(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, tz=UTC).strftime("%Y-%m-%d %H:%M")

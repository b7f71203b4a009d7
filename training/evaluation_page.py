"""An evaluation as one page that needs no other file: tables, and pictures one can point at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from roadgrip.section import RoadSection
from roadgrip.units import KPH_PER_MPS, FloatArray
from training.evaluation import Evaluation
from training.evaluation_figures import EvaluatedPassage, band_of
from training.evaluation_report import PASSAGE_COLUMNS
from training.report.html_table import html_table
from vehicle_client.estimation.trace import Trace
from vehicle_client.pipeline import Summarised

_INSIDE, _INK, _MUTED = "rgba(31, 95, 168, 0.10)", "#333333", "#9a9a9a"
_NEAR_RATIO = 0.1
"""Lines in the picture of estimates against labels: so far off to either side."""
_STYLE = """
body { font-family: system-ui, sans-serif; color: #333; max-width: 1200px; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; margin: 1em 0; } td, th { padding: 0.2em 0.7em; text-align: left; }
th { border-bottom: 2px solid #999; } td { border-bottom: 1px solid #ddd; } td.number { text-align: right; }
div.wide { overflow-x: auto; font-size: 85%; }
"""


@dataclass(frozen=True, slots=True, eq=False)
class ShownPassage:
    """One drive, to be drawn closely.

    Attributes:
        name: Of the drive.
        why: Why this one.
        trace: What the sensors saw.
        section: Where it was.
        outcome: What the onboard client made of it.
    """

    name: str
    why: str
    trace: Trace
    section: RoadSection
    outcome: Summarised


def shown_of(passages: Sequence[EvaluatedPassage]) -> tuple[EvaluatedPassage, str] | None:
    """Return the drive to look at closely, and why: the estimate that is furthest off, or the first one there is."""
    labelled = [each for each in passages if each.error_ratio is not None]
    if labelled:
        return max(labelled, key=lambda each: abs(each.error_ratio or 0.0)), "the estimate that is furthest off"
    estimated = [each for each in passages if each.estimate_mu is not None]
    return (estimated[0], "the first with an estimate") if estimated else None


def page_of(document: Mapping[str, Any], evaluation: Evaluation, shown: ShownPassage | None) -> str:
    """Return the page.

    Args:
        document: From `document_of`.
        evaluation: The same.
        shown: A drive to draw closely, if there is one.
    """
    bundle = document["bundle"]
    tried = escape(", ".join(each["section_id"] for each in document["sections"]))
    pictures = [estimates_figure(evaluation.passages), errors_figure(evaluation.passages)]
    pictures = [picture for picture in pictures if picture is not None]
    if shown is not None:
        pictures.append(drive_figure(shown))
    parts = [
        f"<h1>{escape(bundle['name'])} {escape(bundle['bundle_id'])} on recorded drives</h1>",
        f"<p>Vehicle: {escape(document['vehicle'])}. Sections, in the order in which they were tried: {tried}.</p>",
        html_table(("what became of the drives", "number"), list(document["endings"].items())),
        html_table(("refused", "number"), list(document["refusals"].items())),
        *(_errors_table(document[key], title) for key, title in _ERROR_TABLES),
        _intervals_table(document["intervals"]),
        *(picture.to_html(full_html=False, include_plotlyjs=number == 0) for number, picture in enumerate(pictures)),
        '<h2>Every drive</h2><div class="wide">',
        html_table(PASSAGE_COLUMNS, [[each[name] for name in PASSAGE_COLUMNS] for each in document["passages"]]),
        "</div>",
    ]
    head = f'<meta charset="utf-8"><title>Evaluation of {escape(bundle["bundle_id"])}</title><style>{_STYLE}</style>'
    return f"<!doctype html>\n<html><head>{head}</head><body>\n{chr(10).join(parts)}\n</body></html>\n"


_ERROR_TABLES = (
    ("errors", "estimates with a label"),
    ("errors_by_section", "section"),
    ("errors_by_friction", "friction"),
)


def estimates_figure(passages: Sequence[EvaluatedPassage]) -> Any:
    """Return estimates against labels, by section; hollow where the unit would not count them. None without labels."""
    labelled = [each for each in passages if each.error_ratio is not None]
    if not labelled:
        return None
    figure = go.Figure()
    top = 1.05 * max(max(each.label_mu or 0.0, each.estimate_mu or 0.0) for each in labelled)
    for ratio, dash in ((1.0, "solid"), (1.0 - _NEAR_RATIO, "dot"), (1.0 + _NEAR_RATIO, "dot")):
        line = {"color": _MUTED, "dash": dash, "width": 1}
        figure.add_scatter(x=[0.0, top], y=[0.0, ratio * top], mode="lines", line=line, showlegend=False)
    for section_id in sorted({each.section_id for each in labelled}):
        rows = [each for each in labelled if each.section_id == section_id]
        figure.add_scatter(
            x=[each.label_mu for each in rows],
            y=[each.estimate_mu for each in rows],
            text=[each.name for each in rows],
            name=section_id,
            mode="markers",
            marker={"symbol": ["circle" if each.counted else "circle-open" for each in rows], "size": 8},
        )
    figure.update_layout(
        title="Estimate against label (hollow: not counted; dotted: 10 % off)",
        xaxis_title="label, friction",
        yaxis_title="estimate, friction",
        template="plotly_white",
        height=600,
    )
    return figure


def errors_figure(passages: Sequence[EvaluatedPassage]) -> Any:
    """Return the errors by band of friction as boxes with their points. None without labels."""
    labelled = [each for each in passages if each.error_ratio is not None]
    if not labelled:
        return None
    figure = go.Figure()
    for band in sorted({band_of(each.label_mu or 0.0) for each in labelled}):
        rows = [each for each in labelled if band_of(each.label_mu or 0.0) == band]
        figure.add_box(
            y=[100.0 * (each.error_ratio or 0.0) for each in rows],
            text=[each.name for each in rows],
            name=f"{band} ({len(rows)})",
            boxpoints="all" if len(rows) <= 200 else "outliers",
            showlegend=False,
        )
    figure.add_hline(y=0.0, line={"color": _MUTED, "width": 1})
    figure.update_layout(
        title="Error by friction",
        xaxis_title="label, friction (number of drives)",
        yaxis_title="error, % of the label",
        template="plotly_white",
    )
    return figure


def drive_figure(shown: ShownPassage) -> Any:
    """Return the signals of one drive over time, the section shaded, and what the map says of its yaw rate."""
    trace, outcome = shown.trace, shown.outcome
    signals, match, profile = outcome.signals, outcome.match, shown.section.profile
    curvature = np.interp(match.station_m, profile.station_m, profile.curvature_1pm, left=np.nan, right=np.nan)
    panels: tuple[tuple[str, tuple[tuple[str, FloatArray, str], ...]], ...] = (
        ("speed, km/h", (("wheels and observer", KPH_PER_MPS * signals.velocity_x_mps, "#1f5fa8"),)),
        ("steering, °", (("front wheels", np.rad2deg(signals.steer_rad), "#1f5fa8"),)),
        (
            "yaw rate, °/s",
            (
                ("measured", np.rad2deg(signals.yaw_rate_radps), "#1f5fa8"),
                ("curvature of the map × speed", np.rad2deg(curvature * signals.velocity_x_mps), "#d9822b"),
            ),
        ),
        ("lateral accelerometer, m/s²", (("measured", trace.accel_y_mps2, "#1f5fa8"),)),
        ("sideslip, °", (("estimated", np.rad2deg(signals.sideslip_rad), "#1f5fa8"),)),
        ("yaw rate excess, °/s", (("estimated", np.rad2deg(signals.yaw_rate_excess_radps), "#1f5fa8"),)),
    )
    figure = make_subplots(rows=len(panels), cols=1, shared_xaxes=True, vertical_spacing=0.025)
    time_s = np.round(trace.time_s - match.entry_s, 3)
    for row, (title, lines) in enumerate(panels, start=1):
        for name, values, colour in lines:
            drawn = [round(value, 4) if np.isfinite(value) else None for value in values.tolist()]
            figure.add_scatter(
                x=time_s, y=drawn, name=name, line={"color": colour, "width": 1.3}, showlegend=False, row=row, col=1
            )
        figure.update_yaxes(title_text=title, title_font={"size": 11}, row=row, col=1)
    figure.add_vrect(x0=0.0, x1=match.exit_s - match.entry_s, fillcolor=_INSIDE, line_width=0)
    how = match.method.value.replace("_", " ")
    figure.update_xaxes(title_text="seconds since the section's start (shaded: inside)", row=len(panels), col=1)
    figure.update_layout(
        title=f"{escape(shown.name)} on {shown.section.section_id}, matched by {how}: {shown.why}",
        template="plotly_white",
        font={"color": _INK},
        height=170 * len(panels),
    )
    return figure


def _errors_table(errors: Mapping[str, Mapping[str, Any]], title: str) -> str:
    head = (title, "number", "MAPE, %", "relative RMS, %", "bias, %", "worst, %")
    keys = ("mape_ratio", "relative_rms_ratio", "bias_ratio", "worst_ratio")
    rows = [
        [name, each["passages_count"], *(f"{100.0 * each[key]:.2f}" for key in keys)] for name, each in errors.items()
    ]
    return html_table(head, rows)


def _intervals_table(intervals: Sequence[Mapping[str, Any]]) -> str:
    head = (
        "section",
        "group",
        "passages",
        "interval",
        "median",
        "trust",
        "labels",
        "midpoint error, %",
        "labels inside, %",
    )
    rows = []
    for each in intervals:
        interval, labels = each["interval"], (each["label_low_mu"], each["label_high_mu"])
        rows.append(
            [
                each["section"],
                each["group"],
                interval["passages_count"],
                f"{interval['mu_low']:.3f} to {interval['mu_new']:.3f}",
                f"{interval['median_mu']:.3f}",
                interval["confidence"],
                None if labels[0] is None else f"{labels[0]:.3f} to {labels[1]:.3f}",
                _per_cent(each["midpoint_error_ratio"]),
                _per_cent(each["labels_inside_frac"]),
            ]
        )
    return html_table(head, rows)


def _per_cent(ratio: float | None) -> str | None:
    return None if ratio is None else f"{100.0 * ratio:.1f}"

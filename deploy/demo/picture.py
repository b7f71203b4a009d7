"""The picture of a finished demo, as PNG and as a page that needs nothing else."""

from __future__ import annotations

import html
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator

from deploy.demo.story import WORN_FACTOR
from roadgrip.records import AdvisoryReason, Confidence
from roadgrip.units import mps_to_kph
from vehicle_client.shell.views import advice_text

if TYPE_CHECKING:
    from deploy.demo.story import Check, Reading, Story

ROOM_FOR_TEXT_FRAC = 0.18
"""A stretch must be as long as this share of the run for its reason to fit above it."""
_SMALL: dict[str, Any] = {"fontsize": 9, "color": "#555555"}
FIGURE_INCHES = (11.0, 7.6)
TRUTH, PUBLISHED, DOT, OUTSIDE, SPEED = "#b9b9b9", "#1f5fa8", "#0b2e59", "#c65a11", "#2b2b2b"
CONFIDENCE_COLOUR = {
    Confidence.INSUFFICIENT: "#bdbdbd",
    Confidence.PROVISIONAL: "#f0b429",
    Confidence.RECOMMENDED: "#3a9d5d",
}
REASON_TEXT = {
    AdvisoryReason.FRICTION_INTERVAL: "friction interval",
    AdvisoryReason.LOWER_CONFIDENCE_BOUND: "lower confidence bound",
    AdvisoryReason.WINTER_SPEED_WHILE_PROVISIONAL: "winter speed while provisional",
    AdvisoryReason.WINTER_SPEED_FEW_VEHICLES: "winter speed, few vehicles",
    AdvisoryReason.WINTER_SPEED_STALE_WINDOW: "winter speed, window stale",
    AdvisoryReason.WINTER_SPEED_NO_MODEL: "winter speed, no model",
}


def figure_of(story: Story, *, section_name: str, speed_limit_mps: float) -> Figure:
    """Return estimates, interval, truth, confidence and advice over time."""
    figure = Figure(figsize=FIGURE_INCHES, layout="constrained")
    friction, trust, speed = figure.subplots(3, 1, sharex=True, height_ratios=(12, 0.7, 4.5))
    _draw_friction(friction, story)
    _draw_trust(trust, story)
    _draw_speed(speed, story, speed_limit_mps=speed_limit_mps)
    last_h = max([r.at_s for r in story.readings] + [0.0]) / 3600.0
    speed.set_xlim(0.0, last_h)
    speed.xaxis.set_major_formatter(lambda hours, _: _clock(hours))
    speed.xaxis.set_major_locator(MultipleLocator(0.5))
    speed.set_xlabel("time since the first vehicle could come, h:min")
    account = story.account
    figure.suptitle(
        f"{section_name}: {account.accepted_count} of {account.vehicles_count} vehicles reported, "
        f"{account.counted_count} counted; {account.air.missing_count} frames lost, "
        f"{account.recovered_count} recovered",
        fontsize=13,
    )
    return figure


def write_picture(figure: Figure, path: Path) -> None:
    """Write the figure as PNG."""
    figure.savefig(path, dpi=110)


def write_page(figure: Figure, story: Story, checks: list[Check], path: Path, *, section_name: str) -> None:
    """Write a page that holds the picture and the figures, and needs no other file."""
    drawn = io.StringIO()
    figure.savefig(drawn, format="svg")
    svg = drawn.getvalue()
    account, air = story.account, story.account.air
    counts = (
        ("vehicles", account.vehicles_count),
        ("passages acknowledged", account.accepted_count),
        ("of them counted in the window", account.counted_count),
        ("vehicles that slid off the road and sent nothing", story.off_the_road_count),
        ("frames in the air, both directions", air.offered_count),
        ("frames lost or damaged", air.missing_count),
        ("of them recovered: the passage was acknowledged all the same", account.recovered_count),
        ("frames doubled", air.doubled_count),
        ("frames that came late", air.delayed_count),
        ("most frames one vehicle sent for a passage", account.budget_peak_count),
    )
    path.write_text(
        _PAGE.format(
            title=html.escape(f"roadgrip demo: {section_name}"),
            svg=svg[svg.index("<svg") :],
            advice=html.escape(advice_text(story.readings[-1].advisory) if story.readings else "none"),
            checks="".join(
                f"<tr><td>{html.escape(c.promise)}</td><td class={'yes' if c.kept else 'no'}>"
                f"{'yes' if c.kept else 'no'}</td><td>{html.escape(c.detail)}</td></tr>"
                for c in checks
            ),
            counts="".join(f"<tr><td>{name}</td><td class=n>{count}</td></tr>" for name, count in counts),
        ),
        encoding="utf-8",
    )


def _draw_friction(axes: Any, story: Story) -> None:
    readings = story.readings
    at_h = np.array([r.at_s / 3600.0 for r in readings])
    true_mu = np.array([r.base_friction_mu for r in readings])
    axes.fill_between(at_h, WORN_FACTOR * true_mu, true_mu, step="post", color=TRUTH, alpha=0.55, linewidth=0)
    low = np.array([np.nan if r.advisory.interval is None else r.advisory.interval.mu_low for r in readings])
    high = np.array([np.nan if r.advisory.interval is None else r.advisory.interval.mu_new for r in readings])
    axes.fill_between(at_h, low, high, step="post", color=PUBLISHED, alpha=0.22, linewidth=0)
    for edge in (low, high):
        axes.plot(at_h, edge, color=PUBLISHED, linewidth=1.4, drawstyle="steps-post")
    dots = [(v.at_s / 3600.0, e.mu, e.counted) for v, e in story.estimated() if e.mu is not None]
    for counted, colour, marker in ((True, DOT, "o"), (False, OUTSIDE, "x")):
        chosen = [(x, mu) for x, mu, is_counted in dots if is_counted is counted]
        if chosen:
            axes.scatter(*zip(*chosen, strict=True), s=14, color=colour, marker=marker, linewidth=1.0, zorder=3)
    top_mu = max([mu for _, mu, _ in dots] + [float(true_mu.max()) if len(true_mu) else 0.5])
    axes.set_ylim(0.0, 1.12 * top_mu)
    axes.set_ylabel("friction")
    axes.grid(alpha=0.25)
    if story.changed_at_s is not None:
        changed_h = story.changed_at_s / 3600.0
        axes.axvline(changed_h, color="#555555", linewidth=1.0, linestyle=":")
        axes.annotate(
            f"the road turns from {story.first_mu:.2f} to {story.second_mu:.2f}",
            (changed_h, 1.12 * top_mu),
            xytext=(6, -6),
            textcoords="offset points",
            va="top",
            color="#555555",
        )
        axes.annotate(
            "the window is an hour long: until most of it is new,\nthe interval still speaks of the road before",
            (changed_h, 0.0),
            xytext=(6, 34),
            textcoords="offset points",
            **_SMALL,
        )
    handles = [
        Patch(color=TRUTH, alpha=0.55, label="truth: worn (0.8) to new tyres"),
        Patch(facecolor=PUBLISHED, alpha=0.3, edgecolor=PUBLISHED, label="interval the unit published"),
        Line2D([], [], color=DOT, marker="o", markersize=4, linestyle="", label="estimate of one vehicle"),
    ]
    if any(not counted for *_, counted in dots):
        handles.append(Line2D([], [], color=OUTSIDE, marker="x", markersize=5, linestyle="", label="not counted"))
    axes.legend(handles=handles, loc="lower left", ncols=len(handles), edgecolor="none", fontsize=9)


def _draw_trust(axes: Any, story: Story) -> None:
    axes.set_yticks([])
    axes.set_ylabel("trust", rotation=0, ha="right", va="center")
    for first, end_s in _stretches(story, lambda r: r.advisory.confidence):
        confidence = first.advisory.confidence
        begin_h, end_h = first.at_s / 3600.0, end_s / 3600.0
        axes.axvspan(begin_h, end_h, color=CONFIDENCE_COLOUR[confidence], linewidth=0)
        if end_h - begin_h > 0.1:
            axes.text((begin_h + end_h) / 2.0, 0.5, confidence.value, ha="center", va="center", fontsize=9)
    axes.set_ylim(0.0, 1.0)


def _draw_speed(axes: Any, story: Story, *, speed_limit_mps: float) -> None:
    at_h = [r.at_s / 3600.0 for r in story.readings]
    speed_kph = [mps_to_kph(r.advisory.speed_mps) for r in story.readings]
    limit_kph = mps_to_kph(speed_limit_mps)
    axes.axhline(limit_kph, color="#999999", linewidth=1.0, linestyle="--")
    axes.annotate(
        "speed limit",
        (1.0, limit_kph),
        xycoords=("axes fraction", "data"),
        xytext=(-4, -3),
        textcoords="offset points",
        ha="right",
        va="top",
        color="#777777",
        fontsize=9,
    )
    axes.plot(at_h, speed_kph, color=SPEED, linewidth=1.8, drawstyle="steps-post")
    axes.set_ylabel("advised speed, km/h")
    axes.set_ylim(0.0, 1.15 * limit_kph)
    axes.grid(alpha=0.25)
    whole_s = story.readings[-1].at_s if story.readings else 1.0
    for first, end_s in _stretches(story, lambda r: r.advisory.reason):
        kph = mps_to_kph(first.advisory.speed_mps)
        reason = REASON_TEXT[first.advisory.reason]
        if end_s - first.at_s > ROOM_FOR_TEXT_FRAC * whole_s:
            axes.annotate(reason, (first.at_s / 3600.0, kph), xytext=(4, 4), textcoords="offset points", **_SMALL)
        else:
            axes.annotate(f"← {reason}", (end_s / 3600.0, kph), xytext=(4, -4), textcoords="offset points", **_SMALL)
    for first, end_s in _stretches(story, lambda r: r.advisory.speed_mps):
        kph = mps_to_kph(first.advisory.speed_mps)
        if end_s - first.at_s > 0.02 * whole_s:
            place = (first.at_s / 3600.0, kph)
            axes.annotate(f"{kph:.0f}", place, xytext=(4, -3), textcoords="offset points", va="top", fontsize=10)


def _stretches(story: Story, key: Any) -> Iterator[tuple[Reading, float]]:
    """Yield the first reading of every stretch with the same key, and when the stretch ends."""
    first: Reading | None = None
    for reading in story.readings:
        if first is None:
            first = reading
        elif key(reading) != key(first):
            yield first, reading.at_s
            first = reading
    if first is not None:
        yield first, story.readings[-1].at_s


def _clock(hours: float) -> str:
    minutes = round(hours * 60.0)
    return f"{minutes // 60}:{minutes % 60:02d}"


_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; color: #222; }}
svg {{ width: 100%; height: auto; }}
table {{ border-collapse: collapse; margin: 1rem 0; }}
td, th {{ text-align: left; padding: .25rem .8rem .25rem 0; border-bottom: 1px solid #ddd; vertical-align: top; }}
.n {{ text-align: right; }} .yes {{ color: #1b7f3b; }} .no {{ color: #b00020; font-weight: bold; }}
</style></head><body>
<h1>{title}</h1>
<p>Each dot is one car: what its wheel speeds, steering and inertial sensors said about the road, as the road side
unit estimated it. The blue band is the interval that the unit published from the last hour of dots, the grey one the
truth that the unit never saw. Because the window is an hour long, the interval follows a sudden change within that
hour.</p>
{svg}
<p>At the end drivers were told: <strong>{advice}</strong>.</p>
<h2>What the demo promised</h2>
<table><tr><th>promise</th><th>kept</th><th>figures</th></tr>{checks}</table>
<h2>Counts</h2>
<table>{counts}</table>
</body></html>
"""

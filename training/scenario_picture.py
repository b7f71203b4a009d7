"""One picture of the centre lines of all scenarios, as an SVG file.

`python -m training.scenario_picture docs/pictures/scenarios.svg` draws the one in the docs, byte for byte the same.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.sections import read_section
from roadgrip.units import mps_to_kph
from training.friction_profiles import turnover_m
from training.manoeuvres import Manoeuvre, manoeuvre_section
from training.random_roads import random_section

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray

CELL_PX = (240.0, 200.0)
COLUMNS_COUNT = 4
_MARGIN_PX = 22.0
_HEAD_PX = 44.0
_FOOT_PX = 30.0
_BARS_M = (10.0, 20.0, 50.0, 100.0)
_LINE, _SLIPPERY, _GREY = "#334155", "#2563eb", "#808080"


@dataclass(frozen=True, slots=True)
class Sketch:
    """One cell of the picture.

    Attributes:
        title: Above the line.
        section: What is drawn.
        widening_ratio: How many times its width is drawn wider than its length.
        slippery_from_m: Station from which the line is drawn in blue.
    """

    title: str
    section: RoadSection
    widening_ratio: float = 1.0
    slippery_from_m: float | None = None


def scenario_sketches() -> tuple[Sketch, ...]:
    """Return what the picture shows, row by row."""
    s_turn = read_section("s-turn")
    return (
        Sketch("Long turn", read_section("long-turn")),
        Sketch("S-turn; two frictions", s_turn, slippery_from_m=turnover_m(s_turn)),
        Sketch("Sharp turn", read_section("sharp-turn")),
        Sketch("A random road", random_section(np.random.default_rng([5, 8]), section_id="random")),
        Sketch("Slalom", manoeuvre_section(Manoeuvre.SLALOM), widening_ratio=10.0),
        Sketch("Tight lane change", manoeuvre_section(Manoeuvre.LANE_CHANGE), widening_ratio=5.0),
        Sketch("Ninety degree turn", manoeuvre_section(Manoeuvre.NINETY_DEGREES)),
        Sketch("Sine wave", manoeuvre_section(Manoeuvre.SINE), widening_ratio=10.0),
    )


def picture_svg(sketches: tuple[Sketch, ...]) -> str:
    """Return the picture: every line from left to right, each on its own scale with a bar that tells it."""
    rows_count = -(-len(sketches) // COLUMNS_COUNT)
    width, height = CELL_PX[0] * COLUMNS_COUNT, CELL_PX[1] * rows_count
    cells = [
        f'<g transform="translate({CELL_PX[0] * (i % COLUMNS_COUNT):.0f} {CELL_PX[1] * (i // COLUMNS_COUNT):.0f})">\n'
        f"{_cell(sketch)}</g>\n"
        for i, sketch in enumerate(sketches)
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        'font-family="Helvetica, Arial, sans-serif" font-size="13">\n'
        "<title>Centre lines of the scenarios</title>\n"
        f'<rect width="{width:.0f}" height="{height:.0f}" fill="#ffffff"/>\n{"".join(cells)}</svg>\n'
    )


def _cell(sketch: Sketch) -> str:
    section = sketch.section
    points_m = _levelled(section) * [1.0, sketch.widening_ratio]
    span_m = np.ptp(points_m, axis=0)
    room_px = np.array([CELL_PX[0] - 2.0 * _MARGIN_PX, CELL_PX[1] - _HEAD_PX - _FOOT_PX - 12.0])
    scale = float(np.min(room_px / np.maximum(span_m, 1e-6)))
    middle_px = np.array([CELL_PX[0] / 2.0, _HEAD_PX + room_px[1] / 2.0])
    middle_m = points_m.min(axis=0) + span_m / 2.0
    points = middle_px + (points_m - middle_m) * [scale, -scale]
    bar_m = max((m for m in _BARS_M if m * scale <= 0.45 * room_px[0]), default=_BARS_M[0])
    bar_y = CELL_PX[1] - _FOOT_PX
    wider = f", {sketch.widening_ratio:.0f} times as wide" if sketch.widening_ratio != 1.0 else ""
    lines = _line(points, _LINE)
    if sketch.slippery_from_m is not None:
        lines += _line(points[section.profile.station_m >= sketch.slippery_from_m], _SLIPPERY)
    return (
        f'<text x="{_MARGIN_PX}" y="18" font-weight="bold">{sketch.title}</text>\n'
        f'<text x="{_MARGIN_PX}" y="34" font-size="11" fill="{_GREY}">{section.length_m:.0f} m, '
        f"tightest {section.tightest_radius_m:.0f} m, {mps_to_kph(section.speed_limit_mps):.0f} km/h</text>\n"
        f"{lines}"
        f'<circle cx="{points[0, 0]:.1f}" cy="{points[0, 1]:.1f}" r="4" fill="{_LINE}"/>\n'
        f'<path d="M{_MARGIN_PX} {bar_y}h{bar_m * scale:.1f}" stroke="{_GREY}" stroke-width="2"/>\n'
        f'<text x="{_MARGIN_PX}" y="{bar_y + 15}" font-size="11" fill="{_GREY}">{bar_m:.0f} m{wider}</text>\n'
    )


def _line(points: FloatArray, colour: str) -> str:
    steps = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return f'<polyline points="{steps}" fill="none" stroke="{colour}" stroke-width="2.5"/>\n'


def _levelled(section: RoadSection) -> FloatArray:
    """Return the centre line turned so that its end lies to the right of its start. (n, 2)"""
    profile = section.profile
    east, north = profile.x_m - profile.x_m[0], profile.y_m - profile.y_m[0]
    angle = np.arctan2(north[-1], east[-1])
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.column_stack([cosine * east + sine * north, cosine * north - sine * east])


def main(arguments: list[str]) -> int:
    """Write the picture into the file that is named."""
    if len(arguments) != 1:
        sys.stderr.write("usage: python -m training.scenario_picture FILE.svg\n")
        return 2
    Path(arguments[0]).write_text(picture_svg(scenario_sketches()), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

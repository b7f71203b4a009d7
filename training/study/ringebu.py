"""Real roads that no model has seen: bends cut out of 49 km of mountain road near Ringebu in Norway.

The road register's centre lines (positions and heights; it knows neither bank nor speed limit there) become sections by
the very fit of `roadgrip-rsu section import`. What is cut is what the random roads are made of: 50 to 600 m, one to
four turns of 20 to 500 m radius, a rated speed drawn for the tightest of them. The bank is the one by the book, as on
the paper's own reconstructed roads.

The lines are not part of this project: NVDB data under NLOD, made available by Statens vegvesen. They are looked for
beside it; where they are not, there are no sections.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from roadgrip.section import Direction, RoadSection
from roadgrip.survey import SurveyLine, survey_line
from roadgrip.survey_fit import ImportRequest, SurveyedCourse, section_of_survey, surveyed_course
from roadgrip.units import FloatArray, mps_to_kph
from training.random_roads import LENGTH_RANGE_M, RADIUS_RANGE_M, drawn_rated_speed_mps
from vehicle_client.recording.csv_table import columns_of_csv

ROADS_FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "roads"
LINES_FILE_NAME = "ringebu_vaerutsatt_centrelines.csv.gz"
SOURCE = "Norwegian National Road Data Bank (NVDB), made available by Statens vegvesen under NLOD"
CRS = "EPSG:25833"

_SEED = 27
_BENDS_LIMIT_COUNT = 4
_BEND_TURN_RAD = 0.2
"""What turns less is a wiggle of the line, no bend."""
_EDGE_M = 30.0
"""Straight road that a section keeps before its first bend and after its last, at most."""
_STRAIGHT_1PM = 1.0 / 1000.0
_END_M, _END_1PM = 8.0, 1.0 / 300.0
"""So far around either end of a section the line bends no more: nodes are that far apart, and a section that ended in a
bend would jump into it."""
_MARGIN_M = 250.0
"""So much line beyond a section's ends is fitted with it: smoothing and spline no longer feel where it is cut off."""


@dataclass(frozen=True, slots=True)
class Bend:
    """A stretch along which a line turns one way.

    Attributes:
        from_m: Where the line begins to turn.
        to_m: Where it has turned.
        turn_rad: By how much, left positive.
        tightest_radius_m: On the way.
    """

    from_m: float
    to_m: float
    turn_rad: float
    tightest_radius_m: float


@dataclass(frozen=True, slots=True)
class Cut:
    """A piece of a line that becomes a section.

    Attributes:
        from_m: Where it begins, along the line.
        to_m: Where it ends.
        tightest_radius_m: On the way.
    """

    from_m: float
    to_m: float
    tightest_radius_m: float


def ringebu_sections(folder: Path = ROADS_FOLDER) -> tuple[RoadSection, ...]:
    """Return the sections that the centre lines of a folder give, in the order of the road; none without the lines.

    The same lines give the same sections. Every other one is driven against the line's direction.

    Args:
        folder: Where `ringebu_vaerutsatt_centrelines.csv.gz` lies.

    Raises:
        TraceError: The file is no such table.
        SectionError: Its lines are no roads.
    """
    path = folder / LINES_FILE_NAME
    return _sections_of(path) if path.is_file() else ()


@cache
def _sections_of(path: Path) -> tuple[RoadSection, ...]:
    columns = columns_of_csv(path.read_bytes(), place=path.name)
    sections: list[RoadSection] = []
    for number in np.unique(columns["line"]):
        rows = columns["line"] == number
        points = np.column_stack([columns[name][rows] for name in ("east_utm33", "north_utm33", "height")])
        sections += sections_of_line(survey_line(points, crs=CRS), line_name=f"{number:.0f}")
    return tuple(sections)


def sections_of_line(line: SurveyLine, *, line_name: str) -> list[RoadSection]:
    """Return the sections that a surveyed line gives.

    Args:
        line: In a plane reference that has latitudes and longitudes.
        line_name: Becomes part of their ids: a digit or so.
    """
    course = surveyed_course(line)
    rng = np.random.default_rng([_SEED, *line_name.encode()])
    sections = []
    for number, cut in enumerate(cuts_of(course, rng)):
        rated_mps = drawn_rated_speed_mps(rng, tightest_radius_m=cut.tightest_radius_m)
        direction = Direction.WITH if number % 2 == 0 else Direction.AGAINST
        sections.append(_section(line, course, cut, line_name=line_name, rated_mps=rated_mps, direction=direction))
    return sections


def bends_of(course: SurveyedCourse) -> Iterator[Bend]:
    """Return the bends of a line in their order: where it turns one way, tightly and far enough to be one."""
    turning = np.abs(course.curvature_1pm) > _STRAIGHT_1PM
    way = np.where(turning, np.sign(course.curvature_1pm), 0.0)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(way)) + 1, [len(way)]])
    step_m = float(course.station_m[1])
    for first, last in pairwise(edges):
        curvature = course.curvature_1pm[first:last]
        turn_rad = float(curvature.sum()) * step_m
        radius_m = float(1.0 / max(np.abs(curvature).max(), 1e-9))
        if abs(turn_rad) >= _BEND_TURN_RAD and radius_m <= RADIUS_RANGE_M[1]:
            to_m = float(course.station_m[min(last, len(way) - 1)])
            yield Bend(float(course.station_m[first]), to_m, turn_rad, radius_m)


def cuts_of(course: SurveyedCourse, rng: np.random.Generator) -> Iterator[Cut]:
    """Return pieces of a line with one to four bends each, none twice, within the range of the paper's roads.

    A piece begins and ends where the line is straight, or turns over from one bend into the next.

    Args:
        course: The line.
        rng: How many bends each shall have.
    """
    bends, bending_1pm = list(bends_of(course)), _bending_around_1pm(course)
    end_m = float(course.station_m[-1]) - _MARGIN_M
    free_from_m, first = _MARGIN_M, 0
    while first < len(bends):
        wanted_count = int(rng.integers(1, _BENDS_LIMIT_COUNT + 1))
        # Where a bend turns over into the next at once there is no end: take one more, else fewer.
        for count in (*range(wanted_count, _BENDS_LIMIT_COUNT + 1), *range(wanted_count - 1, 0, -1)):
            chosen, following = bends[first : first + count], first + count
            until_m = bends[following].from_m if following < len(bends) else end_m
            low_m, high_m = max(free_from_m, chosen[0].from_m - _EDGE_M), min(until_m, chosen[-1].to_m + _EDGE_M)
            from_m = _straightest_m(course, bending_1pm, low_m, chosen[0].from_m)
            to_m = _straightest_m(course, bending_1pm, chosen[-1].to_m, high_m)
            ends_1pm = np.interp([from_m, to_m], course.station_m, bending_1pm)
            radius_m = min(bend.tightest_radius_m for bend in chosen)
            fits = LENGTH_RANGE_M[0] <= to_m - from_m <= LENGTH_RANGE_M[1] and free_from_m <= from_m and to_m <= end_m
            if fits and radius_m >= RADIUS_RANGE_M[0] and ends_1pm.max() <= _END_1PM:
                yield Cut(from_m, to_m, radius_m)
                free_from_m, first = to_m, following
                break
        else:
            first += 1


def _bending_around_1pm(course: SurveyedCourse) -> FloatArray:
    """Return how tightly a line bends at most within a few metres of every station. (n,)"""
    reach_count = round(_END_M / float(course.station_m[1]))
    bending = np.pad(np.abs(course.curvature_1pm), reach_count, mode="edge")
    tightest: FloatArray = np.lib.stride_tricks.sliding_window_view(bending, 2 * reach_count + 1).max(axis=1)
    return tightest


def _straightest_m(course: SurveyedCourse, bending_1pm: FloatArray, from_m: float, to_m: float) -> float:
    """Return where between two stations a line bends least."""
    first, last = np.searchsorted(course.station_m, [from_m, to_m])
    return float(course.station_m[first + int(np.argmin(bending_1pm[first : max(first, last) + 1]))])


def _section(
    line: SurveyLine,
    course: SurveyedCourse,
    cut: Cut,
    *,
    line_name: str,
    rated_mps: float,
    direction: Direction,
) -> RoadSection:
    """Return a section from the points around it alone: a fit of the whole line for each of them would take long."""
    at_m = course.vertex_station_m
    first = max(0, int(np.searchsorted(at_m, cut.from_m - _MARGIN_M)) - 1)
    last = min(len(at_m) - 1, int(np.searchsorted(at_m, cut.to_m + _MARGIN_M)))
    around = replace(line, points_m=line.points_m[first : last + 1])
    from_m, to_m = cut.from_m - float(at_m[first]), cut.to_m - float(at_m[first])
    if direction is Direction.AGAINST:
        whole_m = float(at_m[last] - at_m[first])
        from_m, to_m = whole_m - to_m, whole_m - from_m
    section, _ = section_of_survey(
        around,
        ImportRequest(
            section_id=f"ringebu-{line_name}-{cut.from_m:05.0f}",
            name=f"Ringebu, line {line_name} at {cut.from_m:.0f} m (NVDB, NLOD)",
            speed_limit_kph=mps_to_kph(rated_mps),
            direction=direction,
            from_m=from_m,
            to_m=to_m,
            smoothing_m=course.smoothing_m,
        ),
    )
    return section

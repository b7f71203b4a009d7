"""Roads that are almost the one that was driven: what map matching must tell apart."""

from __future__ import annotations

import itertools

import numpy as np

from roadgrip.section import RoadSection, build_section
from roadgrip.units import FloatArray

GRID_M = 1.0
NODE_STEP_M = 4.0
STRAIGHT_1PM = 1.0 / 1500.0
"""What bends less is between two bends."""

Span = tuple[int, int]


def bends_of(curvature_1pm: FloatArray) -> list[Span]:
    """Return first and last index (exclusive) of each stretch that bends one way, in order."""
    sign = np.where(np.abs(curvature_1pm) > STRAIGHT_1PM, np.sign(curvature_1pm), 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0.0], sign, [0.0]])))
    return [(int(a), int(b)) for a, b in itertools.pairwise(edges) if sign[a] != 0.0 and b - a > 3]


def profile_of(section: RoadSection) -> tuple[FloatArray, FloatArray]:
    """Return curvature and grade of a section, metre by metre."""
    profile = section.profile
    at = np.arange(0.0, section.length_m, GRID_M)
    return (
        np.interp(at, profile.station_m, profile.curvature_1pm),
        np.interp(at, profile.station_m, profile.grade_ratio),
    )


def road_of(curvature_1pm: FloatArray, grade_ratio: FloatArray, *, section_id: str, like: RoadSection) -> RoadSection:
    """Return the section with this curvature and grade, metre by metre.

    Args:
        curvature_1pm: Left turn positive. (n,)
        grade_ratio: Uphill positive. (n,)
        section_id: Its id.
        like: Gives the speed limit.
    """
    heading = np.concatenate([[0.0], np.cumsum(curvature_1pm) * GRID_M])
    middle = (heading[1:] + heading[:-1]) / 2.0
    columns = [np.cos(middle), np.sin(middle), grade_ratio]
    x, y, z = (np.concatenate([[0.0], np.cumsum(c) * GRID_M]) for c in columns)
    station = GRID_M * np.arange(len(heading))
    at = np.linspace(0.0, station[-1], max(6, round(float(station[-1]) / NODE_STEP_M) + 1))
    nodes = np.column_stack([np.interp(at, station, line) for line in (x, y, z)])
    return build_section(section_id=section_id, name=section_id, nodes_m=nodes, speed_limit_mps=like.speed_limit_mps)


def mirrored(section: RoadSection) -> RoadSection:
    """Return the road with left and right exchanged."""
    curvature, grade = profile_of(section)
    return road_of(-curvature, grade, section_id="mirrored", like=section)


def reversed_road(section: RoadSection) -> RoadSection:
    """Return the road in the other direction."""
    curvature, grade = profile_of(section)
    return road_of(-curvature[::-1], -grade[::-1], section_id="reversed", like=section)


def other_radius(section: RoadSection, *, ratio: float) -> RoadSection:
    """Return the road with the radius of its sharpest bend changed by a factor; the bend turns by the same angle."""
    curvature, grade = profile_of(section)
    first, last = max(bends_of(curvature), key=lambda span: float(np.abs(curvature[span[0] : span[1]]).max()))
    bend = _stretched(curvature[first:last], ratio) / ratio
    bend *= curvature[first:last].sum() / bend.sum()
    return road_of(
        np.concatenate([curvature[:first], bend, curvature[last:]]),
        np.concatenate([grade[:first], _stretched(grade[first:last], ratio), grade[last:]]),
        section_id="other-radius",
        like=section,
    )


def other_angle(section: RoadSection, *, angle_ratio: float, radius_ratio: float) -> RoadSection:
    """Return the road with every bend turning by another angle at another radius."""
    curvature, grade = profile_of(section)
    pieces, grades, done = [], [], 0
    for first, last in bends_of(curvature):
        stretch = angle_ratio * radius_ratio
        pieces += [curvature[done:first], _stretched(curvature[first:last], stretch) / radius_ratio]
        grades += [grade[done:first], _stretched(grade[first:last], stretch)]
        done = last
    return road_of(
        np.concatenate([*pieces, curvature[done:]]),
        np.concatenate([*grades, grade[done:]]),
        section_id="other-angle",
        like=section,
    )


def moved_bend(section: RoadSection, *, by_m: float) -> RoadSection | None:
    """Return the road with its last bend so much further along, or None where there is but one bend."""
    curvature, grade = profile_of(section)
    bends = bends_of(curvature)
    if len(bends) < 2:
        return None
    gap = (bends[-2][1] + bends[-1][0]) // 2
    count = round(by_m / GRID_M)
    return road_of(
        np.concatenate([curvature[:gap], np.zeros(count), curvature[gap:]]),
        np.concatenate([grade[:gap], np.full(count, grade[gap]), grade[gap:]]),
        section_id="moved-bend",
        like=section,
    )


def fork(section: RoadSection, other: RoadSection, *, own_first: bool) -> RoadSection:
    """Return one half of a road and then a half of another: what was driven is only a part of the map.

    Args:
        section: The road that was driven.
        other: The one that takes its place.
        own_first: Whether the driven half comes first.
    """
    own, foreign = profile_of(section), profile_of(other)
    halves = []
    for mine, theirs in zip(own, foreign, strict=True):
        mine_first, theirs_first = len(mine) // 2, len(theirs) // 2
        halves.append(
            np.concatenate(
                [mine[:mine_first], theirs[theirs_first:]] if own_first else [theirs[:theirs_first], mine[mine_first:]]
            )
        )
    return road_of(halves[0], halves[1], section_id="fork", like=section)


def part(section: RoadSection, *, first_frac: float, last_frac: float) -> RoadSection:
    """Return a stretch of a road as a section of its own."""
    curvature, grade = profile_of(section)
    chosen = slice(round(first_frac * len(curvature)), round(last_frac * len(curvature)))
    return road_of(curvature[chosen], grade[chosen], section_id="part", like=section)


def _stretched(values: FloatArray, ratio: float) -> FloatArray:
    count = max(4, round(len(values) * ratio))
    return np.interp(np.linspace(0.0, len(values) - 1.0, count), np.arange(len(values)), values)

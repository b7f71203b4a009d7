"""The polyline that somebody surveyed, before anything is smoothed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import SectionError
from roadgrip.geodesy import GEOGRAPHIC_CODES, LATITUDE_LIMIT_DEG, lat_lon_to_utm, utm_zone_of_crs, utm_zone_of_lon

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from roadgrip.units import FloatArray

POINTS_LIMIT_COUNT = 50_000
PIECES_LIMIT_COUNT = 500
JOINT_TOLERANCE_M = 1.0
"""Ends of pieces closer than this are the same point of the road."""
_SAME_POINT_M = 0.05
_HEIGHT_LIMITS_M = (-500.0, 9000.0)
_PLANE_LIMIT_M = 2e7


@dataclass(frozen=True, slots=True)
class SurveyLine:
    """Points on the centre line of a road or lane, in order.

    Attributes:
        crs: Plane coordinate reference such as "EPSG:25833", or "local".
        points_m: East, north, height. (n, 3)
        has_heights: False when the source knew none; the third column is then zero.
        cross_slope_ratio: Rise towards the left edge, if it was measured. (n,)
        bank_ratio: Inward bank, if that was measured instead. (n,)
        speed_limit_kph: Every speed limit the source gives, in order of size; zero means that it knows none.
    """

    crs: str
    points_m: FloatArray
    has_heights: bool
    cross_slope_ratio: FloatArray | None = None
    bank_ratio: FloatArray | None = None
    speed_limit_kph: tuple[float, ...] = ()


def refusal(problem: str) -> SectionError:
    """Return the error that every parser of this package raises."""
    return SectionError(f"road import: {problem}")


def survey_line(
    points: Sequence[Sequence[float]] | FloatArray,
    *,
    crs: str,
    cross_slope_ratio: Sequence[float] | None = None,
    bank_ratio: Sequence[float] | None = None,
    speed_limits_kph: Iterable[float] = (),
) -> SurveyLine:
    """Return a checked line; degrees become metres, and points that repeat their predecessor are dropped.

    Args:
        points: Rows of east, north and perhaps height; or of longitude, latitude and perhaps height if `crs` is
            geographic.
        crs: "EPSG:...", or "local".
        cross_slope_ratio: One per point.
        bank_ratio: One per point.
        speed_limits_kph: Limits that the source gives, as often as it likes.

    Raises:
        SectionError: A number cannot be, or fewer than two points remain.
    """
    if len(points) > POINTS_LIMIT_COUNT:
        raise refusal(f"{len(points)} points; at most {POINTS_LIMIT_COUNT} are read")
    widths = {len(row) for row in points}
    if not widths <= {2, 3} or len(widths) != 1:
        raise refusal("a line needs points that all have two or all have three coordinates")
    rows = np.array(points, dtype=np.float64)
    if not np.isfinite(rows).all():
        raise refusal("a coordinate is not a finite number")
    has_heights = rows.shape[1] == 3
    if not has_heights:
        rows = np.column_stack([rows, np.zeros(len(rows))])
    low, high = _HEIGHT_LIMITS_M
    strange = np.flatnonzero((rows[:, 2] < low) | (rows[:, 2] > high))
    if strange.size:
        raise refusal(
            f"{rows[strange[0], 2]:g} m at point {strange[0] + 1} is no height of a road; registers mark gaps so"
        )
    plane_crs, rows = _on_plane(rows, crs)
    slopes = None if cross_slope_ratio is None else np.array(cross_slope_ratio, dtype=np.float64)
    banks = None if bank_ratio is None else np.array(bank_ratio, dtype=np.float64)
    for name, values in (("cross_slope_ratio", slopes), ("bank_ratio", banks)):
        if values is not None and not (np.abs(values) <= 0.25).all():
            raise refusal(f"{name} beyond 0.25 is no road; it is a ratio, not per cent or degrees")
    keep = np.concatenate([[True], np.hypot(*np.diff(rows[:, :2], axis=0).T) > _SAME_POINT_M])
    if keep.sum() < 2:
        raise refusal("the line has no length")
    return SurveyLine(
        crs=plane_crs,
        points_m=rows[keep],
        has_heights=has_heights,
        cross_slope_ratio=None if slopes is None else slopes[keep],
        bank_ratio=None if banks is None else banks[keep],
        speed_limit_kph=tuple(sorted({float(v) for v in speed_limits_kph})),
    )


def reversed_survey(line: SurveyLine) -> SurveyLine:
    """Return the same line driven the other way: what rose to the left now rises to the right."""
    return dataclasses.replace(
        line,
        points_m=line.points_m[::-1].copy(),
        cross_slope_ratio=None if line.cross_slope_ratio is None else -line.cross_slope_ratio[::-1],
        bank_ratio=None if line.bank_ratio is None else line.bank_ratio[::-1].copy(),
    )


def joined(pieces: Sequence[SurveyLine]) -> SurveyLine:
    """Return the one line that pieces without attributes make when laid end to end.

    The first piece gives the direction; the others may come in any order and direction.

    Raises:
        SectionError: They do not form one line; the message says how wide the gap is.
    """
    if not pieces:
        raise refusal("there is no line in it")
    if len(pieces) > PIECES_LIMIT_COUNT:
        raise refusal(f"{len(pieces)} pieces; at most {PIECES_LIMIT_COUNT} are joined")
    if len({p.crs for p in pieces}) > 1:
        raise refusal(f"pieces in different coordinate references: {', '.join(sorted({p.crs for p in pieces}))[:80]}")
    chain = pieces[0].points_m
    rest = [p.points_m for p in pieces[1:]]
    while rest:
        gaps = [_gap(chain, points) for points in rest]
        nearest = int(np.argmin([gap for gap, _ in gaps]))
        gap, how = gaps[nearest]
        if gap > JOINT_TOLERANCE_M:
            raise refusal(
                f"the pieces do not form one line: {len(rest)} of {len(pieces)} remain, the nearest {gap:.1f} m away; "
                "cut the file to one carriageway without gaps"
            )
        points = rest.pop(nearest)
        points = points[::-1] if how in {"tail-tail", "head-head"} else points
        chain = np.concatenate([chain, points] if how.startswith("tail") else [points, chain])
    line = survey_line(
        chain, crs=pieces[0].crs, speed_limits_kph=[limit for p in pieces for limit in p.speed_limit_kph]
    )
    return dataclasses.replace(line, has_heights=all(p.has_heights for p in pieces))


def _gap(chain: FloatArray, points: FloatArray) -> tuple[float, str]:
    """Return how far a piece lies from the end of the chain it fits best, and how it then attaches."""
    ends = {
        "tail-head": chain[-1] - points[0],
        "tail-tail": chain[-1] - points[-1],
        "head-tail": chain[0] - points[-1],
        "head-head": chain[0] - points[0],
    }
    how = min(ends, key=lambda key: float(np.hypot(*ends[key][:2])))
    return float(np.hypot(*ends[how][:2])), how


def _on_plane(rows: FloatArray, crs: str) -> tuple[str, FloatArray]:
    """Return the reference of a plane, and the rows in it."""
    if crs.upper() in GEOGRAPHIC_CODES:
        lon, lat = rows[:, 0], rows[:, 1]
        if np.abs(lat).max() > LATITUDE_LIMIT_DEG or np.abs(lon).max() > 180.0 or lat.min() < 0.0:
            raise refusal("latitudes must be 0 to 84 degrees, longitudes -180 to 180; GeoJSON puts the longitude first")
        zone = utm_zone_of_lon(float(lon[0]))
        east, north = lat_lon_to_utm(lat, lon, zone=zone)
        plane = np.column_stack([east, north, rows[:, 2]])
        if not np.isfinite(plane).all():
            raise refusal("the line spans half the globe")
        return f"EPSG:{32600 + zone}", plane
    if np.abs(rows).max() > _PLANE_LIMIT_M:
        raise refusal("a coordinate lies beyond the Earth; are they metres?")
    if crs != "local":
        utm_zone_of_crs(crs)
        crs = crs.upper()
        if (rows[:, 0].min() < -1e6) or (rows[:, 0].max() > 2e6) or rows[:, 1].min() < 0.0 or rows[:, 1].max() > 9.4e6:
            raise refusal(f"coordinates such as {rows[0, 0]:g}, {rows[0, 1]:g} do not lie in {crs}; east comes first")
    return crs, rows

"""A known section as a line on a plane, and where one position lies beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from roadgrip.errors import SectionError
from roadgrip.geodesy import frame_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from roadgrip.section import GnssAnchor, RoadSection
    from roadgrip.units import FloatArray

LINE_STEP_M = 5.0
"""On the tightest road we know (30 m of radius) a chord of 5 m lies 0.1 m beside it."""
_EARTH_RADIUS_M = 6_371_000.0


class Plane(Protocol):
    """Degrees to metres somewhere on Earth."""

    def to_local(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return x (east) and y (north)."""
        ...


@dataclass(frozen=True, slots=True)
class TangentPlane:
    """The plane that touches the (round) Earth in one point; within 0.5 % of true lengths over some kilometres.

    Attributes:
        lat_deg: Of the point.
        lon_deg: Of the point.
    """

    lat_deg: float
    lon_deg: float

    def to_local(self, lat_deg: ArrayLike, lon_deg: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return x (east) and y (north) in metres."""
        away_deg = (np.asarray(lon_deg, dtype=np.float64) - self.lon_deg + 180.0) % 360.0 - 180.0
        x = np.deg2rad(away_deg) * _EARTH_RADIUS_M * np.cos(np.deg2rad(self.lat_deg))
        y = np.deg2rad(np.asarray(lat_deg, dtype=np.float64) - self.lat_deg) * _EARTH_RADIUS_M
        return x, y


@dataclass(frozen=True, slots=True)
class Place:
    """Where a position lies, seen from a section.

    Attributes:
        station_m: Along the line; beyond its ends as if it went on straight.
        lateral_m: Beside it, left positive.
        apart_m: Distance to the nearest point of the section.
        to_start_m: As the crow flies.
        to_end_m: As the crow flies.
    """

    station_m: float
    lateral_m: float
    apart_m: float
    to_start_m: float
    to_end_m: float


@dataclass(frozen=True, eq=False, slots=True)
class SectionLine:
    """What a car needs of a section to know that it nears it.

    Attributes:
        section_id: Its name.
        length_m: Of its centre line.
        station_m: Of the points. (k,)
        x_m: Of the points. (k,)
        y_m: Of the points. (k,)
        plane: Takes positions to that plane; None where the map has no positions (a local reference).
    """

    section_id: str
    length_m: float
    station_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    plane: Plane | None

    def place_of(self, *, lat_deg: float, lon_deg: float) -> Place | None:
        """Return where a position lies, or None if the section has none itself."""
        if self.plane is None or len(self.station_m) < 2:
            return None
        x, y = (float(v) for v in self.plane.to_local(lat_deg, lon_deg))
        if not np.isfinite(x + y):
            return None
        step_x, step_y = np.diff(self.x_m), np.diff(self.y_m)
        square = np.maximum(step_x**2 + step_y**2, 1e-12)
        from_x, from_y = x - self.x_m[:-1], y - self.y_m[:-1]
        along = (from_x * step_x + from_y * step_y) / square
        clipped = np.clip(along, 0.0, 1.0)
        apart = np.hypot(from_x - clipped * step_x, from_y - clipped * step_y)
        at = int(np.argmin(apart))
        # Beyond its ends the line goes on straight; in between a point beyond a corner belongs to the corner.
        low = -np.inf if at == 0 else 0.0
        high = np.inf if at == len(along) - 1 else 1.0
        share = float(np.clip(along[at], low, high))
        length = float(np.sqrt(square[at]))
        return Place(
            station_m=float(self.station_m[at]) + share * float(self.station_m[at + 1] - self.station_m[at]),
            lateral_m=float(step_x[at] * from_y[at] - step_y[at] * from_x[at]) / length,
            apart_m=float(apart[at]),
            to_start_m=float(np.hypot(x - self.x_m[0], y - self.y_m[0])),
            to_end_m=float(np.hypot(x - self.x_m[-1], y - self.y_m[-1])),
        )


def line_of_section(section: RoadSection) -> SectionLine:
    """Return the line of a map; without a plane if its anchors cannot be used."""
    profile = section.profile
    count = max(2, round(section.length_m / LINE_STEP_M) + 1)
    station = np.linspace(0.0, section.length_m, count)
    try:
        plane = frame_of(section)
    except SectionError:
        plane = None
    return SectionLine(
        section_id=section.section_id,
        length_m=section.length_m,
        station_m=station,
        x_m=np.interp(station, profile.station_m, profile.x_m),
        y_m=np.interp(station, profile.station_m, profile.y_m),
        plane=plane,
    )


def line_of_anchors(section_id: str, *, length_m: float, anchors: tuple[GnssAnchor, ...]) -> SectionLine:
    """Return the line of a section of which only the anchors are known, as a unit's listing shows them.

    Anchors stand about 100 m apart, so on a bend the chords lie some metres beside the road: good enough to see that
    a section comes, and replaced by the map's line when that arrives.
    """
    if len(anchors) < 2:
        empty = np.zeros(0)
        return SectionLine(section_id, length_m, empty, empty, empty, plane=None)
    plane = TangentPlane(anchors[0].lat_deg, anchors[0].lon_deg)
    x, y = plane.to_local([a.lat_deg for a in anchors], [a.lon_deg for a in anchors])
    return SectionLine(section_id, length_m, np.array([a.station_m for a in anchors]), x, y, plane)

"""What a person wants to know of a section: its curves, its extremes, and a sketch that fits a terminal."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from roadgrip.errors import WireError
from roadgrip.features import TABLES
from roadgrip.protocol import FRAGMENT_BYTES, FRAMES_LIMIT_COUNT, Kind
from roadgrip.records import MapOffer
from roadgrip.signing import SIGNED_MORE_BYTES
from roadgrip.units import mps_to_kph
from roadgrip.wire import encode_message

if TYPE_CHECKING:
    from roadgrip.section import RoadSection

MAP_LIMIT_BYTES = FRAMES_LIMIT_COUNT[Kind.MAP] * FRAGMENT_BYTES
CURVE_SHARE = 0.25
"""A curve is where the road bends at least this share of its sharpest bend, to one side."""
_STRAIGHT_RADIUS_M = 1000.0
_TURN_FLOOR_DEG = 3.0
_BARS = " ▁▂▃▄▅▆▇█"
_BRAILLE_BITS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve of a section.

    Attributes:
        start_m: Station where it begins.
        length_m: How long it is.
        tightest_radius_m: Its sharpest point.
        mean_radius_m: Length over turned angle.
        turn_rad: Turned angle, left positive.
        bank_ratio: Largest bank in it.
        ideal_bank_ratio: Largest bank that road design asks for, uncapped.
    """

    start_m: float
    length_m: float
    tightest_radius_m: float
    mean_radius_m: float
    turn_rad: float
    bank_ratio: float
    ideal_bank_ratio: float

    @property
    def direction(self) -> str:
        """Which way it turns."""
        return "left" if self.turn_rad > 0.0 else "right"


def curves_of(section: RoadSection) -> tuple[Curve, ...]:
    """Return the curves of a section in order; a straight has none.

    A curve is a stretch that bends to one side at least a quarter as sharply as the section's sharpest point, and
    turns by 3 degrees or more.
    """
    profile = section.profile
    floor = max(CURVE_SHARE * float(np.abs(profile.curvature_1pm).max()), 1.0 / _STRAIGHT_RADIUS_M)
    side = np.where(np.abs(profile.curvature_1pm) >= floor, np.sign(profile.curvature_1pm), 0.0)
    bounds = np.flatnonzero(np.diff(np.concatenate([[0.0], side, [0.0]])))
    curves = []
    for first, end in pairwise(bounds.tolist()):
        if side[first] == 0.0:
            continue
        last = min(end, len(side) - 1)
        length = float(profile.station_m[last] - profile.station_m[first])
        turn = float(profile.heading_rad[last] - profile.heading_rad[first])
        if abs(np.rad2deg(turn)) < _TURN_FLOOR_DEG:
            continue
        curves.append(
            Curve(
                start_m=float(profile.station_m[first]),
                length_m=length,
                tightest_radius_m=float(1.0 / np.abs(profile.curvature_1pm[first:end]).max()),
                mean_radius_m=length / abs(turn),
                turn_rad=turn,
                bank_ratio=float(profile.bank_ratio[first:end].max()),
                ideal_bank_ratio=float(profile.ideal_bank_ratio[first:end].max()),
            )
        )
    return tuple(curves)


def section_figures(section: RoadSection) -> dict[str, Any]:
    """Return everything `roadgrip-rsu section show` tells, as plain values with their units in the names."""
    profile = section.profile
    return {
        "section_id": section.section_id,
        "name": section.name,
        "version": section.version,
        "direction": section.direction.value,
        "crs": section.crs,
        "length_m": round(section.length_m, 2),
        "speed_limit_mps": section.speed_limit_mps,
        "tightest_radius_m": round(section.tightest_radius_m, 1),
        "curves": [
            {
                "start_m": round(c.start_m, 1),
                "length_m": round(c.length_m, 1),
                "tightest_radius_m": round(c.tightest_radius_m, 1),
                "mean_radius_m": round(c.mean_radius_m, 1),
                "turn_rad": round(c.turn_rad, 3),
                "direction": c.direction,
                "bank_max_ratio": round(c.bank_ratio, 4),
                "ideal_bank_max_ratio": round(c.ideal_bank_ratio, 4),
            }
            for c in curves_of(section)
        ],
        "bank_origin": section.bank_origin.value,
        "bank_max_ratio": round(float(profile.bank_ratio.max()), 4),
        "bank_cap_ratio": section.bank_cap_ratio,
        "ideal_bank_max_ratio": round(float(profile.ideal_bank_ratio.max()), 4),
        "road_difficulty_max_ratio": round(float(profile.road_difficulty_ratio.max()), 4),
        "lateral_acceleration_at_limit_max_mps2": round(
            float(np.abs(profile.curvature_1pm).max()) * section.speed_limit_mps**2, 2
        ),
        "grade_min_ratio": round(float(profile.grade_ratio.min()), 4),
        "grade_max_ratio": round(float(profile.grade_ratio.max()), 4),
        "rise_m": round(float(profile.z_m[-1] - profile.z_m[0]), 2),
        "nodes_count": len(section.nodes_m),
        "anchors_count": len(section.anchors),
        **_wire_figures(section),
    }


def headline(section: RoadSection) -> str:
    """Return the section in one line."""
    return (
        f"{section.name} ({section.section_id}): {section.length_m:.0f} m, tightest radius "
        f"{section.tightest_radius_m:.0f} m, {mps_to_kph(section.speed_limit_mps):.0f} km/h"
    )


def plan_sketch(section: RoadSection, *, columns: int = 44, rows: int = 14) -> str:
    """Return the plan view in Braille dots, north up, with S at the start and E at the end.

    Args:
        section: The map.
        columns: Width in characters.
        rows: Height in characters, at most; a flat road takes fewer.
    """
    profile = section.profile
    span_x, span_y = float(np.ptp(profile.x_m)), float(np.ptp(profile.y_m))
    dots_x, dots_y = 2 * columns - 1, 4 * rows - 1
    scale = min(dots_x / max(span_x, 1e-6), dots_y / max(span_y, 1e-6))
    u = np.rint((profile.x_m - profile.x_m.min()) * scale).astype(int)
    v = np.rint((profile.y_m.max() - profile.y_m) * scale).astype(int)
    cells = np.zeros((int(v.max()) // 4 + 1, int(u.max()) // 2 + 1), dtype=int)
    for a, b in zip(u, v, strict=True):
        cells[b // 4, a // 2] |= _BRAILLE_BITS[b % 4][a % 2]
    text = [[chr(0x2800 + dot) if dot else " " for dot in row] for row in cells]
    text[v[0] // 4][u[0] // 2] = "S"
    text[v[-1] // 4][u[-1] // 2] = "E"
    return "\n".join("".join(row).rstrip() for row in text)


def curvature_sketch(section: RoadSection, *, columns: int = 60) -> str:
    """Return two lines of bars over the station: how sharply the road turns left, and how sharply right."""
    curvature = section.profile.curvature_1pm
    peak = max(float(np.abs(curvature).max()), 1e-9)
    parts = np.array_split(curvature, min(columns, len(curvature)))
    left = "".join(_bar(max(0.0, float(part.max())) / peak) for part in parts)
    right = "".join(_bar(max(0.0, float(-part.min())) / peak) for part in parts)
    return f"left  |{left}|\nright |{right}|"


def _bar(share: float) -> str:
    return _BARS[round(share * (len(_BARS) - 1))]


def map_message_problem(section: RoadSection) -> str | None:
    """Return why vehicles could not be sent this map, or None if it can be sent, signed or not."""
    try:
        size_bytes = len(encode_message(MapOffer(section, tuple(TABLES))))
    except WireError as error:
        return error.detail
    if size_bytes + SIGNED_MORE_BYTES > MAP_LIMIT_BYTES:
        return f"a map of {size_bytes} bytes; {MAP_LIMIT_BYTES - SIGNED_MORE_BYTES} leave room for a signature"
    return None


def _wire_figures(section: RoadSection) -> dict[str, int | None]:
    """Return what the unsigned map costs on the air; nothing known if it cannot be sent."""
    if map_message_problem(section) is not None:
        return {"map_message_bytes": None, "map_message_frames_count": None}
    size_bytes = len(encode_message(MapOffer(section, tuple(TABLES))))
    return {"map_message_bytes": size_bytes, "map_message_frames_count": -(-size_bytes // FRAGMENT_BYTES)}

"""The map of one designated stretch of curved road.

A section is a handful of nodes on the centre line of a lane, in the direction of travel. A cubic spline through
them gives a line whose curvature is continuous; everything else (length, curvature, grade, ideal bank, road
difficulty) follows from the nodes and the speed limit, and is computed by the same code wherever it is needed.

Nodes are rounded to whole millimetres and cross slopes to 1e-4 when a section is built. What a vehicle decodes from
the air is therefore the very section the unit encoded, with the same version and the same features to the last bit.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from roadgrip.errors import SectionError
from roadgrip.spline import evaluate, second_derivatives
from roadgrip.units import mps_to_kph

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from roadgrip.units import FloatArray

NODE_QUANTUM_M = 0.001
SLOPE_QUANTUM = 1e-4
NODE_STEP_LIMIT_M = 30.0
"""Nodes lie at most this far apart per axis: the wire format stores steps as 16-bit millimetres."""
NODES_LIMIT_COUNT = 1000
NODE_LIMIT_M = 1e5
ORIGIN_LIMIT_M = 1e8
ANCHORS_LIMIT_COUNT = 200
CROSS_SLOPE_LIMIT = 0.25
SPEED_QUANTUM_MPS = 0.01
LENGTH_LIMITS_M = (20.0, 10_000.0)
BANK_CAP_RATIO = 0.08
"""Cap of the physical bank as a slope. The paper says 8 degrees, road guidelines say 8 %; we follow the latter."""
SIDE_FRICTION = 0.14
"""Side friction that road design counts on (the paper, equation of the ideal bank)."""
STATION_STEP_M = 1.0


class Direction(StrEnum):
    """The direction of travel, relative to the direction in which the road register counts metres."""

    WITH = "with"
    AGAINST = "against"


class BankOrigin(StrEnum):
    """Where the cross slopes come from."""

    MEASURED = "measured"
    INFERRED = "inferred"
    """Computed by `inferred_bank_ratio` from curvature and speed limit. Advice never counts on such a bank."""
    NONE = "none"
    """Unknown; taken as zero."""


@dataclass(frozen=True, slots=True)
class GnssAnchor:
    """One point of the centre line in geographic coordinates (WGS 84)."""

    station_m: float
    lat_deg: float
    lon_deg: float


@dataclass(frozen=True, slots=True)
class SectionProfile:
    """The centre line sampled about every metre; all arrays have the same length.

    Attributes:
        station_m: Horizontal distance travelled from the start.
        x_m: East of the origin.
        y_m: North of the origin.
        z_m: Above the origin.
        heading_rad: Direction of travel, counter-clockwise from east, unwrapped.
        curvature_1pm: Left turn positive.
        grade_ratio: Rise over horizontal distance, uphill positive.
        cross_slope_ratio: Rise towards the left edge over horizontal distance.
        bank_ratio: Inward bank within 0 and the cap: the part of the cross slope that helps in the turn.
        ideal_bank_ratio: Bank that road design asks for, uncapped; negative where none is needed.
        road_difficulty_ratio: The road difficulty index, tan(theta_ideal - theta_actual).
    """

    station_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray
    heading_rad: FloatArray
    curvature_1pm: FloatArray
    grade_ratio: FloatArray
    cross_slope_ratio: FloatArray
    bank_ratio: FloatArray
    ideal_bank_ratio: FloatArray
    road_difficulty_ratio: FloatArray


@dataclass(frozen=True, eq=False)
class RoadSection:
    """A directed stretch of curved road, as `build_section` makes it.

    Two sections are equal when their versions are.

    Attributes:
        section_id: Short name, unique in a road network: lower-case letters, digits and hyphens, at most 48.
        name: What people call it.
        direction: Direction of travel.
        crs: Coordinate reference of the origin, such as "EPSG:25833", or "local".
        origin_m: East, north and height of the first node in that reference.
        nodes_m: East, north and up of the nodes relative to the origin, whole millimetres. (n, 3)
        cross_slope_ratio: Rise towards the left edge at the nodes. (n,)
        bank_origin: Where the cross slopes come from.
        speed_limit_mps: Rated speed.
        bank_cap_ratio: Largest physical bank that is believed.
        anchors: Points with geographic coordinates, in order of station; may be empty for a local reference.
    """

    section_id: str
    name: str
    direction: Direction
    crs: str
    origin_m: tuple[float, float, float]
    nodes_m: FloatArray
    cross_slope_ratio: FloatArray
    bank_origin: BankOrigin
    speed_limit_mps: float
    bank_cap_ratio: float = BANK_CAP_RATIO
    anchors: tuple[GnssAnchor, ...] = field(default=())

    def __eq__(self, other: object) -> bool:
        """Return whether both are the same map."""
        return isinstance(other, RoadSection) and self.version == other.version

    def __hash__(self) -> int:
        """Return a hash of the version."""
        return hash(self.version)

    @cached_property
    def version(self) -> str:
        """Digest of everything in the map: sixteen hexadecimal characters."""
        digest = hashlib.sha256()
        head = [
            self.section_id,
            self.name,
            self.direction.value,
            self.crs,
            *(f"{c:.3f}" for c in self.origin_m),
            self.bank_origin.value,
            f"{self.speed_limit_mps:.2f}",
            f"{self.bank_cap_ratio:.4f}",
            *(f"{a.station_m:.1f}|{a.lat_deg:.7f}|{a.lon_deg:.7f}" for a in self.anchors),
        ]
        digest.update("\n".join(head).encode())
        digest.update(self.nodes_mm.astype("<i4").tobytes())
        digest.update(self.cross_slope_quanta.astype("<i4").tobytes())
        return digest.hexdigest()[:16]

    @property
    def nodes_mm(self) -> NDArray[np.int64]:
        """The nodes as whole millimetres. (n, 3)"""
        return np.rint(self.nodes_m / NODE_QUANTUM_M).astype(np.int64)

    @property
    def cross_slope_quanta(self) -> NDArray[np.int64]:
        """The cross slopes as multiples of 1e-4. (n,)"""
        return np.rint(self.cross_slope_ratio / SLOPE_QUANTUM).astype(np.int64)

    @cached_property
    def profile(self) -> SectionProfile:
        """The centre line and all that follows from it, about every metre."""
        return _profile(self)

    @property
    def length_m(self) -> float:
        """Horizontal length of the centre line."""
        return float(self.profile.station_m[-1])

    @property
    def tightest_radius_m(self) -> float:
        """Smallest radius of curvature along the line."""
        return float(1.0 / max(1e-9, np.abs(self.profile.curvature_1pm).max()))


def build_section(
    *,
    section_id: str,
    name: str,
    nodes_m: ArrayLike,
    speed_limit_mps: float,
    cross_slope_ratio: ArrayLike | None = None,
    bank_origin: BankOrigin = BankOrigin.NONE,
    direction: Direction = Direction.WITH,
    crs: str = "local",
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    bank_cap_ratio: float = BANK_CAP_RATIO,
    anchors: Sequence[GnssAnchor] = (),
) -> RoadSection:
    """Return a section whose numbers are rounded to what the wire carries, and checked.

    Args:
        section_id: Lower-case letters, digits and hyphens, at most 48.
        name: What people call it, at most 80 characters.
        nodes_m: East, north, up relative to the origin, in the direction of travel. (n, 3)
        speed_limit_mps: Rated speed.
        cross_slope_ratio: Rise towards the left edge at the nodes; zero if left out. (n,)
        bank_origin: Where the cross slopes come from.
        direction: Direction of travel relative to the road register.
        crs: Coordinate reference of the origin.
        origin_m: East, north and height of the point that the nodes are relative to.
        bank_cap_ratio: Largest physical bank that is believed.
        anchors: Points with geographic coordinates.

    Raises:
        SectionError: Something is missing or cannot be; the message says what.
    """
    nodes = np.asarray(nodes_m, dtype=np.float64)
    slopes = np.zeros(len(nodes)) if cross_slope_ratio is None else np.asarray(cross_slope_ratio, dtype=np.float64)
    _check_words(section_id, name=name, crs=crs)
    _check_geometry(section_id, nodes_m=nodes, cross_slope_ratio=slopes, origin_m=origin_m)
    if not 1.0 <= speed_limit_mps <= 60.0:
        _refuse(section_id, f"speed limit {speed_limit_mps} m/s is not between 1 and 60")
    if not 0.0 <= bank_cap_ratio <= CROSS_SLOPE_LIMIT:
        _refuse(section_id, "a bank cap above 25 % is no road")
    _check_anchors(section_id, anchors)
    section = RoadSection(
        section_id=section_id,
        name=name,
        direction=Direction(direction),
        crs=crs,
        # Adding zero turns -0.0 into 0.0: integers on the wire know no negative zero, and the version must not either.
        origin_m=(round(origin_m[0], 3) + 0.0, round(origin_m[1], 3) + 0.0, round(origin_m[2], 3) + 0.0),
        nodes_m=_frozen(np.rint(nodes / NODE_QUANTUM_M) * NODE_QUANTUM_M + 0.0),
        cross_slope_ratio=_frozen(np.rint(slopes / SLOPE_QUANTUM) * SLOPE_QUANTUM + 0.0),
        bank_origin=BankOrigin(bank_origin),
        speed_limit_mps=round(round(speed_limit_mps / SPEED_QUANTUM_MPS) * SPEED_QUANTUM_MPS, 2),
        bank_cap_ratio=round(bank_cap_ratio, 4),
        anchors=tuple(
            GnssAnchor(round(a.station_m, 1) + 0.0, round(a.lat_deg, 7) + 0.0, round(a.lon_deg, 7) + 0.0)
            for a in sorted(anchors, key=lambda a: a.station_m)
        ),
    )
    if not np.isfinite(section.profile.curvature_1pm).all():
        _refuse(section_id, "the line turns back on itself within one step; smooth the line first")
    low_m, high_m = LENGTH_LIMITS_M
    if not low_m <= section.length_m <= high_m:
        _refuse(section_id, f"length {section.length_m:.1f} m is not between {low_m:.0f} and {high_m:.0f}")
    if section.tightest_radius_m < 5.0:
        _refuse(section_id, f"tightest radius {section.tightest_radius_m:.1f} m is below 5 m; smooth the line first")
    return section


def _check_words(section_id: str, *, name: str, crs: str) -> None:
    allowed = set("abcdefghijklmnopqrstuvwxyz0123456789-")
    if not 1 <= len(section_id) <= 48 or not set(section_id) <= allowed:
        _refuse(section_id, "an id is 1 to 48 lower-case letters, digits and hyphens")
    if len(name) > 80 or not name.isprintable():
        _refuse(section_id, "a name has at most 80 characters, all of them printable")
    if not 1 <= len(crs) <= 40 or not (crs.isascii() and crs.isprintable()):
        _refuse(section_id, 'a coordinate reference is a short text such as "EPSG:25833" or "local"')


def _check_geometry(
    section_id: str, *, nodes_m: FloatArray, cross_slope_ratio: FloatArray, origin_m: tuple[float, float, float]
) -> None:
    if nodes_m.ndim != 2 or nodes_m.shape[1] != 3:
        _refuse(section_id, f"nodes must be rows of east, north, up; the shape is {nodes_m.shape}")
    if cross_slope_ratio.shape != (len(nodes_m),):
        _refuse(section_id, f"{len(nodes_m)} nodes but {cross_slope_ratio.shape} cross slopes")
    if not (np.isfinite(nodes_m).all() and np.isfinite(cross_slope_ratio).all() and np.isfinite(origin_m).all()):
        _refuse(section_id, "a coordinate or cross slope is not finite")
    if not 4 <= len(nodes_m) <= NODES_LIMIT_COUNT:
        _refuse(section_id, f"{len(nodes_m)} nodes; 4 to {NODES_LIMIT_COUNT} are possible")
    if np.abs(nodes_m).max() > NODE_LIMIT_M or np.abs(origin_m).max() > ORIGIN_LIMIT_M:
        _refuse(section_id, "a node or the origin lies outside the world; are the units metres?")
    if np.abs(cross_slope_ratio).max() > CROSS_SLOPE_LIMIT:
        _refuse(section_id, "a cross slope above 25 % is no road")
    steps = np.diff(nodes_m, axis=0)
    if np.abs(steps).max() > NODE_STEP_LIMIT_M or np.hypot(steps[:, 0], steps[:, 1]).min() < 0.5:
        _refuse(section_id, f"nodes must lie 0.5 to {NODE_STEP_LIMIT_M:.0f} m apart")


def _check_anchors(section_id: str, anchors: Sequence[GnssAnchor]) -> None:
    if len(anchors) > ANCHORS_LIMIT_COUNT:
        _refuse(section_id, f"{len(anchors)} GNSS anchors; at most {ANCHORS_LIMIT_COUNT} are possible")
    for a in anchors:
        if not (0.0 <= a.station_m <= LENGTH_LIMITS_M[1] and abs(a.lat_deg) <= 90.0 and abs(a.lon_deg) <= 180.0):
            _refuse(section_id, f"a GNSS anchor at station {a.station_m}, {a.lat_deg}, {a.lon_deg} degrees cannot be")


def ideal_bank_ratio(curvature_1pm: FloatArray, *, speed_limit_mps: float) -> FloatArray:
    """Return the slope that road design asks for at the rated speed, uncapped; negative where none is needed.

    Args:
        curvature_1pm: Of either sign. (n,)
        speed_limit_mps: Rated speed.

    References:
        Langstrand and Rabi, Learning to cooperatively estimate road surface friction, equation of the ideal bank:
        theta = V^2 / (127 R) - 0.14 with V in km/h and R in m. It is a slope, not an angle.
    """
    v_kph = mps_to_kph(speed_limit_mps)
    return v_kph**2 * np.abs(curvature_1pm) / 127.0 - SIDE_FRICTION


def inferred_bank_ratio(
    curvature_1pm: FloatArray, *, speed_limit_mps: float, bank_cap_ratio: float = BANK_CAP_RATIO
) -> FloatArray:
    """Return the inward bank a road built by the book would have: the ideal one within 0 and the cap. (n,)"""
    return np.clip(ideal_bank_ratio(curvature_1pm, speed_limit_mps=speed_limit_mps), 0.0, bank_cap_ratio)


def cross_slope_of_bank(bank_ratio: FloatArray, curvature_1pm: FloatArray) -> FloatArray:
    """Return the rise towards the left edge for an inward bank: a left turn lifts the right edge. (n,)"""
    return -np.sign(curvature_1pm) * bank_ratio


def road_difficulty_ratio(ideal_ratio: FloatArray, bank_ratio: FloatArray) -> FloatArray:
    """Return the road difficulty index tan(theta_ideal - theta_actual).

    Both angles are the arctangents of slopes; the ideal one is not capped.

    References:
        Langstrand and Rabi, section "Features from the road geometry".
    """
    difficulty: FloatArray = np.tan(np.arctan(ideal_ratio) - np.arctan(bank_ratio))
    return difficulty


def _refuse(section_id: str, problem: str) -> NoReturn:
    message = f"section {section_id[:48]!r}: {problem}"
    raise SectionError(message)


def _frozen(values: FloatArray) -> FloatArray:
    values.flags.writeable = False
    return values


def _profile(section: RoadSection) -> SectionProfile:
    nodes = section.nodes_m
    chords = np.hypot(np.diff(nodes[:, 0]), np.diff(nodes[:, 1]))
    knots = np.concatenate([[0.0], np.cumsum(chords)])
    values = np.column_stack([nodes, section.cross_slope_ratio])
    second = second_derivatives(knots, values)

    # Horizontal arc length over the chord parameter, then equal steps of it.
    fine = np.linspace(0.0, knots[-1], max(64, int(np.ceil(knots[-1] / 0.1)) + 1))
    _, first, _ = evaluate(knots, values, second, fine)
    pace = np.hypot(first[:, 0], first[:, 1])
    travelled = np.concatenate([[0.0], np.cumsum(np.diff(fine) * (pace[1:] + pace[:-1]) / 2.0)])
    count = max(2, round(float(travelled[-1]) / STATION_STEP_M) + 1)
    station = np.linspace(0.0, float(travelled[-1]), count)
    value, first, curve = evaluate(knots, values, second, np.interp(station, travelled, fine))

    dx, dy = first[:, 0], first[:, 1]
    ddx, ddy = curve[:, 0], curve[:, 1]
    pace = np.hypot(dx, dy)
    with np.errstate(divide="ignore", invalid="ignore"):  # a cusp; `build_section` refuses what is not finite
        curvature = (dx * ddy - dy * ddx) / pace**3
    cross_slope = np.clip(value[:, 3], -CROSS_SLOPE_LIMIT, CROSS_SLOPE_LIMIT)
    bank = np.clip(-np.sign(curvature) * cross_slope, 0.0, section.bank_cap_ratio)
    ideal = ideal_bank_ratio(curvature, speed_limit_mps=section.speed_limit_mps)
    return SectionProfile(
        station_m=_frozen(station),
        x_m=_frozen(np.ascontiguousarray(value[:, 0])),
        y_m=_frozen(np.ascontiguousarray(value[:, 1])),
        z_m=_frozen(np.ascontiguousarray(value[:, 2])),
        heading_rad=_frozen(np.unwrap(np.arctan2(dy, dx))),
        curvature_1pm=_frozen(curvature),
        grade_ratio=_frozen(first[:, 2] / np.maximum(pace, 1e-9)),
        cross_slope_ratio=_frozen(cross_slope),
        bank_ratio=_frozen(bank),
        ideal_bank_ratio=_frozen(ideal),
        road_difficulty_ratio=_frozen(road_difficulty_ratio(ideal, bank)),
    )

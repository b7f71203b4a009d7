"""Matching without satellites: the heading a vehicle gained, metre by metre, against the heading the map gains.

Heading is the integral of curvature, so comparing headings compares curvature profiles, without the noise of a
derivative. A curve is recognised by how much, how sharply and after how many metres it turns; a straight tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from roadgrip.records import Reason, Rejected
from vehicle_client.estimation.filters import integral
from vehicle_client.mapmatch.match import MatchMethod, SectionMatch, section_match
from vehicle_client.mapmatch.waypoints import SMOOTHING_M, mean_curvature_1pm, section_waypoints

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray

COARSE_STEP_M = 2.0
FINE_STEP_M = 1.0
SCALE_STD_RATIO = 0.006
"""Odometer against map: rolling radius, slip, grid metres, a line driven left or right of the mapped one."""
DRIFT_STD_RADPM = 3e-4
"""Gyro offset of 0.3 degrees per second at 20 m/s."""
HEADING_RMS_LIMIT_RAD = 0.1
"""Wander in the lane, sideslip and gyro noise together stay below."""
EXPLAINED_MIN_FRAC = 0.985
"""Right roads reach 0.994 and more, with automotive sensors and a sliding car."""
WAYPOINT_TOLERANCE_FRAC = 0.5
WAYPOINT_TOLERANCE_1PM = 0.004
POSITION_STD_LIMIT_M = 15.0
EDGE_TOLERANCE_M = 5.0
"""A trace may begin so much after the start, or end so much before the end, of the section."""
_CORRELATED_M = 30.0
"""Heading residuals this far apart are independent of each other."""
_ITERATIONS_COUNT = 6


@dataclass(frozen=True, slots=True)
class DrivenLine:
    """A drive in its own coordinates: the first sample lies at the origin and heads along x. All arrays (n,).

    Attributes:
        distance_m: Travelled.
        heading_rad: Gained since the first sample, left positive.
        x_m: Position.
        y_m: Position.
    """

    distance_m: FloatArray
    heading_rad: FloatArray
    x_m: FloatArray
    y_m: FloatArray


def driven_line(
    speed_mps: FloatArray, yaw_rate_radps: FloatArray, velocity_y_mps: FloatArray | None = None
) -> DrivenLine:
    """Return the line of a vehicle from its speed and yaw rate.

    Args:
        speed_mps: Forward. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        velocity_y_mps: Left, if it is known. (n,)
    """
    heading = integral(yaw_rate_radps)
    left = np.zeros_like(speed_mps) if velocity_y_mps is None else velocity_y_mps
    cos_h, sin_h = np.cos(heading), np.sin(heading)
    return DrivenLine(
        distance_m=integral(np.hypot(np.maximum(speed_mps, 0.0), left)),
        heading_rad=heading,
        x_m=integral(speed_mps * cos_h - left * sin_h),
        y_m=integral(speed_mps * sin_h + left * cos_h),
    )


@dataclass(frozen=True, slots=True)
class _Alignment:
    """Distance = shift + scale * station, and how well the headings then agree."""

    shift_m: float
    scale_ratio: float
    heading_rms_rad: float
    explained_frac: float
    position_std_m: float

    @property
    def convincing(self) -> bool:
        return (
            self.heading_rms_rad <= HEADING_RMS_LIMIT_RAD
            and self.explained_frac >= EXPLAINED_MIN_FRAC
            and self.position_std_m <= POSITION_STD_LIMIT_M
        )


def match_by_dead_reckoning(line: DrivenLine, time_s: FloatArray, section: RoadSection) -> SectionMatch | Rejected:
    """Return where a drive passed a section, from the shape of its line alone.

    The confidence is the share of the map's heading changes that the drive shows. A road that is straight, or a
    circle without beginning and end, cannot be recognised and is refused.

    Args:
        line: From `driven_line`.
        time_s: Of its samples. (n,)
        section: The map.

    Returns:
        The match, or why there is none: PASSAGE_ABORTED if the drive is shorter than the section, or follows it
        beyond its half and ends before it does; else WRONG_ROAD.
    """
    driven = float(line.distance_m[-1])
    length = section.length_m
    if driven < length - EDGE_TOLERANCE_M:
        return Rejected(Reason.PASSAGE_ABORTED, f"drove {driven:.0f} m, the section is {length:.0f} m long")
    found = _aligned(line, section, length_m=length)
    if found.convincing and _waypoints_passed(line, found, section, length_m=length):
        missing = max(-found.shift_m, found.shift_m + found.scale_ratio * length - driven)
        if missing > EDGE_TOLERANCE_M:
            return Rejected(Reason.PASSAGE_ABORTED, f"the trace lacks {missing:.0f} m at an end of the section")
        return section_match(
            time_s,
            (line.distance_m - found.shift_m) / found.scale_ratio,
            length_m=length,
            confidence_frac=found.explained_frac,
            position_std_m=found.position_std_m,
            method=MatchMethod.DEAD_RECKONING,
        )
    if _ends_on_the_way(line, section):
        return Rejected(Reason.PASSAGE_ABORTED, "the drive follows the section to its own end, before the section's")
    return Rejected(
        Reason.WRONG_ROAD,
        f"the best alignment leaves {found.heading_rms_rad:.3f} rad, explains {found.explained_frac:.2f} of the turns",
    )


def _ends_on_the_way(line: DrivenLine, section: RoadSection) -> bool:
    """Return whether the drive follows the section from its start, as far as the drive goes, beyond the half."""
    half = section.length_m / 2.0
    start = _aligned(line, section, length_m=half)
    if not start.convincing:
        return False
    reached = min(section.length_m, (float(line.distance_m[-1]) - start.shift_m) / start.scale_ratio)
    found = _aligned(line, section, length_m=max(half, reached))
    return found.convincing and _waypoints_passed(line, found, section, length_m=max(half, reached))


def _aligned(line: DrivenLine, section: RoadSection, *, length_m: float) -> _Alignment:
    """Return the best alignment of the first `length_m` of a section; the drive must be about that long at least."""
    shift = _coarse_shift_m(line, section, length_m=length_m)
    station = np.arange(0.0, length_m, FINE_STEP_M)
    mapped = np.interp(station, section.profile.station_m, section.profile.heading_rad)
    centred = station - station.mean()
    distance, heading = _strictly_increasing(line.distance_m, line.heading_rad)
    last = float(line.distance_m[-1])
    scale, offset, drift = 1.0, 0.0, 0.0
    offset = float(np.mean(np.interp(shift + station, distance, heading) - mapped))
    # Gauss-Newton on shift, scale, heading offset and drift; scale and drift have priors, else they explain all.
    variance = 0.05**2 * _CORRELATED_M / FINE_STEP_M
    prior = np.diag([0.0, variance / SCALE_STD_RATIO**2, 0.0, variance / DRIFT_STD_RADPM**2])
    normal = np.eye(4)
    for _ in range(_ITERATIONS_COUNT):
        at = shift + scale * station
        residual = np.interp(at, distance, heading) - mapped - offset - drift * centred
        slope = mean_curvature_1pm(distance, heading, at_m=np.clip(at, 0.0, last))
        jacobian = np.column_stack([slope, slope * station, -np.ones_like(station), -centred])
        normal = jacobian.T @ jacobian + prior
        gradient = jacobian.T @ residual + prior @ np.array([0.0, scale - 1.0, 0.0, drift])
        step = np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(4) / 1e6, -gradient)
        shift = float(np.clip(shift + np.clip(step[0], -10.0, 10.0), -length_m / 2.0, last))
        scale = float(np.clip(scale + step[1], 0.97, 1.03))
        offset += float(step[2])
        drift += float(step[3])
    at = shift + scale * station
    residual = np.interp(at, distance, heading) - mapped - offset - drift * centred
    spread = mapped - mapped.mean()
    # Gauss-Newton covariance with the residuals' own size, correlated over some metres.
    noise = float(np.mean(residual**2)) * _CORRELATED_M / FINE_STEP_M
    covariance = np.linalg.inv(normal + 1e-12 * np.trace(normal) * np.eye(4)) * noise
    middle = np.array([1.0, length_m / 2.0, 0.0, 0.0])
    return _Alignment(
        shift_m=shift,
        scale_ratio=scale,
        heading_rms_rad=float(np.sqrt(np.mean(residual**2))),
        explained_frac=float(np.clip(1.0 - np.sum(residual**2) / max(1e-12, float(np.sum(spread**2))), 0.0, 1.0)),
        position_std_m=float(np.sqrt(max(0.0, float(middle @ covariance @ middle)))),
    )


def _coarse_shift_m(line: DrivenLine, section: RoadSection, *, length_m: float) -> float:
    """Return the shift with the least heading residual after taking out an offset and a small drift."""
    station = np.arange(0.0, length_m, COARSE_STEP_M)
    mapped = np.interp(station, section.profile.station_m, section.profile.heading_rad)
    last = float(line.distance_m[-1])
    start = -EDGE_TOLERANCE_M
    grid = np.arange(start, max(last + EDGE_TOLERANCE_M, start + length_m + COARSE_STEP_M), COARSE_STEP_M)
    distance, heading = _strictly_increasing(line.distance_m, line.heading_rad)
    windows = sliding_window_view(np.interp(grid, distance, heading), len(station))
    difference = windows - mapped
    difference -= difference.mean(axis=1, keepdims=True)
    centred = station - station.mean()
    power = float(centred @ centred)
    ridge = 0.05**2 * _CORRELATED_M / COARSE_STEP_M / DRIFT_STD_RADPM**2
    along = difference @ centred
    cost = np.einsum("ij,ij->i", difference, difference) - along**2 / (power + ridge)
    return start + COARSE_STEP_M * int(np.argmin(cost))


def _waypoints_passed(line: DrivenLine, found: _Alignment, section: RoadSection, *, length_m: float) -> bool:
    """Return whether the drive bends at every waypoint of the first `length_m` of the map the way the map says."""
    waypoints = section_waypoints(section)
    asked = waypoints.station_m <= length_m
    distance, heading = _strictly_increasing(line.distance_m, line.heading_rad)
    if not asked.any() or distance[-1] < 2.0 * SMOOTHING_M:
        return False
    station, mapped = waypoints.station_m[asked], waypoints.curvature_1pm[asked]
    driven = mean_curvature_1pm(distance, heading, at_m=found.shift_m + found.scale_ratio * station)
    return bool(np.all(np.abs(driven - mapped) <= WAYPOINT_TOLERANCE_1PM + WAYPOINT_TOLERANCE_FRAC * np.abs(mapped)))


def _strictly_increasing(distance_m: FloatArray, heading_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the samples at which the vehicle had moved on; the heading of a standstill is its last one."""
    moved = np.concatenate([np.diff(distance_m) > 1e-6, [True]])
    return distance_m[moved], heading_rad[moved]

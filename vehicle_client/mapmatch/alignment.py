"""Where along a drive a section fits best: shift, odometer scale, and what gyro and tyres add to the heading.

The model of the heading, with s the station of the map:

    driven heading at (shift + scale s) = mapped heading at s + offset + drift s + slip lateral_acceleration + wander

The offset is free; scale, drift and slip are held near their usual values, else they would explain any road. Wander is
what a driver does within his lane. A car points into the bend in proportion to its lateral acceleration as long as
its tyres grip, so a sliding car differs from the map by one number, not everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vehicle_client.mapmatch.waypoints import SMOOTHING_M, mean_curvature_1pm

if TYPE_CHECKING:
    from roadgrip.section import SectionProfile
    from roadgrip.units import FloatArray
    from vehicle_client.mapmatch.driven_line import DrivenLine

GRID_M = 1.0
"""Step of the drive's own grid."""
FINE_STEP_M = 2.0
COARSE_STEP_M = 4.0
CANDIDATES_COUNT = 3
"""So many places of a drive are looked at closely: the section may have been passed more than once."""
EDGE_TOLERANCE_M = 5.0
"""A trace may begin so much after the start, or end so much before the end, of the section."""
SCALE_STD_RATIO = 0.006
"""Odometer against map: rolling radius, slip, grid metres, a line driven left or right of the mapped one."""
DRIFT_STD_RADPM = 3e-4
"""Gyro offset of 0.3 degrees per second at 20 m/s."""
SLIP_STD_RAD_PER_MPS2 = 0.005
"""Sideslip per lateral acceleration: 0.3 degrees per m/s2, as on a slippery road."""
WANDER_STD_RAD = 0.02
"""Heading against the road while a driver keeps his lane: a third of a metre to and fro within a hundred."""
CORRELATED_M = 20.0
"""Heading residuals this far apart are independent of each other."""
POSITION_FLOOR_M = 0.8
"""A heading tells where the rear axle is; the rest of the car, the line within the lane and the map add this."""
_SCALE_LIMIT_RATIO = 0.03
_STEP_LIMIT_M = 10.0
_ITERATIONS_COUNT = 5
_APART_FRAC = 0.25
"""Candidates nearer to each other than this share of the section are one."""
_MOVED_M = 1e-6
_LEAST = 1e-6
"""Added to the normal equations: on a straight, which tells no shift, the shift stays where it is."""


@dataclass(frozen=True, slots=True)
class MetredDrive:
    """A drive metre by metre. All arrays (n,), at 0 m, 1 m, 2 m, ... driven.

    Attributes:
        length_m: Travelled in all.
        heading_rad: Course if it is known, else the nose's; gained since the first sample, left positive.
        curvature_1pm: Mean over 15 m, left turn positive.
        speed_mps: Mean over 15 m.
        accel_y_mps2: Centripetal, left positive.
        height_m: Gained since the first sample, if it is known.
    """

    length_m: float
    heading_rad: FloatArray
    curvature_1pm: FloatArray
    speed_mps: FloatArray
    accel_y_mps2: FloatArray
    height_m: FloatArray | None


@dataclass(frozen=True, slots=True)
class MappedStretch:
    """The first metres of a map as a drive is compared with it. Arrays (m,), about every two metres.

    Attributes:
        length_m: How long it is.
        station_m: Where.
        heading_rad: Unwrapped, of mean zero.
        curvature_1pm: Mean over 15 m, left turn positive.
        height_m: Above the first node.
    """

    length_m: float
    station_m: FloatArray
    heading_rad: FloatArray
    curvature_1pm: FloatArray
    height_m: FloatArray

    @property
    def centred_m(self) -> FloatArray:
        """Stations from the middle. (m,)"""
        return self.station_m - self.length_m / 2.0


@dataclass(frozen=True, slots=True)
class Alignment:
    """One place of a drive where a stretch of map may lie.

    Attributes:
        shift_m: Distance driven when the start was passed.
        scale_ratio: Metres driven per metre of the map.
        residual_rad: Heading that the fit leaves, at the stretch's stations. (m,)
        position_std_m: Standard deviation of the stations, if it is the right place.
    """

    shift_m: float
    scale_ratio: float
    residual_rad: FloatArray
    position_std_m: float

    @property
    def residual_rms_rad(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(np.mean(self.residual_rad**2)))

    def driven_m(self, station_m: FloatArray) -> FloatArray:
        """Return the distance driven at stations of the map."""
        return self.shift_m + self.scale_ratio * station_m


def metred_drive(line: DrivenLine, time_s: FloatArray) -> MetredDrive | None:
    """Return a drive metre by metre, standstills left out; None where it is shorter than 15 m or no car's.

    No car's is a drive that is not finite, or whose heading strays by more than a thousand turns.

    Args:
        line: From `driven_line`.
        time_s: Of its samples. (n,)
    """
    turned = line.heading_rad if line.course_rad is None else line.course_rad
    finite = np.isfinite(line.distance_m).all() and np.isfinite(turned).all() and np.isfinite(time_s).all()
    if not finite or len(time_s) == 0 or not SMOOTHING_M < line.distance_m[-1] < _LONGEST_M:
        return None
    if np.abs(turned).max() > _HEADING_LIMIT_RAD:
        return None
    moved = np.concatenate([np.diff(line.distance_m) > _MOVED_M, [True]])
    distance = line.distance_m[moved]
    grid = np.arange(0.0, float(distance[-1]) + GRID_M, GRID_M)
    heading = np.interp(grid, distance, turned[moved])
    curvature = mean_curvature_1pm(grid, heading, at_m=grid)
    # Time over the same 15 m, since the quotient of two neighbouring samples is mostly noise.
    pace_spm = mean_curvature_1pm(grid, np.interp(grid, distance, time_s[moved]), at_m=grid)
    speed = 1.0 / np.maximum(pace_spm, _FASTEST_SPM)
    known = line.height_m is not None and bool(np.isfinite(line.height_m).all())
    return MetredDrive(
        length_m=float(distance[-1]),
        heading_rad=heading,
        curvature_1pm=curvature,
        speed_mps=speed,
        accel_y_mps2=curvature * speed**2,
        height_m=np.interp(grid, distance, line.height_m[moved]) if known and line.height_m is not None else None,
    )


_LONGEST_M = 200_000.0
_HEADING_LIMIT_RAD = 2.0e3 * np.pi
_FASTEST_SPM = 0.01


def mapped_stretch(profile: SectionProfile, *, length_m: float) -> MappedStretch:
    """Return the first `length_m` of a map.

    Args:
        profile: Of the section.
        length_m: Not beyond its end.
    """
    station = np.linspace(0.0, length_m, max(8, round(length_m / FINE_STEP_M) + 1))
    heading = np.interp(station, profile.station_m, profile.heading_rad)
    return MappedStretch(
        length_m=length_m,
        station_m=station,
        heading_rad=heading - heading.mean(),
        curvature_1pm=mean_curvature_1pm(profile.station_m, profile.heading_rad, at_m=station),
        height_m=np.interp(station, profile.station_m, profile.z_m),
    )


def alignments(drive: MetredDrive, stretch: MappedStretch) -> list[Alignment]:
    """Return the best places of a stretch of map along a drive, in the order of the drive; at least one, however bad.

    Args:
        drive: At least about as long as the stretch.
        stretch: Of the map.
    """
    return _refined(drive, stretch, coarse_shifts_m(drive, stretch))


def coarse_shifts_m(drive: MetredDrive, stretch: MappedStretch) -> FloatArray:
    """Return the shifts with the least heading residual after taking out an offset and a small drift, in order. (k,)

    All shifts are tried at once: the sum of squares of a difference consists of moving sums and a correlation.
    """
    station = np.arange(0.0, stretch.length_m, COARSE_STEP_M)
    count = len(station)
    mapped = np.interp(station, stretch.station_m, stretch.heading_rad)
    mapped -= mapped.mean()
    centred = station - station.mean()
    last = max(drive.length_m + EDGE_TOLERANCE_M, stretch.length_m - EDGE_TOLERANCE_M + COARSE_STEP_M)
    grid = np.arange(-EDGE_TOLERANCE_M, last, COARSE_STEP_M)
    heading = value_at(drive.heading_rad, grid)
    total = np.correlate(heading, np.ones(count), mode="valid")
    spread = np.correlate(heading**2, np.ones(count), mode="valid") - total**2 / count
    along = np.correlate(heading, centred, mode="valid") - float(mapped @ centred)
    common = np.correlate(heading, mapped, mode="valid")
    ridge = WANDER_STD_RAD**2 * CORRELATED_M / COARSE_STEP_M / DRIFT_STD_RADPM**2
    cost = spread - 2.0 * common + float(mapped @ mapped) - along**2 / (float(centred @ centred) + ridge)
    apart = max(1, int(_APART_FRAC * count))
    found: list[int] = []
    while len(found) < CANDIDATES_COUNT:
        best = int(np.argmin(cost))
        if not np.isfinite(cost[best]):
            break
        found.append(best)
        cost[max(0, best - apart) : best + apart + 1] = np.inf
    return grid[np.sort(np.array(found, dtype=np.intp))]


def _refined(drive: MetredDrive, stretch: MappedStretch, shifts_m: FloatArray) -> list[Alignment]:
    """Return the Gauss-Newton fits from several shifts, all at once."""
    station, centred = stretch.station_m, stretch.centred_m
    flat = np.ones((len(shifts_m), len(station)))
    # Residuals in units of the wander, one every `CORRELATED_M` counting once.
    weight = stretch.length_m / len(station) / (WANDER_STD_RAD**2 * CORRELATED_M)
    held = np.array([0.0, SCALE_STD_RATIO, 0.0, DRIFT_STD_RADPM, SLIP_STD_RAD_PER_MPS2])
    prior = np.divide(1.0, held**2, out=np.zeros(5), where=held > 0.0)
    usual = np.diag(prior + _LEAST)
    # Columns: shift, scale - 1, offset, drift, slip.
    fit = np.zeros((len(shifts_m), 5))
    fit[:, 0] = shifts_m
    fit[:, 2] = np.mean(value_at(drive.heading_rad, fit[:, :1] + station) - stretch.heading_rad, axis=1)
    normal = np.empty((len(shifts_m), 5, 5))
    for _ in range(_ITERATIONS_COUNT):
        at = fit[:, :1] + (1.0 + fit[:, 1:2]) * station
        slope, accel_y = value_at(drive.curvature_1pm, at), value_at(drive.accel_y_mps2, at)
        residual = _residual_rad(drive, stretch, fit)
        jacobian = np.stack([slope, slope * station, -flat, -centred * flat, -accel_y], axis=-1)
        turned = np.swapaxes(jacobian, 1, 2)
        normal = weight * turned @ jacobian + usual
        gradient = weight * (turned @ residual[..., None])[..., 0] + fit * prior
        step = -np.linalg.solve(normal, gradient[..., None])[..., 0]
        step[:, 0] = np.clip(step[:, 0], -_STEP_LIMIT_M, _STEP_LIMIT_M)
        fit += step
        fit[:, 0] = np.clip(fit[:, 0], -stretch.length_m / 2.0, drive.length_m)
        fit[:, 1] = np.clip(fit[:, 1], -_SCALE_LIMIT_RATIO, _SCALE_LIMIT_RATIO)
    residual = _residual_rad(drive, stretch, fit)
    covariance = np.linalg.inv(normal)
    middle = np.array([1.0, stretch.length_m / 2.0, 0.0, 0.0, 0.0])
    return [
        Alignment(
            shift_m=float(fit[k, 0]),
            scale_ratio=1.0 + float(fit[k, 1]),
            residual_rad=residual[k],
            position_std_m=_position_std_m(max(0.0, float(middle @ covariance[k] @ middle)), residual[k]),
        )
        for k in range(len(fit))
    ]


def _position_std_m(variance_m2: float, residual_rad: FloatArray) -> float:
    """Return the standard deviation of the stations: what the fit knows of them, and what a heading cannot know.

    Args:
        variance_m2: From the fit, if drivers wander as supposed.
        residual_rad: What the fit left. A driver who strayed more than supposed, or slid, was also elsewhere by more.
    """
    strayed_ratio = float(np.mean(residual_rad**2)) / WANDER_STD_RAD**2
    return float(np.hypot(POSITION_FLOOR_M, np.sqrt(variance_m2 * (1.0 + strayed_ratio))))


def _residual_rad(drive: MetredDrive, stretch: MappedStretch, fit: FloatArray) -> FloatArray:
    at = fit[:, :1] + (1.0 + fit[:, 1:2]) * stretch.station_m
    explained = fit[:, 2:3] + fit[:, 3:4] * stretch.centred_m + fit[:, 4:5] * value_at(drive.accel_y_mps2, at)
    residual: FloatArray = value_at(drive.heading_rad, at) - stretch.heading_rad - explained
    return residual


def value_at(values: FloatArray, at_m: FloatArray) -> FloatArray:
    """Return values of the drive's grid at any distances: straight lines between, held beyond the ends.

    Args:
        values: Metre by metre, two at least. (n,)
        at_m: Of any shape.
    """
    place = np.clip(at_m / GRID_M, 0.0, float(len(values) - 1))
    low = np.minimum(place.astype(np.intp), len(values) - 2)
    part = place - low
    between: FloatArray = values[low] * (1.0 - part) + values[low + 1] * part
    return between

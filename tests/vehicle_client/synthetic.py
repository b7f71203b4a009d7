"""Roads given by a curvature and drives over them whose every signal is known exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from roadgrip.geodesy import anchors_of, frame_of
from roadgrip.section import BankOrigin, RoadSection, build_section
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S, FloatArray
from vehicle_client.estimation.filters import integral
from vehicle_client.estimation.trace import GnssTrack, Trace
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry

Curvature = Callable[[FloatArray], FloatArray]
STEP_M = 0.05


def clock_s(count: int) -> FloatArray:
    """Return the times of so many samples."""
    return np.arange(count, dtype=np.float64) * SAMPLE_S


def bump(station_m: FloatArray, *, start_m: float, length_m: float, peak_1pm: float) -> FloatArray:
    """Return the curvature of one bend: a raised cosine, zero outside."""
    phase = (station_m - start_m) / length_m
    inside = (phase > 0.0) & (phase < 1.0)
    return np.where(inside, peak_1pm * np.sin(np.pi * np.clip(phase, 0.0, 1.0)) ** 2, 0.0)


def s_turn(station_m: FloatArray) -> FloatArray:
    """Return a left bend of 80 m radius and then a right one of 60 m, within 400 m."""
    left = bump(station_m, start_m=60.0, length_m=130.0, peak_1pm=1 / 80.0)
    right = bump(station_m, start_m=210.0, length_m=150.0, peak_1pm=-1 / 60.0)
    return left + right


def negative(curvature: Curvature) -> Curvature:
    return lambda station_m: -curvature(station_m)


def road(
    curvature: Curvature,
    *,
    length_m: float = 400.0,
    node_step_m: float = 5.0,
    cross_slope_ratio: float = 0.0,
    section_id: str = "synthetic",
    speed_limit_mps: float = 22.0,
    **more: object,
) -> RoadSection:
    """Return the section whose centre line has this curvature."""
    station = np.arange(0.0, length_m + STEP_M / 2.0, STEP_M)
    middle = (station[1:] + station[:-1]) / 2.0
    heading = np.concatenate([[0.0], np.cumsum(curvature(middle)) * STEP_M])
    mean_heading = (heading[1:] + heading[:-1]) / 2.0
    x = np.concatenate([[0.0], np.cumsum(np.cos(mean_heading)) * STEP_M])
    y = np.concatenate([[0.0], np.cumsum(np.sin(mean_heading)) * STEP_M])
    at = np.linspace(0.0, length_m, round(length_m / node_step_m) + 1)
    nodes = np.column_stack([np.interp(at, station, x), np.interp(at, station, y), np.zeros_like(at)])
    return build_section(
        section_id=section_id,
        name="Synthetic road",
        nodes_m=nodes,
        speed_limit_mps=speed_limit_mps,
        cross_slope_ratio=np.full(len(at), cross_slope_ratio),
        bank_origin=BankOrigin.MEASURED if cross_slope_ratio else BankOrigin.NONE,
        **more,  # type: ignore[arg-type]
    )


def motion(
    speed_mps: FloatArray,
    yaw_rate_radps: FloatArray,
    *,
    velocity_y_mps: FloatArray | None = None,
    accel_y_mps2: FloatArray | None = None,
    tilt_rad: FloatArray | float = 0.0,
    steer_rad: FloatArray | None = None,
    vehicle: VehicleGeometry = XC90,
) -> Trace:
    """Return what perfect sensors see of a motion; without a steering angle, the wheels point where the car rolls."""
    n = len(speed_mps)
    left = np.zeros(n) if velocity_y_mps is None else velocity_y_mps
    if accel_y_mps2 is None:
        accel_y_mps2 = np.gradient(left, SAMPLE_S) + yaw_rate_radps * speed_mps
    accel_x = np.gradient(speed_mps, SAMPLE_S) - yaw_rate_radps * left
    if steer_rad is None:
        # The inverse of the intended yaw rate: t = 2 b w / (2 V - L |w|).
        steer_rad = np.arctan(
            2.0 * vehicle.wheelbase_m * yaw_rate_radps / (2.0 * speed_mps - vehicle.track_m * np.abs(yaw_rate_radps))
        )
    tilt = np.broadcast_to(np.asarray(tilt_rad, dtype=np.float64), (n,))
    half = vehicle.track_m / 2.0
    across = left + yaw_rate_radps * vehicle.front_axle_m
    wheels = np.column_stack([speed_mps - yaw_rate_radps * y for y in (half, -half, half, -half)])
    wheels[:, :2] = wheels[:, :2] * np.cos(steer_rad)[:, None] + (across * np.sin(steer_rad))[:, None]
    return Trace(
        time_s=clock_s(n),
        accel_x_mps2=accel_x,
        accel_y_mps2=accel_y_mps2 * np.cos(tilt) + GRAVITY_MPS2 * np.sin(tilt),
        roll_rate_radps=np.gradient(tilt, SAMPLE_S),
        yaw_rate_radps=yaw_rate_radps,
        steer_rad=steer_rad,
        wheel_speed_mps=wheels,
        valid=np.ones(n, dtype=bool),
    )


def drive_over(
    curvature: Curvature,
    *,
    length_m: float = 400.0,
    speed_mps: float = 15.0,
    swing_mps: float = 0.0,
    approach_m: float = 80.0,
    exit_m: float = 60.0,
    tilt_rad: float = 0.0,
    vehicle: VehicleGeometry = XC90,
) -> tuple[Trace, FloatArray]:
    """Return a drive along the centre line without sideslip, and its true stations."""
    samples = int((approach_m + length_m + exit_m) / (speed_mps - abs(swing_mps)) / SAMPLE_S) + 200
    time = clock_s(samples)
    speed = speed_mps + swing_mps * np.sin(2.0 * np.pi * time / 12.0)
    station = integral(speed) - approach_m
    keep = station <= length_m + exit_m
    inside = (station >= 0.0) & (station <= length_m)
    yaw_rate = np.where(inside, curvature(station), 0.0) * speed
    trace = motion(speed[keep], yaw_rate[keep], tilt_rad=tilt_rad, vehicle=vehicle)
    return trace, station[keep]


def with_noise(trace: Trace, rng: np.random.Generator) -> Trace:
    """Return the trace as ordinary sensors would have recorded it: noise, no offsets."""
    n = trace.samples_count
    return replace(
        trace,
        accel_x_mps2=trace.accel_x_mps2 + rng.normal(0.0, 0.03, n),
        accel_y_mps2=trace.accel_y_mps2 + rng.normal(0.0, 0.03, n),
        roll_rate_radps=trace.roll_rate_radps + rng.normal(0.0, 0.002, n),
        yaw_rate_radps=trace.yaw_rate_radps + rng.normal(0.0, 0.002, n),
        steer_rad=trace.steer_rad + rng.normal(0.0, 0.0005, n),
        wheel_speed_mps=trace.wheel_speed_mps * (1.0 + rng.normal(0.0, 0.003, (n, 4))),
    )


def surveyed(section: RoadSection) -> RoadSection:
    """Return the section laid on a real map, so that receivers can find it."""
    placed = replace(section, crs="EPSG:25833", origin_m=(250_908.0, 6_834_042.0, 900.0))
    return replace(placed, anchors=anchors_of(placed))


def fixes_of(
    section: RoadSection,
    time_s: FloatArray,
    station_m: FloatArray,
    *,
    rng: np.random.Generator,
    lateral_m: float = 0.0,
    noise_m: float = 0.0,
) -> GnssTrack:
    """Return ten fixes a second of a drive along the centre line, or beside it; straight on beyond the ends."""
    profile = section.profile
    at, station = time_s[::10], station_m[::10]
    nearest = np.clip(station, 0.0, section.length_m)
    heading = np.interp(nearest, profile.station_m, profile.heading_rad)
    along = station - nearest
    x = np.interp(nearest, profile.station_m, profile.x_m) + along * np.cos(heading) - lateral_m * np.sin(heading)
    y = np.interp(nearest, profile.station_m, profile.y_m) + along * np.sin(heading) + lateral_m * np.cos(heading)
    x, y = x + rng.normal(0.0, noise_m, len(x)), y + rng.normal(0.0, noise_m, len(y))
    lat, lon = frame_of(section).to_lat_lon(x, y)
    return GnssTrack(time_s=at, lat_deg=lat, lon_deg=lon, accuracy_m=np.full(len(at), max(0.5, noise_m)))

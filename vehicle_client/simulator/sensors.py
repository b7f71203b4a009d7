"""What the vehicle's sensors make of the true motion.

Errors that last a whole drive (bias, scale, misalignment, mounting, wheel radii) are drawn once per drive; noise is
drawn per sample. The accelerometers sit away from the centre of gravity; the unit corrects for where it is known to
sit, so that what remains is the error of that knowledge. Misalignment turns gravity into the horizontal axes too.

The numbers are the project's starting table: typical published values of ESC-cluster sensors and CAN resolutions,
recalled, not measured. They change only with a written decision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.trace import GnssTrack, Trace
from vehicle_client.simulator.plan import SensorGrade

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roadgrip.geodesy import GeoFrame
    from roadgrip.units import BoolArray, FloatArray


class Sensors(NamedTuple):
    """One standard deviation unless said; zero means exact.

    Attributes:
        gyro_noise_radps: Per sample.
        gyro_bias_radps: What standstill calibration leaves.
        gyro_scale_ratio: Of the rate.
        accel_noise_mps2: Per sample.
        accel_bias_mps2: Residual.
        accel_scale_ratio: Of the acceleration.
        misalignment_rad: Of the unit, about each axis.
        lever_m: Error of the known distance from the centre of gravity, forward and left each.
        steer_offset_rad: At the road wheel.
        steer_quantum_rad: Resolution (not a deviation).
        radius_common_ratio: Of all four rolling radii together.
        radius_each_ratio: Of each.
        wheel_noise_ratio: Of the wheel speed, per sample.
        wheel_quantum_mps: Resolution (not a deviation).
        gnss_position_m: Per horizontal axis; drifts over `gnss_memory_s`.
        gnss_memory_s: Correlation time of the position error.
        gnss_rate_hz: Fixes per second (not a deviation).
        jitter_s: Of the sampling times.
    """

    gyro_noise_radps: float = 0.0
    gyro_bias_radps: float = 0.0
    gyro_scale_ratio: float = 0.0
    accel_noise_mps2: float = 0.0
    accel_bias_mps2: float = 0.0
    accel_scale_ratio: float = 0.0
    misalignment_rad: float = 0.0
    lever_m: float = 0.0
    steer_offset_rad: float = 0.0
    steer_quantum_rad: float = 0.0
    radius_common_ratio: float = 0.0
    radius_each_ratio: float = 0.0
    wheel_noise_ratio: float = 0.0
    wheel_quantum_mps: float = 0.0
    gnss_position_m: float = 0.0
    gnss_memory_s: float = 120.0
    gnss_rate_hz: float = 10.0
    jitter_s: float = 0.0


_DEG = float(np.pi / 180.0)

IDEAL = Sensors()
AUTOMOTIVE = Sensors(
    gyro_noise_radps=0.1 * _DEG,
    gyro_bias_radps=0.1 * _DEG,
    gyro_scale_ratio=0.01,
    accel_noise_mps2=0.03,
    accel_bias_mps2=0.05,
    accel_scale_ratio=0.01,
    misalignment_rad=0.5 * _DEG,
    lever_m=0.02,
    steer_offset_rad=0.05 * _DEG,
    steer_quantum_rad=0.1 * _DEG,
    radius_common_ratio=0.003,
    radius_each_ratio=0.002,
    wheel_noise_ratio=0.003,
    wheel_quantum_mps=0.0156,
    gnss_position_m=1.5,
    jitter_s=0.002,
)
SENSORS: Mapping[SensorGrade, Sensors] = {SensorGrade.IDEAL: IDEAL, SensorGrade.AUTOMOTIVE: AUTOMOTIVE}


class Motion(NamedTuple):
    """What the sensors sense, without error, at the centre of gravity in body axes. All arrays (n,) unless said.

    Attributes:
        specific_force_mps2: Forward, left, up. (n, 3)
        rate_radps: Roll, pitch, yaw rate. (n, 3)
        steer_rad: Mean angle of the front wheels.
        wheel_speed_mps: Rotation times nominal radius. (n, 4)
        stability_active: Where ABS, traction control or ESC intervene.
    """

    specific_force_mps2: FloatArray
    rate_radps: FloatArray
    steer_rad: FloatArray
    wheel_speed_mps: FloatArray
    stability_active: BoolArray


def trace_of(motion: Motion, *, rng: np.random.Generator, sensors: Sensors, gnss: GnssTrack | None = None) -> Trace:
    """Return the trace that sensors of a grade record of a motion.

    The number of draws depends on the number of samples alone, not on the grade.

    Args:
        motion: The truth.
        rng: Source of chance.
        sensors: Their errors.
        gnss: Position fixes to add.
    """
    n = len(motion.steer_rad)
    fixed = rng.standard_normal(20)
    noise = rng.standard_normal((n, 10))
    rate = _jittered(motion.rate_radps, sensors.jitter_s * noise[:, 9])
    force = _jittered(motion.specific_force_mps2, sensors.jitter_s * noise[:, 9])

    # The unit's lever: centripetal and angular acceleration of where it sits.
    lever_x, lever_y = sensors.lever_m * fixed[0:2]
    turning = np.gradient(rate[:, 2], SAMPLE_S) if n > 1 else np.zeros(n)
    force = force.copy()
    force[:, 0] -= rate[:, 2] ** 2 * lever_x + turning * lever_y
    force[:, 1] += turning * lever_x - rate[:, 2] ** 2 * lever_y
    # A small rotation of the unit against the body.
    tilt = sensors.misalignment_rad * fixed[2:5]
    force = _turned(force, tilt)
    rate = _turned(rate, tilt)

    accel = force[:, :2] * (1.0 + sensors.accel_scale_ratio * fixed[5:7]) + sensors.accel_bias_mps2 * fixed[7:9]
    accel = accel + sensors.accel_noise_mps2 * noise[:, 0:2]
    gyro = rate[:, [0, 2]] * (1.0 + sensors.gyro_scale_ratio * fixed[9:11]) + sensors.gyro_bias_radps * fixed[11:13]
    gyro = gyro + sensors.gyro_noise_radps * noise[:, 2:4]
    steer = _quantised(motion.steer_rad + sensors.steer_offset_rad * fixed[13], sensors.steer_quantum_rad)
    radius = 1.0 + sensors.radius_common_ratio * fixed[14] + sensors.radius_each_ratio * fixed[15:19]
    speed = motion.wheel_speed_mps * radius * (1.0 + sensors.wheel_noise_ratio * noise[:, 4:8])
    return Trace(
        time_s=SAMPLE_S * np.arange(n, dtype=np.float64),
        accel_x_mps2=np.ascontiguousarray(accel[:, 0]),
        accel_y_mps2=np.ascontiguousarray(accel[:, 1]),
        roll_rate_radps=np.ascontiguousarray(gyro[:, 0]),
        yaw_rate_radps=np.ascontiguousarray(gyro[:, 1]),
        steer_rad=steer,
        wheel_speed_mps=_quantised(speed, sensors.wheel_quantum_mps),
        valid=np.ones(n, dtype=np.bool_),
        stability_active=motion.stability_active,
        gnss=gnss,
    )


def gnss_track(
    x_m: FloatArray, y_m: FloatArray, *, frame: GeoFrame, rng: np.random.Generator, sensors: Sensors
) -> GnssTrack:
    """Return position fixes whose error drifts slowly, as that of a single-frequency receiver does.

    Args:
        x_m: True position every 10 ms, east of the section's origin. (n,)
        y_m: North of it. (n,)
        frame: Where the section lies.
        rng: Source of chance.
        sensors: Their errors.
    """
    stride = max(1, round(1.0 / (sensors.gnss_rate_hz * SAMPLE_S)))
    rows = np.arange(0, len(x_m), stride)
    draws = rng.standard_normal((len(rows), 2))
    keep = float(np.exp(-stride * SAMPLE_S / sensors.gnss_memory_s))
    fresh = float(np.sqrt(1.0 - keep**2))
    error = np.empty_like(draws)
    error[0] = draws[0]
    for k in range(1, len(rows)):
        error[k] = keep * error[k - 1] + fresh * draws[k]
    error *= sensors.gnss_position_m
    lat, lon = frame.to_lat_lon(x_m[rows] + error[:, 0], y_m[rows] + error[:, 1])
    return GnssTrack(
        time_s=SAMPLE_S * rows.astype(np.float64),
        lat_deg=lat,
        lon_deg=lon,
        accuracy_m=np.full(len(rows), max(0.01, sensors.gnss_position_m)),
    )


def _turned(vectors: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return vectors as a unit reads them that is turned by small angles.

    Written out, since a matrix product may add in another order on another machine.
    """
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.column_stack(
        [x + tilt[2] * y - tilt[1] * z, y + tilt[0] * z - tilt[2] * x, z + tilt[1] * x - tilt[0] * y]
    )


def _jittered(values: FloatArray, shift_s: FloatArray) -> FloatArray:
    """Return values read a little earlier or later than their time says, by straight lines between samples."""
    n = len(values)
    if n < 2 or not shift_s.any():
        return values
    at = np.clip(np.arange(n) + shift_s / SAMPLE_S, 0.0, n - 1.0)
    i = np.minimum(at.astype(np.int64), n - 2)
    part = (at - i)[:, None]
    read: FloatArray = values[i] * (1.0 - part) + values[i + 1] * part
    return read


def _quantised(values: FloatArray, quantum: float) -> FloatArray:
    return np.rint(values / quantum) * quantum if quantum > 0.0 else values.copy()

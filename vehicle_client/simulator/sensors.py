"""What the vehicle's sensors make of the true motion.

Errors that last a whole drive (bias, scale, misalignment, mounting, wheel radii) are drawn once per drive, or, but for
the gyros' bias, once per car; noise is drawn per sample. `amplitudes` holds how large they are.

Three senders share the vehicle's network: the inertial unit, the steering column and the brake controller with its
wheel speeds. Each stamps its samples by its own clock, early or late by its own jitter. The receiver believes the
stamps and puts the samples on a grid of 10 ms, so that jitter shows as values of a slightly other moment.

The inertial unit sits beside the centre of gravity, turned a little. Misalignment turns gravity into the horizontal
axes too. The brake controller, to whom the unit belongs, knows by design where it sits and relates the accelerations to
the centre of gravity with the yaw rate that it measures; how far the unit really sits from there it does not know.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.trace import GnssTrack, Trace
from vehicle_client.simulator.amplitudes import AUTOMOTIVE, IDEAL, SENSORS, Sensors, scaled
from vehicle_client.simulator.compilation import cached_kernel, kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from roadgrip.geodesy import GeoFrame
    from roadgrip.units import BoolArray, FloatArray

__all__ = ["AUTOMOTIVE", "IDEAL", "SENSORS", "Motion", "Sensors", "gnss_track", "scaled", "trace_of"]

_DRIVE_DRAWS_COUNT = 19
_GYRO_BIAS_DRAWS = slice(11, 13)
_SAMPLE_DRAWS_COUNT = 11
_FIX_DRAWS_COUNT = 3
# Bits and sums of eight bytes, see `_noise`; compiled code mixes unsigned numbers with no others.
_BYTE_BITS, _UPPER_BITS = np.uint64(8), np.uint64(48)
_EVEN_BYTES, _EACH_PAIR = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0001000100010001)
_BYTES_MEAN, _BYTES_DEVIATION = 8 * 127.5, math.sqrt(8 * (256**2 - 1) / 12)
_SLOPE_REACH_COUNT = 5
"""The controller differentiates the yaw rate over so many samples to either side, to keep its noise small."""


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


def trace_of(
    motion: Motion,
    *,
    rng: np.random.Generator,
    sensors: Sensors,
    gnss: GnssTrack | None = None,
    car_rng: np.random.Generator | None = None,
) -> Trace:
    """Return the trace that sensors of a grade record of a motion.

    Exact sensors need no chance and draw nothing; with others the number of draws depends on the number of samples
    alone, so that grades scaled by `scaled` err the same way, only more or less.

    Args:
        motion: The truth.
        rng: Source of chance; the trace is a function of its state and of the other arguments.
        sensors: Their errors.
        gnss: Position fixes to add.
        car_rng: Source of chance of what lasts the car's life; all comes from `rng` if None. The noise is the same.
    """
    n = len(motion.steer_rad)
    inertial, wheels = np.empty((4, n)), np.empty((n, 4))
    steer = np.empty(n)
    if _is_exact(sensors):
        inertial[:2] = motion.specific_force_mps2[:, :2].T
        inertial[2:] = motion.rate_radps[:, 0], motion.rate_radps[:, 2]
        steer[:], wheels[:] = motion.steer_rad, motion.wheel_speed_mps
    else:
        unit, encoders = _drawn(rng, sensors, car_rng)
        words = rng.integers(0, 2**64, size=(n, _SAMPLE_DRAWS_COUNT), dtype=np.uint64)
        _sense_inertially(motion.specific_force_mps2, motion.rate_radps, words, unit, SAMPLE_S, inertial)
        _sense_wheels(motion.steer_rad, motion.wheel_speed_mps, words, encoders, steer, wheels)
    return Trace(
        time_s=SAMPLE_S * np.arange(n, dtype=np.float64),
        accel_x_mps2=inertial[0],
        accel_y_mps2=inertial[1],
        roll_rate_radps=inertial[2],
        yaw_rate_radps=inertial[3],
        steer_rad=steer,
        wheel_speed_mps=wheels,
        valid=np.ones(n, dtype=np.bool_),
        stability_active=motion.stability_active,
        gnss=gnss,
    )


def gnss_track(
    x_m: FloatArray, y_m: FloatArray, *, frame: GeoFrame, rng: np.random.Generator, sensors: Sensors
) -> GnssTrack:
    """Return the fixes of a single-frequency receiver: position errors drift slowly, errors of the speed do not.

    The position error on either axis is a first-order Gauss-Markov process. Receivers get the speed from the Doppler
    shift, whence its error is small and new at every fix. They tell the time of a fix themselves, by far exact enough.

    Args:
        x_m: True position every 10 ms, east of the section's origin. (n,)
        y_m: North of it. (n,)
        frame: Where the section lies.
        rng: Source of chance.
        sensors: Their errors.
    """
    stride = max(1, round(1.0 / (sensors.gnss_rate_hz * SAMPLE_S)))
    rows = np.arange(0, len(x_m), stride)
    draws = rng.standard_normal((len(rows), _FIX_DRAWS_COUNT))
    error = draws[:, :2]
    _remember(error, float(np.exp(-stride * SAMPLE_S / sensors.gnss_memory_s)))
    error *= sensors.gnss_position_m
    lat, lon = frame.to_lat_lon(x_m[rows] + error[:, 0], y_m[rows] + error[:, 1])
    speed = np.zeros(len(x_m))
    if len(x_m) > 1:
        speed = np.hypot(np.gradient(x_m, SAMPLE_S), np.gradient(y_m, SAMPLE_S))
    return GnssTrack(
        time_s=SAMPLE_S * rows.astype(np.float64),
        lat_deg=lat,
        lon_deg=lon,
        accuracy_m=np.full(len(rows), max(0.01, sensors.gnss_position_m)),
        speed_mps=np.abs(speed[rows] + sensors.gnss_speed_mps * draws[:, 2]),
    )


class _Unit(NamedTuple):
    """One car's inertial unit. It is defined beside what compiles it, since the compiler's cache watches this file."""

    mount_m: float
    x_m: float
    y_m: float
    tilt_x_rad: float
    tilt_y_rad: float
    tilt_z_rad: float
    accel_x_gain_ratio: float
    accel_y_gain_ratio: float
    roll_rate_gain_ratio: float
    yaw_rate_gain_ratio: float
    accel_x_bias_mps2: float
    accel_y_bias_mps2: float
    roll_rate_bias_radps: float
    yaw_rate_bias_radps: float
    accel_noise_mps2: float
    gyro_noise_radps: float
    jitter_samples_count: float


class _Encoders(NamedTuple):
    """One car's encoders of steering and wheels; defined here as `_Unit` is."""

    steer_offset_rad: float
    steer_quantum_rad: float
    wheel_gain_ratio: tuple[float, float, float, float]
    wheel_noise_ratio: float
    wheel_quantum_mps: float
    jitter_samples_count: float


def _drawn(rng: np.random.Generator, sensors: Sensors, car_rng: np.random.Generator | None) -> tuple[_Unit, _Encoders]:
    """Return what lasts a whole drive, or a car's life."""
    draws = rng.standard_normal(_DRIVE_DRAWS_COUNT).tolist()
    if car_rng is not None:
        zeroed_at_standstill = draws[_GYRO_BIAS_DRAWS]
        draws = car_rng.standard_normal(_DRIVE_DRAWS_COUNT).tolist()
        draws[_GYRO_BIAS_DRAWS] = zeroed_at_standstill
    tilt, gain, bias, radius = draws[2:5], draws[5:9], draws[9:13], draws[14:19]
    jitter_samples_count = sensors.jitter_s / SAMPLE_S
    unit = _Unit(
        mount_m=sensors.mount_m,
        x_m=sensors.mount_m + sensors.mount_error_m * draws[0],
        y_m=sensors.mount_m + sensors.mount_error_m * draws[1],
        tilt_x_rad=sensors.misalignment_rad * tilt[0],
        tilt_y_rad=sensors.misalignment_rad * tilt[1],
        tilt_z_rad=sensors.misalignment_rad * tilt[2],
        accel_x_gain_ratio=1.0 + sensors.accel_scale_ratio * gain[0],
        accel_y_gain_ratio=1.0 + sensors.accel_scale_ratio * gain[1],
        roll_rate_gain_ratio=1.0 + sensors.gyro_scale_ratio * gain[2],
        yaw_rate_gain_ratio=1.0 + sensors.gyro_scale_ratio * gain[3],
        accel_x_bias_mps2=sensors.accel_bias_mps2 * bias[0],
        accel_y_bias_mps2=sensors.accel_bias_mps2 * bias[1],
        roll_rate_bias_radps=sensors.gyro_bias_radps * bias[2],
        yaw_rate_bias_radps=sensors.gyro_bias_radps * bias[3],
        accel_noise_mps2=sensors.accel_noise_mps2,
        gyro_noise_radps=sensors.gyro_noise_radps,
        jitter_samples_count=jitter_samples_count,
    )
    common = 1.0 + sensors.radius_common_ratio * radius[0]
    front_left, front_right, rear_left, rear_right = (common + sensors.radius_each_ratio * each for each in radius[1:])
    encoders = _Encoders(
        steer_offset_rad=sensors.steer_offset_rad * draws[13],
        steer_quantum_rad=sensors.steer_quantum_rad,
        wheel_gain_ratio=(front_left, front_right, rear_left, rear_right),
        wheel_noise_ratio=sensors.wheel_noise_ratio,
        wheel_quantum_mps=sensors.wheel_quantum_mps,
        jitter_samples_count=jitter_samples_count,
    )
    return unit, encoders


@cache
def _is_exact(sensors: Sensors) -> bool:
    return sensors == scaled(sensors, 0.0)


@kernel
def _noise(word: np.uint64) -> float:
    """Return noise of mean 0 and deviation 1 from 64 random bits: the sum of their eight bytes.

    Drawing exactly normal numbers would take four times as long as all else that sensors do. A sum of eight is bell
    shaped as they are, but ends at 4.9 deviations (kurtosis 2.85 for 3).
    """
    pairs = (word & _EVEN_BYTES) + ((word >> _BYTE_BITS) & _EVEN_BYTES)
    total = (pairs * _EACH_PAIR) >> _UPPER_BITS
    return (float(total) - _BYTES_MEAN) / _BYTES_DEVIATION


@cached_kernel  # it calls nothing in other files, so its own is all there is to watch
def _sense_inertially(  # noqa: PLR0917 - compiled code takes its arguments by position
    force: FloatArray, rate: FloatArray, words: NDArray[np.uint64], unit: _Unit, sample_s: float, sensed: FloatArray
) -> None:
    """Fill in forward and left acceleration, roll rate and yaw rate. (4, n)"""
    n = len(force)
    # Rigid body: the unit feels the centripetal and the angular acceleration of where it sits.
    there = np.empty((n, 2))
    for k in range(n):
        after, before = min(k + 1, n - 1), max(k - 1, 0)
        turning = (rate[after, 2] - rate[before, 2]) / (max(after - before, 1) * sample_s)
        w = rate[k, 2]
        there[k, 0] = force[k, 0] - w * w * unit.x_m - turning * unit.y_m
        there[k, 1] = force[k, 1] + turning * unit.x_m - w * w * unit.y_m
    for k in range(n):
        at = min(max(k + unit.jitter_samples_count * _noise(words[k, 8]), 0.0), n - 1.0)
        i = min(int(at), max(n - 2, 0))
        j = min(i + 1, n - 1)
        q = at - i
        p = 1.0 - q
        fx, fy = p * there[i, 0] + q * there[j, 0], p * there[i, 1] + q * there[j, 1]
        fz = p * force[i, 2] + q * force[j, 2]
        wx, wy = p * rate[i, 0] + q * rate[j, 0], p * rate[i, 1] + q * rate[j, 1]
        wz = p * rate[i, 2] + q * rate[j, 2]
        # As a unit reads vectors that is turned by small angles.
        accel_x = fx + unit.tilt_z_rad * fy - unit.tilt_y_rad * fz
        accel_y = fy + unit.tilt_x_rad * fz - unit.tilt_z_rad * fx
        roll_rate = wx + unit.tilt_z_rad * wy - unit.tilt_y_rad * wz
        yaw_rate = wz + unit.tilt_y_rad * wx - unit.tilt_x_rad * wy
        sensed[0, k] = (
            accel_x * unit.accel_x_gain_ratio + unit.accel_x_bias_mps2 + unit.accel_noise_mps2 * _noise(words[k, 0])
        )
        sensed[1, k] = (
            accel_y * unit.accel_y_gain_ratio + unit.accel_y_bias_mps2 + unit.accel_noise_mps2 * _noise(words[k, 1])
        )
        sensed[2, k] = roll_rate * unit.roll_rate_gain_ratio + unit.roll_rate_bias_radps
        sensed[2, k] += unit.gyro_noise_radps * _noise(words[k, 2])
        sensed[3, k] = yaw_rate * unit.yaw_rate_gain_ratio + unit.yaw_rate_bias_radps
        sensed[3, k] += unit.gyro_noise_radps * _noise(words[k, 3])
    # What the controller makes of it: its own yaw rate, and where the unit should sit.
    for k in range(n):
        after, before = min(k + _SLOPE_REACH_COUNT, n - 1), max(k - _SLOPE_REACH_COUNT, 0)
        turning = (sensed[3, after] - sensed[3, before]) / (max(after - before, 1) * sample_s)
        w = sensed[3, k]
        sensed[0, k] += unit.mount_m * (w * w + turning)
        sensed[1, k] += unit.mount_m * (w * w - turning)


@cached_kernel  # as above
def _sense_wheels(  # noqa: PLR0917 - as above
    steer: FloatArray,
    wheels: FloatArray,
    words: NDArray[np.uint64],
    encoders: _Encoders,
    steer_sensed: FloatArray,
    wheels_sensed: FloatArray,
) -> None:
    """Fill in the steering angle (n,) and the four wheel speeds (n, 4)."""
    n = len(steer)
    quantum = encoders.steer_quantum_rad
    for k in range(n):
        at = min(max(k + encoders.jitter_samples_count * _noise(words[k, 9]), 0.0), n - 1.0)
        i = min(int(at), max(n - 2, 0))
        j = min(i + 1, n - 1)
        value = (1.0 - (at - i)) * steer[i] + (at - i) * steer[j] + encoders.steer_offset_rad
        steer_sensed[k] = np.rint(value / quantum) * quantum if quantum > 0.0 else value
    quantum = encoders.wheel_quantum_mps
    for k in range(n):
        at = min(max(k + encoders.jitter_samples_count * _noise(words[k, 10]), 0.0), n - 1.0)
        i = min(int(at), max(n - 2, 0))
        j = min(i + 1, n - 1)
        for wheel in range(4):
            value = (1.0 - (at - i)) * wheels[i, wheel] + (at - i) * wheels[j, wheel]
            value *= encoders.wheel_gain_ratio[wheel] * (1.0 + encoders.wheel_noise_ratio * _noise(words[k, 4 + wheel]))
            wheels_sensed[k, wheel] = np.rint(value / quantum) * quantum if quantum > 0.0 else value


@cached_kernel  # as above
def _remember(draws: FloatArray, keep: float) -> None:
    """Turn white sequences of unit size, one per column, into first-order Gauss-Markov ones of unit size."""
    fresh = np.sqrt(1.0 - keep * keep)
    for k in range(1, len(draws)):
        for j in range(draws.shape[1]):
            draws[k, j] = keep * draws[k - 1, j] + fresh * draws[k, j]

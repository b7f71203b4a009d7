"""The forward speed of the centre of gravity from four wheel encoders, the steering and the yaw rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vehicle_client.estimation.filters import rate_of_change, smoothed

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.observer import ObserverParameters
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

WEIGHT_FLOOR = 1e-3
"""No wheel loses its voice entirely, so that four locked wheels still give a number."""
STRAY_FRAC = 0.1
STRAY_MPS = 0.3


def speed_at_wheels_mps(
    wheel_speed_mps: FloatArray,
    yaw_rate_radps: FloatArray,
    steer_rad: FloatArray,
    velocity_y_mps: FloatArray,
    *,
    vehicle: VehicleGeometry,
) -> FloatArray:
    """Return the forward speed of the centre of gravity as each rolling wheel tells it. (n, 4)

    Args:
        wheel_speed_mps: Rotation times rolling radius, columns as in `WHEELS`. (n, 4)
        yaw_rate_radps: Left turn positive. (n,)
        steer_rad: Mean angle of the front wheels; both are taken at it. (n,)
        velocity_y_mps: Lateral velocity of the centre of gravity, left positive. (n,)
        vehicle: Where the wheels sit.

    References:
        A wheel at (x, y) rolls with v = (V_x - w y) cos(d) + (V_y + w x) sin(d); solved for V_x. Our reconstruction
        of the block that the paper cites from Selmanaj et al.
    """
    w = yaw_rate_radps
    front = vehicle.front_axle_m
    half_track = vehicle.track_m / 2.0
    sin_d, cos_d = np.sin(steer_rad), np.cos(steer_rad)
    across = (velocity_y_mps + w * front) * sin_d
    # Column by column in memory, as everything after it reads.
    result = np.empty((4, len(w))).T
    result[:, 0] = (wheel_speed_mps[:, 0] - across) / cos_d + w * half_track
    result[:, 1] = (wheel_speed_mps[:, 1] - across) / cos_d - w * half_track
    result[:, 2] = wheel_speed_mps[:, 2] + w * half_track
    result[:, 3] = wheel_speed_mps[:, 3] - w * half_track
    return result


def encoder_speed_mps(
    wheel_speed_mps: FloatArray,
    yaw_rate_radps: FloatArray,
    steer_rad: FloatArray,
    accel_x_mps2: FloatArray,
    velocity_y_mps: FloatArray,
    *,
    vehicle: VehicleGeometry,
    parameters: ObserverParameters,
) -> FloatArray:
    """Return the forward speed of the centre of gravity, smoothed. (n,)

    A wheel whose speed changes otherwise than the accelerometer says is slipping and counts less. A wheel that
    disagrees with the median of the four by more than 10 % and 0.3 m/s is locked, spinning or broken and counts
    almost nothing; the latter rule is ours, since a stuck encoder at steady speed changes just as it should.

    Args:
        wheel_speed_mps: Columns as in `WHEELS`. (n, 4)
        yaw_rate_radps: Left turn positive. (n,)
        steer_rad: Mean angle of the front wheels. (n,)
        accel_x_mps2: Forward acceleration without gravity. (n,)
        velocity_y_mps: Lateral velocity; zeros are a good first guess. (n,)
        vehicle: Where the wheels sit.
        parameters: The threshold and the two widths of the weights, and what smooths.

    References:
        Langstrand and Rabi, table of observer parameters (threshold 1, widths 4.5 and 1); the weight
        exp(-((dV_i/dt - A_x) / sigma)^2 / 2) is our reconstruction.
    """
    speeds = speed_at_wheels_mps(wheel_speed_mps, yaw_rate_radps, steer_rad, velocity_y_mps, vehicle=vehicle)
    steady = np.abs(accel_x_mps2) < parameters.accel_x_threshold_mps2
    sigma = np.where(steady, parameters.sigma_wheel_steady_mps2, parameters.sigma_wheel_accelerating_mps2)
    mismatch = np.empty_like(speeds)
    for i in range(4):
        # Encoders count in steps: unsmoothed, the derivative is mostly the step.
        mismatch[:, i] = rate_of_change(smoothed(speeds[:, i], parameters.lowpass))
    mismatch = (mismatch - accel_x_mps2[:, None]) / sigma[:, None]
    weights = np.maximum(np.exp(-0.5 * mismatch**2), WEIGHT_FLOOR)
    median = _median_of_four(speeds)[:, None]
    stray = np.abs(speeds - median) > STRAY_MPS + STRAY_FRAC * np.abs(median)
    weights[stray] = WEIGHT_FLOOR**2
    return smoothed(np.sum(weights * speeds, axis=1) / np.sum(weights, axis=1), parameters.lowpass)


def _median_of_four(values: FloatArray) -> FloatArray:
    """Return the median of each row, faster than by sorting. (n,)

    Args:
        values: (n, 4)
    """
    a, b, c, d = values.T
    lower = np.maximum(np.minimum(a, b), np.minimum(c, d))
    upper = np.minimum(np.maximum(a, b), np.maximum(c, d))
    median: FloatArray = (lower + upper) / 2.0
    return median

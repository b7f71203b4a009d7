"""Estimation and statistics with scipy, as its documentation suggests: arrays, ready-made filters and statistics.

`filtfilt` with taps of `firwin`, `solve_banded` for the two systems of equations that are loops elsewhere (the roll
filter's and the observer's), `cumulative_trapezoid`, `gradient`, `quantile`, `skew` and `kurtosis`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import integrate, linalg, signal, stats

from roadgrip.units import GRAVITY_MPS2, SAMPLE_RATE_HZ, SAMPLE_S
from vehicle_client.estimation.filters import CUTOFF_HZ, TAPS_COUNT
from vehicle_client.estimation.observer import SPEED_FLOOR_MPS
from vehicle_client.estimation.wheel_speed import STRAY_FRAC, STRAY_MPS, WEIGHT_FLOOR

if TYPE_CHECKING:
    from bench.speed.steps import Steps
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.observer import ObserverParameters

TAPS = signal.firwin(TAPS_COUNT, CUTOFF_HZ, fs=SAMPLE_RATE_HZ, window="hamming")


def values(steps: Steps) -> FloatArray:
    """Return the kinematic features. (55,)"""
    trace, profile, vehicle = steps.trace, steps.section.profile, steps.vehicle
    yaw_rate = trace.yaw_rate_radps - steps.offsets.yaw_rate_radps
    accel_y = smoothed(trace.accel_y_mps2 - steps.offsets.accel_y_mps2)
    steer = smoothed(trace.steer_rad - steps.offsets.steer_rad)
    climb = np.arctan(np.interp(steps.station_m, profile.station_m, profile.grade_ratio))
    accel_x = smoothed(trace.accel_x_mps2 - steps.offsets.accel_x_mps2) - GRAVITY_MPS2 * np.sin(climb)
    speed = encoder_speed(steps, yaw_rate, steer, accel_x, np.zeros_like(steer))
    rear_slip = steps.parameters.rear_slip_gradient_s2pm * speed * accel_y
    gripping = smoothed(steps.parameters.grip_pull_ratio * (vehicle.rear_axle_m * yaw_rate - rear_slip))
    speed = encoder_speed(steps, yaw_rate, steer, accel_x, gripping)
    rolling = trace.roll_rate_radps - yaw_rate * np.tan(climb)
    turned = integrate.cumulative_trapezoid(rolling, dx=SAMPLE_S, initial=0)
    gain = np.gradient(gripping, SAMPLE_S)
    # The map's bank would be taken off the roll here and added again for gravity.
    tilt = np.arcsin(np.clip((accel_y - yaw_rate * speed - gain) / GRAVITY_MPS2, -1.0, 1.0))
    lean = turned + slow_part(tilt - turned, steps.parameters.roll_crossover_hz)
    road_accel_y = (accel_y - GRAVITY_MPS2 * np.sin(lean)) / np.cos(lean)
    rate = sideslip_rate(road_accel_y, yaw_rate, speed)
    straight = straightness(yaw_rate, steer, rate, steps.parameters)
    there = observed(accel_x, road_accel_y, yaw_rate, speed, straight, gripping=gripping, parameters=steps.parameters)
    back = observed(
        -accel_x[::-1],
        -road_accel_y[::-1],
        -yaw_rate[::-1],
        speed[::-1],
        straight[::-1],
        gripping=gripping[::-1],
        parameters=steps.parameters,
    )
    velocity_x, velocity_y = smoothed((there + back[:, ::-1]) / 2.0)
    sideslip = np.arctan(velocity_y / np.maximum(velocity_x, SPEED_FLOOR_MPS))
    t = np.tan(steer)
    excess = yaw_rate - 2.0 * speed * t / (2.0 * vehicle.wheelbase_m + vehicle.track_m * np.abs(t))
    signals = (steer, sideslip, rate, excess, np.maximum(speed, 0.0))
    return np.concatenate([statistics(values[steps.inside]) for values in signals])


def smoothed(values: FloatArray) -> Any:
    """Return the signal low-passed forward and backward; 60 samples of padding make it forget how it began."""
    return signal.filtfilt(TAPS, [1.0], values, padtype="odd", padlen=2 * (TAPS_COUNT - 1))


def encoder_speed(
    steps: Steps, yaw_rate: FloatArray, steer: FloatArray, accel_x: FloatArray, velocity_y: FloatArray
) -> Any:
    """Return the forward speed from four wheels, each weighed by whether it is believed."""
    wheels, vehicle, parameters = steps.trace.wheel_speed_mps, steps.vehicle, steps.parameters
    across = (velocity_y + yaw_rate * vehicle.front_axle_m) * np.sin(steer)
    side = yaw_rate * vehicle.track_m / 2.0
    speeds = np.stack(
        [
            (wheels[:, 0] - across) / np.cos(steer) + side,
            (wheels[:, 1] - across) / np.cos(steer) - side,
            wheels[:, 2] + side,
            wheels[:, 3] - side,
        ]
    )
    gains = np.gradient(smoothed(speeds), SAMPLE_S, axis=1)
    steady = np.abs(accel_x) < parameters.accel_x_threshold_mps2
    sigma = np.where(steady, parameters.sigma_wheel_steady_mps2, parameters.sigma_wheel_accelerating_mps2)
    weights = np.maximum(np.exp(-0.5 * ((gains - accel_x) / sigma) ** 2), WEIGHT_FLOOR)
    median = np.median(speeds, axis=0)
    weights[np.abs(speeds - median) > STRAY_MPS + STRAY_FRAC * np.abs(median)] = WEIGHT_FLOOR**2
    return smoothed(np.average(speeds, axis=0, weights=weights))


def slow_part(values: FloatArray, crossover_hz: float) -> Any:
    """Return what is slower than the crossover: the tridiagonal equations, solved."""
    w = 1.0 / (2.0 * np.pi * crossover_hz * SAMPLE_S) ** 2
    bands = np.full((3, len(values)), -w)
    bands[1] = 1.0 + 2.0 * w
    bands[1, [0, -1]] = 1.0 + w
    return linalg.solve_banded((1, 1), bands, values)


def sideslip_rate(accel_y: FloatArray, yaw_rate: FloatArray, speed: FloatArray) -> Any:
    """Return the sideslip rate, smoothed."""
    v = np.maximum(speed, SPEED_FLOOR_MPS)
    return smoothed((accel_y - yaw_rate * v) / v)


def straightness(yaw_rate: FloatArray, steer: FloatArray, rate: FloatArray, parameters: ObserverParameters) -> Any:
    """Return F(t): 1 on a straight, towards 0 in action."""
    p = parameters
    yaw_rate = smoothed(yaw_rate)
    exponent = (yaw_rate / p.sigma_yaw_rate_radps) ** 2
    exponent += (np.gradient(yaw_rate, SAMPLE_S) / p.sigma_yaw_accel_radps2) ** 2
    exponent += (steer / p.sigma_steer_rad) ** 2
    exponent += (np.gradient(steer, SAMPLE_S) / p.sigma_steer_rate_radps) ** 2
    exponent += (rate / p.sigma_sideslip_rate_radps) ** 2
    exponent += (np.gradient(rate, SAMPLE_S) / p.sigma_sideslip_accel_radps2) ** 2
    return np.exp(-0.5 * exponent)


def observed(
    accel_x: FloatArray,
    accel_y: FloatArray,
    yaw_rate: FloatArray,
    speed: FloatArray,
    straight: FloatArray,
    *,
    gripping: FloatArray,
    parameters: ObserverParameters,
) -> Any:
    """Return both velocities of the observer: all trapezoidal steps as one banded system of equations. (2, n)"""
    w, half, coupling = yaw_rate, SAMPLE_S / 2.0, parameters.alpha_2_ratio
    pull = parameters.alpha_0_1ps + parameters.alpha_1_ratio * np.abs(w)
    a00, a01, a10, a11 = -half * pull, half * w, -half * (coupling + 1.0) * w, -half * straight
    u0 = half * (accel_x + pull * speed)
    u1 = half * (accel_y + coupling * w * speed + straight * gripping)
    # Unknowns x0, y0, x1, y1, ...; column j of equation i stands in row 1 + i - j of the bands.
    n = len(w)
    bands = np.zeros((5, 2 * n))
    bands[1, 0::2], bands[1, 1::2] = 1.0 - a00, 1.0 - a11
    bands[0, 1::2], bands[2, 0::2] = -a01, -a10
    bands[3, 0:-2:2], bands[3, 1:-2:2] = -1.0 - a00[:-1], -1.0 - a11[:-1]
    bands[2, 1:-2:2], bands[4, 0:-2:2] = -a01[:-1], -a10[:-1]
    bands[0, 1] = bands[2, 0] = 0.0
    bands[1, :2] = 1.0
    right = np.empty(2 * n)
    right[0], right[1] = speed[0], gripping[0]
    right[2::2], right[3::2] = u0[1:] + u0[:-1], u1[1:] + u1[:-1]
    return linalg.solve_banded((3, 1), bands, right).reshape(-1, 2).T


def statistics(samples: FloatArray) -> FloatArray:
    """Return the eleven statistics of a bag of samples. (11,)"""
    q20, q40, median, q60, q80 = np.quantile(samples, [0.2, 0.4, 0.5, 0.6, 0.8])
    return np.array(
        [
            samples.mean(),
            samples.std(),
            q20,
            q40,
            q60,
            q80,
            samples.min(),
            median,
            samples.max(),
            stats.skew(samples),
            stats.kurtosis(samples),
        ]
    )

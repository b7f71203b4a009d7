"""The kinematic observer: longitudinal and lateral velocity without a model of tyres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.filters import LowPass, rate_of_change, smoothed
from vehicle_client.estimation.recursion import recursion_states

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

SPEED_FLOOR_MPS = 1.0
"""Below it angles of the velocity mean nothing; divisions by the speed use this instead."""


@dataclass(frozen=True, slots=True)
class ObserverParameters:
    """Constants of the onboard estimation, the paper's by default; they belong to a vehicle.

    Attributes:
        alpha_0_1ps: Pull of the longitudinal velocity to the encoders.
        alpha_1_ratio: The same per rad/s of yaw rate.
        alpha_2_ratio: Coupling of that difference into the lateral velocity.
        accel_x_threshold_mps2: Beyond it the vehicle brakes or accelerates.
        sigma_wheel_steady_mps2: Width of a wheel's weight below the threshold.
        sigma_wheel_accelerating_mps2: The same beyond the threshold.
        sigma_yaw_rate_radps: Widths of what counts as straight driving, from here on.
        sigma_yaw_accel_radps2: Of the yaw acceleration.
        sigma_steer_rad: Of the steering angle.
        sigma_steer_rate_radps: Of its rate.
        sigma_sideslip_rate_radps: Of the sideslip rate.
        sigma_sideslip_accel_radps2: Of its rate.
        roll_crossover_hz: Where slow roll from the accelerometer meets fast roll from the gyro. The paper gives no
            number; of those between 0.01 and 10 Hz this one left the least sideslip error on simulated drives with
            automotive sensors.
        lowpass: Which reading of the paper's smoothing filter.
    """

    alpha_0_1ps: float = 15.0
    alpha_1_ratio: float = 14.0
    alpha_2_ratio: float = 5.0
    accel_x_threshold_mps2: float = 1.0
    sigma_wheel_steady_mps2: float = 4.5
    sigma_wheel_accelerating_mps2: float = 1.0
    sigma_yaw_rate_radps: float = 0.22
    sigma_yaw_accel_radps2: float = 0.22
    sigma_steer_rad: float = 0.12
    sigma_steer_rate_radps: float = 0.08
    sigma_sideslip_rate_radps: float = 0.05
    sigma_sideslip_accel_radps2: float = 0.3
    roll_crossover_hz: float = 0.1
    lowpass: LowPass = LowPass.HAMMING_FIR


PAPER_PARAMETERS = ObserverParameters()


def sideslip_rate_radps(
    accel_y_mps2: FloatArray,
    yaw_rate_radps: FloatArray,
    speed_mps: FloatArray,
    *,
    lowpass: LowPass = LowPass.HAMMING_FIR,
) -> FloatArray:
    """Return the sideslip rate as the paper estimates it, smoothed. (n,)

    Args:
        accel_y_mps2: Lateral acceleration in the road's plane, gravity taken out. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        speed_mps: From the encoders; below 1 m/s it is taken as 1 m/s. (n,)
        lowpass: What smooths it.

    References:
        Langstrand and Rabi, equation of the sideslip rate: (A_y - omega_z V_x) / V_x.
    """
    v = np.maximum(speed_mps, SPEED_FLOOR_MPS)
    return smoothed((accel_y_mps2 - yaw_rate_radps * v) / v, lowpass)


def straightness_1ps(
    yaw_rate_radps: FloatArray,
    steer_rad: FloatArray,
    sideslip_rate_radps: FloatArray,
    *,
    parameters: ObserverParameters,
) -> FloatArray:
    """Return F(t), the rate at which the lateral velocity is pulled to zero: 1 on a straight, towards 0 in action. (n,)

    Args:
        yaw_rate_radps: Left turn positive. (n,)
        steer_rad: Mean angle of the front wheels, smoothed. (n,)
        sideslip_rate_radps: Smoothed. (n,)
        parameters: The six widths, and what smooths the yaw rate.

    References:
        The paper gives only the widths. That F is the product of Gaussians of peak 1 in SI units is our
        reconstruction; on recorded cars it is best or near best among the readings that were tried.
    """
    p = parameters
    yaw_rate = smoothed(yaw_rate_radps, p.lowpass)
    exponent = (yaw_rate / p.sigma_yaw_rate_radps) ** 2
    exponent += (rate_of_change(yaw_rate) / p.sigma_yaw_accel_radps2) ** 2
    exponent += (steer_rad / p.sigma_steer_rad) ** 2
    exponent += (rate_of_change(steer_rad) / p.sigma_steer_rate_radps) ** 2
    exponent += (sideslip_rate_radps / p.sigma_sideslip_rate_radps) ** 2
    exponent += (rate_of_change(sideslip_rate_radps) / p.sigma_sideslip_accel_radps2) ** 2
    return np.exp(-0.5 * exponent)


def observed_velocity_mps(
    accel_x_mps2: FloatArray,
    accel_y_mps2: FloatArray,
    yaw_rate_radps: FloatArray,
    encoder_speed_mps: FloatArray,
    straightness_1ps: FloatArray,
    *,
    parameters: ObserverParameters,
) -> tuple[FloatArray, FloatArray]:
    """Return longitudinal and lateral velocity of the centre of gravity, not smoothed yet. Both (n,)

    Starts at the encoder speed with no lateral velocity. The trapezoidal rule keeps the discretisation exact to
    second order and stable for any constants that are stable in continuous time.

    Args:
        accel_x_mps2: In the road's plane, gravity taken out, forward. (n,)
        accel_y_mps2: The same, left. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        encoder_speed_mps: Forward. (n,)
        straightness_1ps: F(t). (n,)
        parameters: The three gains.

    References:
        Langstrand and Rabi, section "Observer for longitudinal and lateral speeds", after Selmanaj et al.
    """
    w = yaw_rate_radps
    half = SAMPLE_S / 2.0
    pull = parameters.alpha_0_1ps + parameters.alpha_1_ratio * np.abs(w)
    coupling = parameters.alpha_2_ratio
    # x' = A x + u with A = [[-pull, w], [-(alpha_2 + 1) w, -F]].
    a00, a01, a10, a11 = -half * pull, half * w, -half * (coupling + 1.0) * w, -half * straightness_1ps
    u0 = half * (accel_x_mps2 + pull * encoder_speed_mps)
    u1 = half * (accel_y_mps2 + coupling * w * encoder_speed_mps)
    # (I - A[k+1]) x[k+1] = (I + A[k]) x[k] + u[k] + u[k+1], solved for all k at once.
    n00, n01, n10, n11 = 1.0 - a00[1:], -a01[1:], -a10[1:], 1.0 - a11[1:]
    scale = 1.0 / (n00 * n11 - n01 * n10)
    e00, e01, e10, e11 = 1.0 + a00[:-1], a01[:-1], a10[:-1], 1.0 + a11[:-1]
    b0, b1 = u0[1:] + u0[:-1], u1[1:] + u1[:-1]
    transition = (
        (n11 * e00 - n01 * e10) * scale,
        (n11 * e01 - n01 * e11) * scale,
        (n00 * e10 - n10 * e00) * scale,
        (n00 * e11 - n10 * e01) * scale,
    )
    addend = ((n11 * b0 - n01 * b1) * scale, (n00 * b1 - n10 * b0) * scale)
    return recursion_states(transition, addend, start=(float(encoder_speed_mps[0]), 0.0))


def sideslip_rad(velocity_x_mps: FloatArray, velocity_y_mps: FloatArray) -> FloatArray:
    """Return the angle from where the nose points to where the vehicle moves, left positive. (n,)

    The forward velocity counts as 1 m/s where it is less.

    References:
        Langstrand and Rabi, section "Estimating sideslip and its rate": arctan(V_y / V_x).
    """
    return np.arctan(velocity_y_mps / np.maximum(velocity_x_mps, SPEED_FLOOR_MPS))

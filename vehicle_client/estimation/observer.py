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
    """Constants of the onboard estimation, the paper's by default where it gives one; they belong to a vehicle.

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
        rear_slip_gradient_s2pm: Slip angle of the rear tyres per lateral acceleration while they grip, rad per m/s^2
            (the cornering compliance of the rear axle). Cars have 0.003 to 0.009; the default was tuned on simulated
            drives of the paper's car, as the paper tuned its constants.
        grip_pull_ratio: Which share of the lateral velocity of a gripping car F(t) pulls to; 0 is the paper's pull to
            zero.
        roll_gradient_s2pm: Roll of the body per lateral acceleration, rad per m/s^2; stands in for a roll gyro that a
            car does not have, and is not used where there is one. Cars have 0.004 (sports cars) to 0.012; the default
            is an estimate of the paper's car.
        roll_crossover_hz: Where slow roll from the accelerometer meets fast roll from the gyro. The paper gives no
            number; this one did well on simulated drives with either grade of sensors, whatever the map says of bank.
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
    rear_slip_gradient_s2pm: float = 0.0075
    grip_pull_ratio: float = 1.0
    roll_gradient_s2pm: float = 0.008
    roll_crossover_hz: float = 0.06
    lowpass: LowPass = LowPass.HAMMING_FIR


XC90_PARAMETERS = ObserverParameters()
"""For the car of the paper, with what we added."""
PAPER_PARAMETERS = ObserverParameters(grip_pull_ratio=0.0)
"""The same with the paper's own pull of the lateral velocity, to zero."""


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


def gripping_velocity_y_mps(
    accel_y_mps2: FloatArray,
    yaw_rate_radps: FloatArray,
    speed_mps: FloatArray,
    *,
    rear_axle_m: float,
    parameters: ObserverParameters,
) -> FloatArray:
    """Return the lateral velocity that the centre of gravity has while the rear tyres grip, smoothed. (n,)

    The rear wheels cannot steer: they roll where they point, but for the slip angle that their share of the lateral
    force needs. On a straight that is no lateral velocity, as the paper has it; in a turn of 20 m radius taken slowly
    it is 4 degrees of sideslip, without any sliding.

    Args:
        accel_y_mps2: Specific force to the left, smoothed. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        speed_mps: Forward. (n,)
        rear_axle_m: Centre of gravity to rear axle.
        parameters: How far the rear tyres slip, and which share of the result is asked for.

    References:
        Bundorf and Leffert, The cornering compliance concept for description of vehicle directional control
        properties, SAE 760713: sideslip = b_r / R - D_r a_y. Not in Langstrand and Rabi.
    """
    p = parameters
    rolling = rear_axle_m * yaw_rate_radps
    slipping = p.rear_slip_gradient_s2pm * speed_mps * accel_y_mps2
    return smoothed(p.grip_pull_ratio * (rolling - slipping), p.lowpass)


def observed_velocity_mps(
    accel_x_mps2: FloatArray,
    accel_y_mps2: FloatArray,
    yaw_rate_radps: FloatArray,
    encoder_speed_mps: FloatArray,
    straightness_1ps: FloatArray,
    *,
    parameters: ObserverParameters,
    gripping_velocity_y_mps: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return longitudinal and lateral velocity of the centre of gravity, not smoothed yet. Both (n,)

    Starts at the encoder speed and the lateral velocity that F pulls to. The trapezoidal rule keeps the discretisation
    exact to second order and stable for any constants that are stable in continuous time.

    Args:
        accel_x_mps2: In the road's plane, gravity taken out, forward. (n,)
        accel_y_mps2: The same, left. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        encoder_speed_mps: Forward. (n,)
        straightness_1ps: F(t). (n,)
        parameters: The three gains.
        gripping_velocity_y_mps: The lateral velocity that F pulls to; zero, the paper's, if None. (n,)

    References:
        Langstrand and Rabi, section "Observer for longitudinal and lateral speeds", after Selmanaj et al. That F pulls
        to another velocity than zero is ours.
    """
    w = yaw_rate_radps
    half = SAMPLE_S / 2.0
    pull = parameters.alpha_0_1ps + parameters.alpha_1_ratio * np.abs(w)
    coupling = parameters.alpha_2_ratio
    # x' = A x + u with A = [[-pull, w], [-(alpha_2 + 1) w, -F]].
    a00, a01, a10, a11 = -half * pull, half * w, -half * (coupling + 1.0) * w, -half * straightness_1ps
    u0 = half * (accel_x_mps2 + pull * encoder_speed_mps)
    u1 = half * (accel_y_mps2 + coupling * w * encoder_speed_mps)
    start_y = 0.0
    if gripping_velocity_y_mps is not None:
        u1 += half * straightness_1ps * gripping_velocity_y_mps
        start_y = float(gripping_velocity_y_mps[0])
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
    return recursion_states(transition, addend, start=(float(encoder_speed_mps[0]), start_y))


def two_way_velocity_mps(
    accel_x_mps2: FloatArray,
    accel_y_mps2: FloatArray,
    yaw_rate_radps: FloatArray,
    encoder_speed_mps: FloatArray,
    straightness_1ps: FloatArray,
    *,
    parameters: ObserverParameters,
    gripping_velocity_y_mps: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the observer run forward and run backward in time, not smoothed yet. Both (n,)

    Seen backward, a drive has the same velocities, while accelerations and yaw rate change sign; so the observer
    is its own mirror in time. Where F is constant, an offset of the accelerometer moves the two runs apart by as much
    to either side, and what the pull takes from the lateral velocity comes without a lag.

    Args:
        accel_x_mps2: As `observed_velocity_mps`. (n,)
        accel_y_mps2: The same. (n,)
        yaw_rate_radps: The same. (n,)
        encoder_speed_mps: The same. (n,)
        straightness_1ps: The same. (n,)
        parameters: The same.
        gripping_velocity_y_mps: The same. (n,)

    References:
        Langstrand and Rabi, section "Smoothing using a two-way filter": filters run once in either direction of time.
        That the observer itself does so is our reading.
    """
    x, y = observed_velocity_mps(
        accel_x_mps2,
        accel_y_mps2,
        yaw_rate_radps,
        encoder_speed_mps,
        straightness_1ps,
        parameters=parameters,
        gripping_velocity_y_mps=gripping_velocity_y_mps,
    )
    back_x, back_y = observed_velocity_mps(
        -accel_x_mps2[::-1],
        -accel_y_mps2[::-1],
        -yaw_rate_radps[::-1],
        encoder_speed_mps[::-1],
        straightness_1ps[::-1],
        parameters=parameters,
        gripping_velocity_y_mps=None if gripping_velocity_y_mps is None else gripping_velocity_y_mps[::-1],
    )
    return (x + back_x[::-1]) / 2.0, (y + back_y[::-1]) / 2.0


def sideslip_rad(velocity_x_mps: FloatArray, velocity_y_mps: FloatArray) -> FloatArray:
    """Return the angle from where the nose points to where the vehicle moves, left positive. (n,)

    The forward velocity counts as 1 m/s where it is less.

    References:
        Langstrand and Rabi, section "Estimating sideslip and its rate": arctan(V_y / V_x).
    """
    return np.arctan(velocity_y_mps / np.maximum(velocity_x_mps, SPEED_FLOOR_MPS))

"""The body on its tyres: steady circle, roll, the linear single-track model, free roll."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from bench.validation.picture import OURS, QUIET, SERIES, THEORY, label, legend, line, name, panels, write
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S, FloatArray
from vehicle_client.simulator.driver import understeer_gradient_s2pm
from vehicle_client.simulator.proving_ground import Motion, Plane, drive_open_loop
from vehicle_client.simulator.vehicle import XC90

CIRCLE_SPEED_MPS = 20.0
FRICTIONS_MU = (0.2, 0.35, 0.6, 1.0)
SPEEDS_MPS = (15.0, 20.0, 25.0, 30.0, 35.0)
STEP_SPEED_MPS = 25.0


def draw(folder: Path) -> dict[str, Any]:
    """Draw the pictures of the body and return its figures.

    Args:
        folder: Where pictures go.
    """
    figure, axes = panels(2, 3, title="Body on its tyres")
    figures = {
        "steady_circle": _circle(axes[0]),
        "roll": _roll(axes[1]),
        "step_steer": _step(axes[2]),
        "eigenvalues": _eigenvalues(axes[3], axes[4]),
        "free_roll": _free_roll(axes[5]),
    }
    return figures | {"picture": write(figure, folder, "body")}


def _slow_circle(mu: float) -> Motion:
    """Turn the steering so slowly that the circle is steady, up to what friction carries and a little beyond."""
    top = (
        1.15 * mu * GRAVITY_MPS2 * (XC90.wheelbase_m / CIRCLE_SPEED_MPS**2 + understeer_gradient_s2pm(XC90)) + 0.04 * mu
    )
    steer = np.concatenate([np.zeros(50), np.linspace(0.0, top, 1500)])
    return drive_open_loop(Plane(friction_mu=mu), speed_mps=CIRCLE_SPEED_MPS, steer_rad=steer, hold_speed=True)


def _beyond_ackermann_rad(motion: Motion) -> FloatArray:
    beyond: FloatArray = motion.steer_rad - XC90.wheelbase_m * motion.yaw_rate_radps / motion.velocity_x_mps
    return beyond


def _gentle_gradient_s2pm() -> float:
    """Return the gradient where everything is linear: 0.1 m/s2, and no drive force, since nothing resists."""
    free = XC90._replace(drag_npm2ps2_ratio=0.0, tyre=XC90.tyre._replace(rolling_resistance_ratio=0.0))
    wanted = 0.1
    angle = wanted * (free.wheelbase_m / CIRCLE_SPEED_MPS**2 + understeer_gradient_s2pm(free))
    motion = drive_open_loop(
        Plane(friction_mu=1.0),
        speed_mps=CIRCLE_SPEED_MPS,
        steer_rad=np.full(800, angle),
        hold_speed=True,
        vehicle=free,
    )
    return float(_beyond_ackermann_rad(motion)[-1] / motion.accel_y_mps2[-1])


def _circle(axes: Any) -> dict[str, Any]:
    gradient = understeer_gradient_s2pm(XC90)
    figures: dict[str, Any] = {
        "linear_gradient_deg_per_g": math.degrees(gradient) * GRAVITY_MPS2,
        "gradient_over_linear_ratio": _gentle_gradient_s2pm() / gradient,
    }
    for mu, colour in zip(FRICTIONS_MU, (SERIES[0], SERIES[1], SERIES[3], SERIES[4]), strict=True):
        motion = _slow_circle(mu)
        accel, beyond = motion.accel_y_mps2, _beyond_ackermann_rad(motion)
        until = int(np.argmax(accel)) + 1
        line(axes, accel[:until], np.degrees(beyond[:until]), colour)
        name(axes, accel[until - 1], math.degrees(beyond[until - 1]), f"mu {mu:g}", colour, ha="center")
    axes.plot([0.0, 9.0], np.degrees([0.0, 9.0 * gradient]), color=THEORY, linestyle="--")
    name(axes, 9.0, math.degrees(9.0 * gradient), "linear", THEORY, xytext=(2, -3))
    axes.set_ylim(-0.5, 5.0)
    label(axes, "Steady circle at 20 m/s", x="lateral acceleration, m/s²", y="steering beyond Ackermann, °")
    return figures


def _roll(axes: Any) -> dict[str, float]:
    car = XC90
    arm = car.cog_height_m - (car.front_roll_centre_m * car.rear_axle_m + car.rear_roll_centre_m * car.front_axle_m) / (
        car.wheelbase_m
    )
    gradient = car.mass_kg * arm / (car.roll_stiffness_nmprad - car.mass_kg * GRAVITY_MPS2 * arm)
    motion = _slow_circle(1.0)
    until = int(np.argmax(motion.accel_y_mps2)) + 1
    accel, roll = motion.accel_y_mps2[:until], motion.roll_rad[:until]
    line(axes, accel, np.degrees(roll), OURS)
    axes.plot([0.0, 9.0], np.degrees([0.0, 9.0 * gradient]), color=THEORY, linestyle="--")
    name(axes, 6.0, math.degrees(6.0 * gradient), "springs and weight", THEORY, ha="right", xytext=(-12, 4))
    label(axes, "Roll angle in the steady circle, mu 1", x="lateral acceleration, m/s²", y="roll, °")
    rolled = accel > 3.0  # the turning in is slow, not infinitely so
    return {
        "gradient_deg_per_g": math.degrees(gradient) * GRAVITY_MPS2,
        "largest_error_ratio": float(np.abs(roll[rolled] / (gradient * accel[rolled]) - 1.0).max()),
    }


def single_track(speed_mps: float) -> tuple[FloatArray, FloatArray]:
    """Return the linear single-track model as x' = A x + b steer.

    The states are lateral velocity, yaw rate, both axle forces, which build up over the tyres' relaxation length, and
    the angle by which the front wheels give way to their axle's force.

    Args:
        speed_mps: Constant.

    References:
        Mitschke and Wallentowitz, Dynamik der Kraftfahrzeuge, part III; Pacejka, Tire and Vehicle Dynamics, 1.3.
    """
    car = XC90
    a, b, m, v, izz = car.front_axle_m, car.rear_axle_m, car.mass_kg, speed_mps, car.yaw_inertia_kgm2
    cf, cr = _axle_stiffness_nprad()
    # Relaxation length is the stiffness of a tyre over that of its carcass.
    lf, lr = (0.5 * c / car.tyre.stiffness_y_npm for c in (cf, cr))
    give, lag = car.steer_compliance_radpn, car.steer_compliance_lag_s
    system = [
        [0.0, -v, 1.0 / m, 1.0 / m, 0.0],
        [0.0, 0.0, a / izz, -b / izz, 0.0],
        [-cf / lf, -a * cf / lf, -v / lf, 0.0, -v * cf / lf],
        [-cr / lr, b * cr / lr, 0.0, -v / lr, 0.0],
        [0.0, 0.0, give / lag, 0.0, -1.0 / lag],
    ]
    return np.array(system), np.array([0.0, 0.0, v * cf / lf, 0.0, 0.0])


def textbook_single_track(speed_mps: float) -> FloatArray:
    """Return A of the model with two states, lateral velocity and yaw rate: tyres and steering answer at once. (2, 2)

    Args:
        speed_mps: Constant.
    """
    car = XC90
    a, b, m, v, izz = car.front_axle_m, car.rear_axle_m, car.mass_kg, speed_mps, car.yaw_inertia_kgm2
    tyres, cr = _axle_stiffness_nprad()
    cf = tyres / (1.0 + car.steer_compliance_radpn * tyres)
    return np.array(
        [
            [-(cf + cr) / (m * v), -(a * cf - b * cr) / (m * v) - v],
            [-(a * cf - b * cr) / (izz * v), -(a * a * cf + b * b * cr) / (izz * v)],
        ]
    )


def _axle_stiffness_nprad() -> tuple[float, float]:
    car, tyre = XC90, XC90.tyre
    stiffness = []
    for lever in (car.rear_axle_m, car.front_axle_m):
        load = 0.5 * car.mass_kg * GRAVITY_MPS2 * lever / car.wheelbase_m
        u = load / tyre.nominal_load_n - 1.0
        stiffness.append(2.0 * load * (tyre.slope_y1_ratio + (tyre.slope_y2_ratio - tyre.slope_y1_ratio) * u))
    return stiffness[0], stiffness[1]


def linear_answer(speed_mps: float, steer_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lateral velocity and yaw rate of the linear single-track model, every 10 ms. (n,) each

    Args:
        speed_mps: Held.
        steer_rad: Every 10 ms, straight lines between. (n,)
    """
    system, entry = single_track(speed_mps)
    # Exact for straight lines of the input: the matrix exponential of the system with its input and the input's rate.
    count = len(entry)
    whole = np.zeros((count + 2, count + 2))
    whole[:count, :count], whole[:count, count], whole[count, count + 1] = system, entry, 1.0
    step = expm(whole * SAMPLE_S)
    states = np.zeros((len(steer_rad), count))
    for k in range(len(steer_rad) - 1):
        rate = (steer_rad[k + 1] - steer_rad[k]) / SAMPLE_S
        states[k + 1] = (step @ np.concatenate([states[k], [steer_rad[k], rate]]))[:count]
    return states[:, 0], states[:, 1]


def _step(axes: Any) -> dict[str, float]:
    steer = np.concatenate([np.zeros(20), np.full(180, 0.004)])
    motion = drive_open_loop(Plane(friction_mu=1.0), speed_mps=STEP_SPEED_MPS, steer_rad=steer, hold_speed=True)
    _, yaw = linear_answer(STEP_SPEED_MPS, steer)
    line(axes, motion.time_s, np.degrees(motion.yaw_rate_radps), OURS)
    line(axes, motion.time_s, np.degrees(yaw), THEORY, linestyle="--")
    top = math.degrees(float(yaw[-1]))
    name(axes, 0.6, 0.72 * top, "simulated", OURS)
    name(axes, 0.6, 0.62 * top, "linear single-track model", THEORY)
    label(axes, "Step of the steering by 0.23° at 25 m/s", x="time, s", y="yaw rate, °/s")
    return {
        "largest_deviation_over_peak_ratio": float(np.abs(motion.yaw_rate_radps - yaw).max() / yaw.max()),
        "steady_over_linear_ratio": float(motion.yaw_rate_radps[-20:].mean() / yaw[-20:].mean()),
    }


def identified(vy: FloatArray, yaw: FloatArray, steer: FloatArray) -> tuple[float, float]:
    """Return natural frequency in rad/s and damping of the two-state model that explains an answer best.

    Args:
        vy: Lateral velocity in m/s. (n,)
        yaw: Yaw rate in rad/s. (n,)
        steer: Steering angle in rad. (n,)
    """
    change = np.column_stack([np.gradient(vy, SAMPLE_S), np.gradient(yaw, SAMPLE_S)])
    known = np.column_stack([vy, yaw, steer])
    solved, *_ = np.linalg.lstsq(known[50:-50], change[50:-50], rcond=None)
    return frequency_and_damping(solved[:2].T)


def frequency_and_damping(system: FloatArray) -> tuple[float, float]:
    """Return natural frequency in rad/s and share of critical damping of a system of two states. (2, 2)"""
    natural = math.sqrt(abs(float(np.linalg.det(system))))
    return natural, float(-np.trace(system) / (2.0 * natural))


def _eigenvalues(frequency: Any, damping: Any) -> dict[str, float]:
    time = SAMPLE_S * np.arange(1200, dtype=np.float64)
    steer = 0.002 * np.sin(2.0 * np.pi * (0.2 * time + 0.5 * 0.1 * time**2))  # from 0.2 to 1.4 Hz
    found, wanted = [], []
    for speed in SPEEDS_MPS:
        motion = drive_open_loop(Plane(friction_mu=1.0), speed_mps=speed, steer_rad=steer, hold_speed=True)
        found.append(identified(motion.velocity_y_mps, motion.yaw_rate_radps, steer))
        wanted.append(identified(*linear_answer(speed, steer), steer))
    ours, linear = np.array(found), np.array(wanted)
    fine = np.linspace(SPEEDS_MPS[0], SPEEDS_MPS[-1], 60)
    textbook = np.array([frequency_and_damping(textbook_single_track(float(v))) for v in fine])
    for axes, k, unit in ((frequency, 0, 2.0 * np.pi), (damping, 1, 1.0)):
        line(axes, fine, textbook[:, k] / unit, QUIET, linestyle=":")
        axes.plot(SPEEDS_MPS, linear[:, k] / unit, "--", color=THEORY)
        axes.plot(SPEEDS_MPS, ours[:, k] / unit, "o", color=OURS, ms=5)
        axes.set_ylim(0.0, 1.15 * max(textbook[:, k].max(), ours[:, k].max()) / unit)
    legend(
        damping,
        ("simulated, from a sweep of the steering", OURS),
        ("linear, tyres and steering give way, same sweep", THEORY),
        ("textbook: eigenvalues of two states", QUIET),
        top=0.26,
    )
    label(frequency, "Natural frequency of yaw and sideslip", x="speed, m/s", y="Hz")
    label(damping, "Damping", x="speed, m/s", y="share of critical")
    return {
        "frequency_largest_error_ratio": float(np.abs(ours[:, 0] / linear[:, 0] - 1.0).max()),
        "damping_largest_error_ratio": float(np.abs(ours[:, 1] / linear[:, 1] - 1.0).max()),
    }


def _free_roll(axes: Any) -> dict[str, float]:
    car = XC90
    motion = drive_open_loop(Plane(friction_mu=0.8), speed_mps=40.0, steer_rad=np.zeros(4001))
    speed = motion.velocity_x_mps
    energy = 0.5 * car.mass_kg * speed**2 + 0.5 * car.wheel_inertia_kgm2 * (motion.wheel_speed_radps**2).sum(1)
    power = car.drag_npm2ps2_ratio * speed**3 + car.tyre.rolling_resistance_ratio * car.mass_kg * GRAVITY_MPS2 * speed
    lost = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1])) * SAMPLE_S])
    line(axes, motion.time_s, energy / 1e6, OURS)
    line(axes, motion.time_s, (energy[0] - lost) / 1e6, THEORY, linestyle="--")
    name(axes, 12.0, float(energy[1200]) / 1e6, "kinetic energy, wheels included", OURS)
    name(axes, 12.0, float(energy[1200]) / 1e6, "start minus air and rolling losses", THEORY, xytext=(-95, -32))
    label(axes, "Rolling out from 40 m/s", x="time, s", y="energy, MJ")
    return {"largest_residual_over_loss_ratio": float(np.abs(energy[0] - lost - energy)[500:].max() / lost[-1])}

"""Our car and the oracle on the same manoeuvres, and how far apart they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.simulator_oracle import (
    Course,
    Manoeuvre,
    OracleCar,
    Variant,
    comparable_car,
    drive_oracle,
    drive_ours,
    oracle_parameters,
)
from roadgrip.units import SAMPLE_S, FloatArray
from vehicle_client.simulator.vehicle import Vehicle

SPEED_MPS = 20.0
STEP_AT_S = 0.5
HANDS_RADPS = 0.4
"""How fast the oracle lets its front wheels be turned."""
STEP_ACCELS_MPS2 = (2.0, 4.0, 6.0)
"""Lateral acceleration that a neutral car would reach with the angle of the step."""
LOW_MU = 0.35
CIRCLE_ACCELS_MPS2 = (2.0, 4.0, 6.0)


def step_steer(parameters: Any, *, accel_mps2: float, friction_mu: float | None = None) -> Manoeuvre:
    """Return 5 s with one step of the steering after half a second.

    Args:
        parameters: The oracle's, for the wheelbase.
        accel_mps2: Lateral acceleration that a neutral car would reach.
        friction_mu: As in `Manoeuvre`.
    """
    angle = accel_mps2 * (parameters.a + parameters.b) / SPEED_MPS**2
    steer = np.clip((_time_s(5.0) - STEP_AT_S) * HANDS_RADPS, 0.0, angle)
    return Manoeuvre(SPEED_MPS, steer, friction_mu=friction_mu)


def widening_circle(parameters: Any) -> Manoeuvre:
    """Return a held speed while the steering is turned slowly, by 0.8 m/s3 of a neutral car's lateral acceleration."""
    rate = 0.8 * (parameters.a + parameters.b) / SPEED_MPS**2
    return Manoeuvre(SPEED_MPS, rate * np.maximum(0.0, _time_s(12.5) - STEP_AT_S), hold_speed=True)


def lane_change(
    parameters: Any, *, accel_mps2: float, back: bool = False, friction_mu: float | None = None
) -> Manoeuvre:
    """Return one sine of the steering, 0.5 Hz, and on request after a second the same the other way.

    Args:
        parameters: The oracle's, for the wheelbase.
        accel_mps2: Lateral acceleration of a neutral car at the peak of the sine.
        back: Whether the car returns to its lane.
        friction_mu: As in `Manoeuvre`.
    """
    time = _time_s(9.0 if back else 5.0)
    sine = _one_sine(time - STEP_AT_S) - (_one_sine(time - STEP_AT_S - 3.0) if back else 0.0)
    return Manoeuvre(
        SPEED_MPS, accel_mps2 * (parameters.a + parameters.b) / SPEED_MPS**2 * sine, friction_mu=friction_mu
    )


def braking(*, decel_mps2: float) -> Manoeuvre:
    """Return a straight line on which the brakes are applied after half a second.

    Args:
        decel_mps2: What the pedal asks for; wheels that lock are beyond the oracle, whose solver then fails.
    """
    time = _time_s(6.0)
    return Manoeuvre(25.0, np.zeros(len(time)), accel_mps2=np.where(time >= STEP_AT_S, -decel_mps2, 0.0))


def _time_s(duration_s: float) -> FloatArray:
    return SAMPLE_S * np.arange(round(duration_s / SAMPLE_S) + 1, dtype=np.float64)


def _one_sine(time_s: FloatArray) -> FloatArray:
    wave: FloatArray = np.where((time_s > 0.0) & (time_s < 2.0), np.sin(np.pi * time_s), 0.0)
    return wave


@dataclass(frozen=True, slots=True)
class Pair:
    """One manoeuvre driven twice.

    Attributes:
        ours: Our car.
        theirs: The oracle.
    """

    ours: Course
    theirs: Course


def drive_both(manoeuvre: Manoeuvre, car: OracleCar, variant: Variant, *, vehicle: Vehicle | None = None) -> Pair:
    """Return what both make of a manoeuvre.

    Args:
        manoeuvre: Hands and feet.
        car: Whose parameters.
        variant: How much of the oracle takes part.
        vehicle: Our car, to save the fit of its tyre.
    """
    if vehicle is None:
        vehicle = comparable_car(oracle_parameters(car))
    if manoeuvre.hold_speed:
        vehicle = vehicle._replace(front_drive_frac=0.5)
    parameters = oracle_parameters(car, variant, friction_mu=manoeuvre.friction_mu, even_drive=manoeuvre.hold_speed)
    ours = manoeuvre
    if manoeuvre.accel_mps2 is not None:
        # Our friction is the peak on either axis, theirs differs between the axes: the one in use counts.
        ours = replace(manoeuvre, friction_mu=parameters.tire.p_dx1)
    return Pair(drive_ours(ours, vehicle), drive_oracle(manoeuvre, parameters))


def over_ratio(ours: float, theirs: float) -> float:
    """Return how much ours is larger, over theirs."""
    return ours / theirs - 1.0


def step_figures(course: Course) -> dict[str, float]:
    """Return what one reads from a step response: steady values, peak, overshoot and rise time.

    Args:
        course: Of `step_steer`.
    """
    yaw = course.yaw_rate_radps
    steady = float(yaw[-50:].mean())
    peak = float(yaw.max())
    # Times count from half the steering angle, as ISO 7401 does; straight lines between samples.
    started_s = float(np.interp(0.5 * course.steer_rad[-1], course.steer_rad, course.time_s))
    until = int(np.argmax(yaw)) + 1
    rise_s = float(np.interp(0.9 * steady, yaw[:until], course.time_s[:until])) - started_s
    return {
        "steady_yaw_rate_radps": steady,
        "peak_yaw_rate_radps": peak,
        "overshoot_ratio": peak / steady - 1.0,
        "rise_time_s": rise_s,
        "steady_accel_y_mps2": float(course.accel_y_mps2[-50:].mean()),
        "steady_roll_rad": float(course.roll_rad[-50:].mean()),
    }


def circle_figures(course: Course) -> dict[str, float]:
    """Return the steering angle at some lateral accelerations, and the largest that was reached.

    Args:
        course: Of `widening_circle`.
    """
    figures = {
        f"steer_at_{accel:.0f}_mps2_rad": float(course.steer_rad[np.argmax(course.accel_y_mps2 > accel)])
        for accel in CIRCLE_ACCELS_MPS2
    }
    return figures | {"largest_accel_y_mps2": float(course.accel_y_mps2.max())}


def lane_change_figures(pair: Pair) -> dict[str, float]:
    """Return the differences over a lane change: peaks, the whole curve, and its delay.

    Args:
        pair: Of `lane_change`.
    """
    ours, theirs = pair.ours, pair.theirs
    peak = float(np.abs(theirs.yaw_rate_radps).max())
    return {
        "peak_yaw_rate_over_ratio": over_ratio(float(np.abs(ours.yaw_rate_radps).max()), peak),
        "peak_accel_y_over_ratio": over_ratio(
            float(np.abs(ours.accel_y_mps2).max()), float(np.abs(theirs.accel_y_mps2).max())
        ),
        "yaw_rate_rms_over_peak_ratio": float(
            np.sqrt(np.mean((ours.yaw_rate_radps - theirs.yaw_rate_radps) ** 2)) / peak
        ),
        "yaw_rate_lag_s": lag_s(ours.yaw_rate_radps, theirs.yaw_rate_radps),
        "roll_over_ratio": over_ratio(float(np.abs(ours.roll_rad).max()), float(np.abs(theirs.roll_rad).max())),
    }


def braking_figures(pair: Pair) -> dict[str, float]:
    """Return the distances from the pedal to 5 m/s.

    Args:
        pair: Of `braking`.
    """
    distance = []
    for course in (pair.ours, pair.theirs):
        start, end = round(STEP_AT_S / SAMPLE_S), int(np.argmax(course.velocity_x_mps < 5.0))
        distance.append(float(course.velocity_x_mps[start:end].sum() * SAMPLE_S))
    return {
        "distance_ours_m": distance[0],
        "distance_theirs_m": distance[1],
        "over_ratio": over_ratio(distance[0], distance[1]),
    }


def lag_s(later: FloatArray, earlier: FloatArray) -> float:
    """Return by how much one curve comes after another one of the same shape: least squares to a millisecond.

    Args:
        later: Positive if this one lags. (n,)
        earlier: (n,)
    """
    grid = np.arange(len(earlier), dtype=np.float64)
    shifts = np.arange(-0.06, 0.0601, 0.001)
    misfit = [float(((later - np.interp(grid - s / SAMPLE_S, grid, earlier)) ** 2).sum()) for s in shifts]
    return float(shifts[int(np.argmin(misfit))])


def all_figures(car: OracleCar, variant: Variant) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every manoeuvre's name and its figures, for one car of the oracle.

    Args:
        car: Whose parameters.
        variant: How much of the oracle takes part.
    """
    parameters = oracle_parameters(car)
    vehicle = comparable_car(parameters)

    def both(manoeuvre: Manoeuvre) -> Pair:
        return drive_both(manoeuvre, car, variant, vehicle=vehicle)

    for accel in STEP_ACCELS_MPS2:
        yield f"step_{accel:.0f}_mps2", compared(both(step_steer(parameters, accel_mps2=accel)), step_figures)
    low = step_steer(parameters, accel_mps2=2.0, friction_mu=LOW_MU)
    yield "step_2_mps2_at_low_mu", compared(both(low), step_figures)
    yield "circle", compared(both(widening_circle(parameters)), circle_figures)
    yield "lane_change", lane_change_figures(both(lane_change(parameters, accel_mps2=5.0)))
    yield "double_lane_change", lane_change_figures(both(lane_change(parameters, accel_mps2=5.0, back=True)))
    low = lane_change(parameters, accel_mps2=2.5, back=True, friction_mu=LOW_MU)
    yield "double_lane_change_at_low_mu", lane_change_figures(both(low))
    for decel in (4.0, 7.0):
        yield f"braking_{decel:.0f}_mps2", braking_figures(both(braking(decel_mps2=decel)))


def compared(pair: Pair, figures_of: Any) -> dict[str, dict[str, float]]:
    """Return figures of both, and by how much ours are larger.

    Args:
        pair: One manoeuvre driven twice.
        figures_of: Turns a course into figures.
    """
    ours, theirs = figures_of(pair.ours), figures_of(pair.theirs)
    over = {k: over_ratio(ours[k], theirs[k]) for k in ours if k not in {"overshoot_ratio", "rise_time_s"}}
    return {"ours": ours, "theirs": theirs, "over_ratio": over}

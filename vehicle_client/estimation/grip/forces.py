"""What a motion asks of the tyres: lateral and longitudinal force of either axle, and its wheels' loads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vehicle_client.estimation.grip.axle import WheelCurve, wheel_curve

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.grip.motion import Motion
    from vehicle_client.estimation.handling import Handling, TyreCurve
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

_LOAD_MIN_FRAC = 0.02
"""Share of its load that an axle keeps, and of its axle's that a wheel does: nothing hangs in the air."""


@dataclass(frozen=True, slots=True)
class AxleForces:
    """Forces of both axles along and across their wheels. Arrays (n,).

    The lateral ones are those whose slip shows now: force follows slip over the relaxation length, so slip runs ahead.
    """

    front_side_n: FloatArray
    front_side_now_n: FloatArray
    front_along_n: FloatArray
    front_wheels: tuple[WheelCurve, WheelCurve]
    rear_side_n: FloatArray
    rear_along_n: FloatArray
    rear_wheels: tuple[WheelCurve, WheelCurve]


def axle_forces(motion: Motion, *, handling: Handling, geometry: VehicleGeometry) -> AxleForces:
    """Return the forces that the motion asks of both axles, and the curves of their wheels under their loads.

    Args:
        motion: Of the car over the section.
        handling: Of the own car.
        geometry: Of the own car.
    """
    mass, wheelbase, tyre = handling.mass_kg, geometry.wheelbase_m, handling.tyre
    ahead, behind = geometry.front_axle_m / wheelbase, geometry.rear_axle_m / wheelbase
    pitch_n = mass * handling.cog_height_m * motion.force_x_mps2 / wheelbase
    front_load = _at_least(_LOAD_MIN_FRAC, mass * motion.normal_mps2 * behind, shifted_n=-pitch_n)
    rear_load = _at_least(_LOAD_MIN_FRAC, mass * motion.normal_mps2 * ahead, shifted_n=pitch_n)
    side_n = mass * motion.force_y_mps2 / geometry.track_m
    front_wheels = _wheels(front_load, side_n * handling.front_transfer_height_m, tyre)
    rear_wheels = _wheels(rear_load, side_n * handling.rear_transfer_height_m, tyre)

    sin_steer, cos_steer = np.sin(motion.steer_rad), np.cos(motion.steer_rad)
    # Wheels that are steered hold the car back with a part of their lateral force.
    held_n = mass * behind * motion.force_y_mps2 * sin_steer
    pushed_n = mass * motion.force_x_mps2 + handling.drag_kgpm * motion.speed_mps**2 + held_n
    turned_n = pushed_n + tyre.rolling_resistance_ratio * (front_load + rear_load)
    engine_n = -mass * handling.engine_brake_mps2
    front_turned_n = np.where(
        turned_n > engine_n,
        handling.front_drive_frac * turned_n,
        handling.front_drive_frac * engine_n + handling.front_brake_frac * (turned_n - engine_n),
    )
    front_along = front_turned_n - tyre.rolling_resistance_ratio * front_load
    rear_along = turned_n - front_turned_n - tyre.rolling_resistance_ratio * rear_load

    stiffer = front_wheels[1].stiffness_n - front_wheels[0].stiffness_n
    stiffer = stiffer / (front_wheels[1].stiffness_n + front_wheels[0].stiffness_n)

    def sides(force_y_mps2: FloatArray) -> tuple[FloatArray, FloatArray]:
        front_across = mass * behind * force_y_mps2 + handling.yaw_inertia_kgm2 * motion.yaw_accel_radps2 / wheelbase
        # Of two steered wheels the outer one bears more: their forces' parts against the motion turn the car out.
        front_across = front_across * (1.0 + 0.5 * geometry.track_m / wheelbase * stiffer * sin_steer)
        return (front_across - front_along * sin_steer) / cos_steer, mass * force_y_mps2 - front_across

    front_now, _ = sides(motion.force_y_mps2)
    front_side, rear_side = sides(motion.force_y_mps2 + tyre.relaxation_m / motion.speed_mps * motion.force_y_rate_mps3)
    return AxleForces(
        front_side_n=front_side,
        front_side_now_n=front_now,
        front_along_n=front_along,
        front_wheels=front_wheels,
        rear_side_n=rear_side,
        rear_along_n=rear_along,
        rear_wheels=rear_wheels,
    )


def _wheels(axle_load_n: FloatArray, shift_n: FloatArray, tyre: TyreCurve) -> tuple[WheelCurve, WheelCurve]:
    """Return the curves of the left and the right wheel; in a left turn load shifts to the right."""
    half = 0.5 * axle_load_n
    left = _at_least(2.0 * _LOAD_MIN_FRAC, half, shifted_n=-shift_n)
    right = _at_least(2.0 * _LOAD_MIN_FRAC, half, shifted_n=shift_n)
    return wheel_curve(left, tyre), wheel_curve(right, tyre)


def _at_least(frac: float, load_n: FloatArray, *, shifted_n: FloatArray) -> FloatArray:
    return np.maximum(load_n + shifted_n, frac * load_n)

"""The car without a driver on an endless plane: steering, pedals and friction over time in, motion out.

For what an engineer tries on a proving ground: steady circles, step steer, lane changes with a machine at the wheel,
braking in a straight line. It is the very car of the drives, one time step after another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import SAMPLE_S
from vehicle_client.simulator import chassis, journey, stability
from vehicle_client.simulator.driver import understeer_gradient_s2pm
from vehicle_client.simulator.plan import NO_SYSTEMS, StabilitySystems
from vehicle_client.simulator.vehicle import XC90, Vehicle

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray

_HOLD_NMS = 2_000.0


@dataclass(frozen=True, slots=True)
class Plane:
    """An endless surface that tilts with the car's heading, so that a bank stays across it.

    Attributes:
        friction_mu: Under the left wheels and, unless said, the right ones.
        right_friction_mu: Under the right wheels; that of the left ones if None.
        cross_slope_ratio: Rise of the surface towards the left of the car.
        grade_ratio: Rise towards the front of the car.
    """

    friction_mu: float
    right_friction_mu: float | None = None
    cross_slope_ratio: float = 0.0
    grade_ratio: float = 0.0


@dataclass(frozen=True, slots=True)
class Motion:
    """What the car did, every 10 ms; ISO 8855 axes. All arrays (n,) unless said.

    Attributes:
        time_s: From 0.
        velocity_x_mps: At the centre of gravity, forward.
        velocity_y_mps: Left.
        yaw_rate_radps: Left turn positive.
        roll_rad: Of the body against the surface, left side up positive.
        accel_x_mps2: Acceleration of the centre of gravity in the plane, forward.
        accel_y_mps2: Left.
        steer_rad: Mean angle of the front wheels that was asked for.
        wheel_speed_radps: Columns as in `vehicle_client.estimation.trace.WHEELS`. (n, 4)
        wheel_load_n: (n, 4)
        wheel_force_x_n: In the wheel's axes. (n, 4)
        wheel_force_y_n: (n, 4)
        abs_active: Where anti-lock braking releases a wheel.
        tcs_active: Where traction control cuts torque.
        esc_active: Where yaw control brakes a wheel or cuts torque.
    """

    time_s: FloatArray
    velocity_x_mps: FloatArray
    velocity_y_mps: FloatArray
    yaw_rate_radps: FloatArray
    roll_rad: FloatArray
    accel_x_mps2: FloatArray
    accel_y_mps2: FloatArray
    steer_rad: FloatArray
    wheel_speed_radps: FloatArray
    wheel_load_n: FloatArray
    wheel_force_x_n: FloatArray
    wheel_force_y_n: FloatArray
    abs_active: BoolArray
    tcs_active: BoolArray
    esc_active: BoolArray


def drive_open_loop(
    plane: Plane,
    *,
    speed_mps: float,
    steer_rad: FloatArray,
    accel_mps2: FloatArray | None = None,
    hold_speed: bool = False,
    systems: StabilitySystems = NO_SYSTEMS,
    vehicle: Vehicle = XC90,
    step_s: float = journey.STEP_S,
) -> Motion:
    """Return the motion that steering and pedals give.

    Args:
        plane: The surface.
        speed_mps: At the start, rolling freely and straight on.
        steer_rad: Mean angle of the front wheels every 10 ms; straight lines between. (n,)
        accel_mps2: What the pedals ask for at those times, air and grade allowed for, with the lag of pedals and
            torque left out; rolling freely if None. (n,)
        hold_speed: Whether a machine holds the speed by torque at all four wheels, whatever the grip; excludes
            `accel_mps2`.
        systems: Which stability systems work.
        vehicle: The car.
        step_s: Time step; a whole fraction of 10 ms.

    Raises:
        ValueError: Both pedals and a held speed are asked for.
    """
    if hold_speed and accel_mps2 is not None:
        raise ValueError("either the pedals or the machine that holds the speed")
    body = np.zeros(chassis.BODY_SIZE)
    wheels = np.zeros((4, chassis.WHEEL_SIZE))
    road = np.zeros(5)
    aids = np.zeros(stability.AIDS_SIZE)
    stability.switch_on(aids)
    road[chassis.GRADE], road[chassis.CROSS_SLOPE] = plane.grade_ratio, plane.cross_slope_ratio
    right_mu = plane.friction_mu if plane.right_friction_mu is None else plane.right_friction_mu
    wheels[:, chassis.FRICTION] = [plane.friction_mu, right_mu, plane.friction_mu, right_mu]
    wheels[:, chassis.SPIN] = speed_mps / vehicle.tyre.rolling_radius_m
    body[chassis.VELOCITY_X] = speed_mps
    gradient = understeer_gradient_s2pm(vehicle)
    abs_on, tcs_on, esc_on = (float(on) for on in systems)
    substeps = round(SAMPLE_S / step_s)
    states = np.empty((len(steer_rad), chassis.BODY_SIZE))
    corners = np.empty((len(steer_rad), 4, chassis.WHEEL_SIZE))
    active = np.empty((len(steer_rad), 3), dtype=np.bool_)
    for k in range(len(steer_rad)):
        wheels[:, [chassis.DRIVE_NM, chassis.BRAKE_NM]] = 0.0
        if accel_mps2 is not None:
            journey.set_torques(wheels, body, road, float(accel_mps2[k]), vehicle)
        stability.intervene(aids, body, wheels, gradient, abs_on, tcs_on, esc_on, vehicle, SAMPLE_S)
        active[k] = aids[stability.ABS_ACTIVE : stability.ESC_ACTIVE + 1] > 0.0
        states[k], corners[k] = body, wheels
        following = steer_rad[min(k + 1, len(steer_rad) - 1)]
        for j in range(substeps):
            body[chassis.STEER] = steer_rad[k] + (following - steer_rad[k]) * j / substeps
            if hold_speed:
                wheels[:, chassis.DRIVE_NM] = _HOLD_NMS * (speed_mps - body[chassis.VELOCITY_X])
            body[chassis.ANGLE] = 0.0  # the plane turns with the car
            chassis.advance(body, wheels, road, vehicle, step_s)
    return Motion(
        time_s=SAMPLE_S * np.arange(len(steer_rad), dtype=np.float64),
        velocity_x_mps=states[:, chassis.VELOCITY_X],
        velocity_y_mps=states[:, chassis.VELOCITY_Y],
        yaw_rate_radps=states[:, chassis.YAW_RATE],
        roll_rad=states[:, chassis.ROLL],
        accel_x_mps2=states[:, chassis.ACCEL_X],
        accel_y_mps2=states[:, chassis.ACCEL_Y],
        steer_rad=np.array(steer_rad, dtype=np.float64),
        wheel_speed_radps=corners[:, :, chassis.SPIN],
        wheel_load_n=corners[:, :, chassis.LOAD],
        wheel_force_x_n=corners[:, :, chassis.WHEEL_FORCE_X],
        wheel_force_y_n=corners[:, :, chassis.WHEEL_FORCE_Y],
        abs_active=active[:, 0],
        tcs_active=active[:, 1],
        esc_active=active[:, 2],
    )

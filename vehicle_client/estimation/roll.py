"""The roll of the body, and the lateral acceleration that remains when gravity is taken out of the accelerometer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.estimation.filters import integral, rate_of_change, slow_part

if TYPE_CHECKING:
    from roadgrip.units import FloatArray


def chassis_roll_rad(
    accel_y_mps2: FloatArray,
    yaw_rate_radps: FloatArray,
    speed_mps: FloatArray,
    roll_rate_radps: FloatArray,
    bank_rad: FloatArray,
    *,
    climb_rad: FloatArray,
    gripping_velocity_y_mps: FloatArray,
    crossover_hz: float,
) -> FloatArray:
    """Return the roll of the body against the road, left side up positive. (n,)

    Complementary filter, forward and backward. Slowly changing roll comes from the accelerometer: what it reads
    beyond the acceleration of a gripping car is gravity. Quickly changing roll comes from the integrated roll rate, of
    which yawing on a grade is no part: uphill the nose points up, and a turn about the vertical turns about the car's
    long axis too. Both see body and road together, so the bank of the map is taken off. `road_accel_y_mps2` adds it
    again: the map decides how much of the tilt is called roll, not how much gravity is taken out.

    The slow part takes a constant accelerometer offset for roll, and so takes it out. It takes a sliding that changes
    more slowly than the crossover for roll as well, and takes that out too.

    Args:
        accel_y_mps2: Specific force to the left. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        speed_mps: Forward. (n,)
        roll_rate_radps: Left side up positive. (n,)
        bank_rad: Cross slope of the road as an angle, left edge up positive, from the map. (n,)
        climb_rad: Grade of the road as an angle, uphill positive, from the map. (n,)
        gripping_velocity_y_mps: Lateral velocity to be expected, whose change is no gravity. (n,)
        crossover_hz: Where slow and fast roll meet.

    References:
        Our reconstruction; Langstrand and Rabi, section "Observer for longitudinal and lateral speeds", only say
        that a complementary filter on the IMU gives the chassis roll and the map the bank. Rates of angles from the
        turning of the body: d(roll)/dt = p - r tan(climb) for small roll (Titterton and Weston, Strapdown inertial
        navigation technology, section 3.6).
    """
    accel_y = yaw_rate_radps * speed_mps + rate_of_change(gripping_velocity_y_mps)
    tilt = np.arcsin(np.clip((accel_y_mps2 - accel_y) / GRAVITY_MPS2, -1.0, 1.0))
    turned = integral(roll_rate_radps - yaw_rate_radps * np.tan(climb_rad))
    return turned + slow_part(tilt - turned, crossover_hz=crossover_hz) - bank_rad


def reckoned_roll_rate_radps(
    accel_y_mps2: FloatArray,
    yaw_rate_radps: FloatArray,
    bank_rad: FloatArray,
    *,
    climb_rad: FloatArray,
    roll_gradient_s2pm: float,
) -> FloatArray:
    """Return what a roll gyro would read, in a car that has none. (n,)

    The body leans outwards in proportion to the lateral force, the road turns under it as the map says, and yawing on a
    grade turns about the car's long axis too. What a bump or a slow lean of the load does is not in it.

    Args:
        accel_y_mps2: Specific force to the left, smoothed. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        bank_rad: Cross slope of the road as an angle, left edge up positive, from the map. (n,)
        climb_rad: Grade of the road as an angle, uphill positive, from the map. (n,)
        roll_gradient_s2pm: Roll per lateral acceleration.
    """
    return rate_of_change(roll_gradient_s2pm * accel_y_mps2 + bank_rad) + yaw_rate_radps * np.tan(climb_rad)


def road_accel_y_mps2(accel_y_mps2: FloatArray, *, chassis_roll_rad: FloatArray, bank_rad: FloatArray) -> FloatArray:
    """Return the lateral acceleration of the vehicle in the road's plane, gravity taken out. (n,)

    Args:
        accel_y_mps2: Specific force to the left, in the body's axes. (n,)
        chassis_roll_rad: Body against road, left side up positive. (n,)
        bank_rad: Road against horizon, left edge up positive. (n,)
    """
    tilt = chassis_roll_rad + bank_rad
    return (accel_y_mps2 - GRAVITY_MPS2 * np.sin(tilt)) / np.cos(tilt)

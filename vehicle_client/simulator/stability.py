"""ABS, traction control and electronic stability control, as simple as they can be and still do their job.

They see what production units see: wheel speeds, yaw rate, lateral acceleration, steering angle, and a sideslip that a
real unit estimates. They never know the friction.

References:
    van Zanten, Bosch ESP systems: 5 years of experience, SAE 2000-01-1633 (reference yaw rate, single-wheel braking:
    outer front against oversteer, inner rear against understeer).
"""

# ruff: noqa: PLR0917 - the compiler knows no keyword-only arguments

from __future__ import annotations

import math

from roadgrip.units import FloatArray
from vehicle_client.simulator.chassis import (
    BRAKE_NM,
    DRIVE_NM,
    FORCE_Y,
    SLIP_X,
    STEER,
    VELOCITY_X,
    VELOCITY_Y,
    YAW_RATE,
)
from vehicle_client.simulator.compilation import kernel
from vehicle_client.simulator.vehicle import Vehicle

# State of the unit: one array. The first four are the shares of brake pressure that ABS leaves.
TRACTION_SHARE, REFERENCE_YAW, ABS_ACTIVE, TCS_ACTIVE, ESC_ACTIVE = 4, 5, 6, 7, 8
AIDS_SIZE = 9

_SLOWEST_MPS = 4.0
_YAW_DEAD_BAND_RADPS = 0.06
_SIDESLIP_DEAD_BAND_RAD = 0.07
_YAW_GAIN_NMS = 6_000.0
_SIDESLIP_GAIN_NM = 8_000.0
_TORQUE_LIMIT_NM = 1_500.0
_REFERENCE_LAG_S = 0.08
_MARGIN_MPS2 = 1.0
_BRAKE_SLIP = 0.08
_DRIVE_SLIP = 0.06


@kernel
def switch_on(aids: FloatArray) -> None:
    """Write the state of a unit that has nothing to do.

    Args:
        aids: Is overwritten.
    """
    aids[:] = 0.0
    aids[: TRACTION_SHARE + 1] = 1.0


@kernel
def intervene(
    aids: FloatArray,
    body: FloatArray,
    wheels: FloatArray,
    gradient_s2pm: float,
    abs_on: float,
    tcs_on: float,
    esc_on: float,
    vehicle: Vehicle,
    sample_s: float,
) -> None:
    """Change the torques that the driver asked for, where the car does not do what he steers.

    Args:
        aids: State of the unit.
        body: State of the body.
        wheels: State of the wheels; drive and brake torques are changed.
        gradient_s2pm: Understeer gradient of the car.
        abs_on: Not zero with anti-lock braking.
        tcs_on: Not zero with traction control.
        esc_on: Not zero with yaw control.
        vehicle: The car.
        sample_s: Time since the last call.
    """
    vx = body[VELOCITY_X]
    aids[ABS_ACTIVE : ESC_ACTIVE + 1] = 0.0
    if vx > _SLOWEST_MPS and esc_on > 0.0:
        _control_yaw(aids, body, wheels, gradient_s2pm, vehicle, sample_s)
    else:
        aids[REFERENCE_YAW] = body[YAW_RATE]

    spinning = False
    for i in range(4):
        slip = wheels[i, SLIP_X]
        # Pressure is dropped three times as fast as it comes back.
        if abs_on > 0.0 and vx > 1.5 and slip < -_BRAKE_SLIP and wheels[i, BRAKE_NM] > 0.0:
            aids[i] = max(0.05, aids[i] - 12.0 * sample_s)
        else:
            aids[i] = min(1.0, aids[i] + 4.0 * sample_s)
        if aids[i] < 1.0 and wheels[i, BRAKE_NM] > 0.0:
            wheels[i, BRAKE_NM] *= aids[i]
            aids[ABS_ACTIVE] = 1.0
        spinning = spinning or (tcs_on > 0.0 and slip > _DRIVE_SLIP and wheels[i, DRIVE_NM] > 0.0)
    if spinning:
        aids[TRACTION_SHARE] = max(0.0, aids[TRACTION_SHARE] - 10.0 * sample_s)
    else:
        aids[TRACTION_SHARE] = min(1.0, aids[TRACTION_SHARE] + 2.0 * sample_s)
    if aids[TRACTION_SHARE] < 1.0:
        for i in range(4):
            if wheels[i, DRIVE_NM] > 0.0:
                wheels[i, DRIVE_NM] *= aids[TRACTION_SHARE]
                aids[TCS_ACTIVE] = 1.0


@kernel
def _control_yaw(
    aids: FloatArray, body: FloatArray, wheels: FloatArray, gradient_s2pm: float, vehicle: Vehicle, sample_s: float
) -> None:
    vx, yaw = body[VELOCITY_X], body[YAW_RATE]
    wheelbase = vehicle.front_axle_m + vehicle.rear_axle_m
    asked = vx * body[STEER] / (wheelbase + max(0.0, gradient_s2pm) * vx * vx)
    aids[REFERENCE_YAW] += (asked - aids[REFERENCE_YAW]) * sample_s / _REFERENCE_LAG_S
    reference = aids[REFERENCE_YAW]
    # More yaw than the present lateral acceleration carries cannot be wanted: beyond it the car would spin.
    carried = (abs(body[FORCE_Y]) + _MARGIN_MPS2) / vx
    wanted = min(max(reference, -carried), carried)
    side = 1.0 if yaw > 0.0 else -1.0
    excess = side * (yaw - wanted) - _YAW_DEAD_BAND_RADPS
    sideslip = -side * math.atan2(body[VELOCITY_Y], vx) - _SIDESLIP_DEAD_BAND_RAD
    lack = abs(reference) - side * yaw - _YAW_DEAD_BAND_RADPS if reference * side > 0.0 else 0.0

    torque = 0.0
    wheel = 0
    if excess > 0.0 or sideslip > 0.0:
        torque = _YAW_GAIN_NMS * max(0.0, excess) + _SIDESLIP_GAIN_NM * max(0.0, sideslip)
        wheel = 1 if side > 0.0 else 0
    elif lack > 0.0:
        torque = 0.5 * _YAW_GAIN_NMS * lack
        wheel = 2 if side > 0.0 else 3
    if torque > 0.0:
        aids[ESC_ACTIVE] = 1.0
        wheels[wheel, BRAKE_NM] += min(torque, _TORQUE_LIMIT_NM)
        for i in range(4):
            wheels[i, DRIVE_NM] = min(0.0, wheels[i, DRIVE_NM])

"""The car without a driver on an endless plane: steering, pedals and friction over time in, motion out.

For what an engineer tries on a proving ground: steady circles, step steer, lane changes with a machine at the wheel,
braking in a straight line. It is the very car of the drives, one time step after another.
"""

# ruff: noqa: PLR0917 - the compiler knows no keyword-only arguments

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import SAMPLE_S
from vehicle_client.simulator import journey
from vehicle_client.simulator.chassis import advance, set_hubs, set_loads
from vehicle_client.simulator.compilation import cached_kernel, code_digest, kernel
from vehicle_client.simulator.driver import press_pedals
from vehicle_client.simulator.journey import report
from vehicle_client.simulator.lanes import (
    ANGLE,
    ASKED_BRAKE_NM,
    ASKED_DRIVE_NM,
    CROSS_SLOPE,
    CURVATURE,
    DRIVE_NM,
    FRICTION,
    GRADE,
    HELD_STEER,
    LANES,
    OFFSET,
    REPORT,
    REPORT_COUNT,
    SPIN,
    STATE_SIZE,
    STEER,
    VELOCITY_X,
    WHEELS,
    YAW_RATE,
)
from vehicle_client.simulator.plan import NO_SYSTEMS, UNIMPRESSED, StabilitySystems
from vehicle_client.simulator.seats import place_car
from vehicle_client.simulator.stability import control_yaw, limit_braking, limit_drive, see_braking, select_low
from vehicle_client.simulator.vehicle import XC90, Vehicle

if TYPE_CHECKING:
    from collections.abc import Callable

    from roadgrip.units import BoolArray, FloatArray

_HOLD_NMS = 2_000.0
_SLOWEST_MPS = 1.0


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
    state = np.zeros(STATE_SIZE)
    for lane in range(LANES):
        # All lanes hold the same car; the first is looked at.
        place_car(state, lane, vehicle=vehicle, driver=UNIMPRESSED, stability=systems)
    rows = state.reshape(-1, 4, LANES)
    rows[GRADE // WHEELS], rows[CROSS_SLOPE // WHEELS] = plane.grade_ratio, plane.cross_slope_ratio
    right_mu = plane.friction_mu if plane.right_friction_mu is None else plane.right_friction_mu
    rows[FRICTION // WHEELS] = np.array([plane.friction_mu, right_mu] * 2)[:, None]
    rows[SPIN // WHEELS] = speed_mps / vehicle.tyre.rolling_radius_m
    rows[VELOCITY_X // WHEELS] = speed_mps
    asked = np.ascontiguousarray(steer_rad, dtype=np.float64)
    pedals = np.empty(0) if accel_mps2 is None else np.ascontiguousarray(accel_mps2, dtype=np.float64)
    log = np.empty((REPORT_COUNT, len(asked)))
    _drive_on_plane(state, asked, pedals, speed_mps if hold_speed else -1.0, log, step_s)
    return Motion(
        time_s=SAMPLE_S * np.arange(len(asked), dtype=np.float64),
        velocity_x_mps=log[journey.LOG_VELOCITY_X],
        velocity_y_mps=log[journey.LOG_VELOCITY_Y],
        yaw_rate_radps=log[journey.LOG_YAW_RATE],
        roll_rad=log[journey.LOG_ROLL],
        accel_x_mps2=log[journey.LOG_ACCEL_X],
        accel_y_mps2=log[journey.LOG_ACCEL_Y],
        steer_rad=asked.copy(),
        wheel_speed_radps=log[journey.LOG_WHEEL_SPEED : journey.LOG_WHEEL_SPEED + 4].T / vehicle.tyre.rolling_radius_m,
        wheel_load_n=log[journey.LOG_LOAD : journey.LOG_LOAD + 4].T,
        wheel_force_x_n=log[journey.LOG_FORCE_X : journey.LOG_FORCE_X + 4].T,
        wheel_force_y_n=log[journey.LOG_FORCE_Y : journey.LOG_FORCE_Y + 4].T,
        abs_active=log[journey.LOG_ABS] > 0.0,
        tcs_active=log[journey.LOG_TCS] > 0.0,
        esc_active=log[journey.LOG_ESC] > 0.0,
    )


@kernel
def _decide(state: FloatArray, accel_mps2: float, driven_share: float) -> None:
    for lane in range(LANES):
        press_pedals(state, lane, accel_mps2)
    for wheel in range(WHEELS):
        state[ASKED_DRIVE_NM + wheel] *= driven_share
        state[ASKED_BRAKE_NM + wheel] *= driven_share
    for lane in range(LANES):
        control_yaw(state, lane, SAMPLE_S)
        see_braking(state, lane)
        report(state, lane)


@kernel
def _act(state: FloatArray, steer_rad: float, hold_mps: float) -> None:
    for lane in range(LANES):
        state[STEER + lane] = state[HELD_STEER + lane] = steer_rad
        # The plane turns with the car: where it is banked it is a cone, which bends as the car's path does.
        state[ANGLE + lane] = state[OFFSET + lane] = 0.0
        state[CURVATURE + lane] = state[YAW_RATE + lane] / max(_SLOWEST_MPS, state[VELOCITY_X + lane])
        limit_drive(state, lane)
    for wheel in range(WHEELS):
        limit_braking(state, wheel)
    for lane in range(LANES):
        select_low(state, lane)
    for wheel in range(WHEELS):
        if hold_mps >= 0.0:
            state[DRIVE_NM + wheel] = _HOLD_NMS * (hold_mps - state[VELOCITY_X + wheel % LANES])


@kernel
def _drive_open_loop(
    state: FloatArray, steer_rad: FloatArray, accel_mps2: FloatArray, hold_mps: float, log: FloatArray, step_s: float
) -> None:
    steps_count = int(SAMPLE_S / step_s + 0.5)
    for lane in range(LANES):
        set_loads(state, lane)
        set_hubs(state, lane, 0.0)
    for k in range(len(steer_rad)):
        if len(accel_mps2) > 0:
            _decide(state, accel_mps2[k], 1.0)
        else:
            _decide(state, 0.0, 0.0)  # no foot on any pedal, and no engine brake
        for column in range(REPORT_COUNT):
            log[column, k] = state[REPORT + column * WHEELS]
        following = steer_rad[min(k + 1, len(steer_rad) - 1)]
        for j in range(steps_count):
            _act(state, steer_rad[k] + (following - steer_rad[k]) * (j + 0.5) / steps_count, hold_mps)
            advance(state, step_s)


def _compiled(digest: int) -> Callable[..., None]:
    @cached_kernel
    def drive(
        state: FloatArray,
        steer_rad: FloatArray,
        accel_mps2: FloatArray,
        hold_mps: float,
        log: FloatArray,
        step_s: float,
    ) -> None:
        """Drive as steering and pedals, or a held speed, say."""
        if digest != 0:
            _drive_open_loop(state, steer_rad, accel_mps2, hold_mps, log, step_s)

    compiled: Callable[..., None] = drive
    return compiled


_drive_on_plane = _compiled(code_digest(_drive_open_loop))

"""The body on its four wheels: one step in time of the double-track model, for all lanes.

States are velocities in the road plane, yaw rate, chassis roll and the four wheel spins; pitch is quasi-static and
acts as load transfer. The vehicle moves along the road's own coordinates (station, offset from the centre line, angle
against it), so that no error of position adds up. Gravity on bank and grade acts as the component in the road plane;
crests, dips and banked curves change the wheel loads. Roughness shakes a quarter car at each corner, whose tyre
deflection adds to the load; body motions from it are superposed where sensors look, not fed back. The front wheels
give way to their lateral force, as steering gear and suspension let them.

References:
    Rill, Road Vehicle Dynamics, chapter 9-10 (full vehicle model); Mitschke and Wallentowitz, Dynamik der
    Kraftfahrzeuge, part III (load transfer over roll centres, steady cornering, elastic steering).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.simulator.compilation import formula, kernel
from vehicle_client.simulator.lanes import (
    ACCEL_X,
    ACCEL_Y,
    ACROSS,
    ALONG,
    ANGLE,
    BRAKE_NM,
    BRISTLE_X,
    BRISTLE_Y,
    COSINE,
    CROSS_CHANGE,
    CROSS_CHANGE_STEP,
    CROSS_SLOPE,
    CROSS_SLOPE_STEP,
    CURVATURE,
    CURVATURE_STEP,
    DRIFT_X,
    DRIFT_Y,
    DRIFT_YAW,
    DRIVE_NM,
    FORCE_X,
    FORCE_Y,
    FRICTION,
    FRICTION_STEP,
    GRADE,
    GRADE_CHANGE,
    GRADE_CHANGE_STEP,
    GRADE_STEP,
    HELD_STEER,
    LAGGED_X,
    LANES,
    LEVER_X,
    LEVER_Y,
    LOAD,
    OFFSET,
    PACE,
    ROAD_Z,
    ROLL,
    ROLL_RATE,
    SINE,
    SLIDE,
    SLIP_X,
    SPIN,
    SPIN_DRIFT,
    SPRUNG_V,
    SPRUNG_Z,
    STATION,
    UNSPRUNG_V,
    UNSPRUNG_Z,
    VELOCITY_X,
    VELOCITY_Y,
    WHEEL_FORCE_X,
    WHEEL_FORCE_Y,
    WHEELS,
    YAW_RATE,
    YIELDED,
    tyre_at,
    vehicle_at,
)
from vehicle_client.simulator.tyre import SPEED_FLOOR_MPS, built_up_force_n, slip_slope

if TYPE_CHECKING:
    from roadgrip.units import FloatArray


@kernel
def advance(state: FloatArray, step_s: float) -> None:
    """Advance bodies and wheels of all lanes by one step, and the road under them.

    Args:
        state: Of all lanes, with steering angles, drive and brake torques and the height of the road set.
        step_s: Time step, 1 to 2 ms.
    """
    for lane in range(LANES):
        give_way(state, lane, step_s)
        set_loads(state, lane)
        set_hubs(state, lane, step_s)
    for wheel in range(WHEELS):
        shake(state, wheel, step_s)
        roll_wheel(state, wheel, step_s)
        state[FRICTION + wheel] += state[FRICTION_STEP + wheel]
    for lane in range(LANES):
        move(state, lane, step_s)
        state[CURVATURE + lane] += state[CURVATURE_STEP + lane]
        state[GRADE + lane] += state[GRADE_STEP + lane]
        state[CROSS_SLOPE + lane] += state[CROSS_SLOPE_STEP + lane]
        state[GRADE_CHANGE + lane] += state[GRADE_CHANGE_STEP + lane]
        state[CROSS_CHANGE + lane] += state[CROSS_CHANGE_STEP + lane]


@formula
def sine(angle_rad: float) -> float:
    """Return the sine of an angle below 0.8; the error stays below 4e-7, and below 1e-12 for angles below 0.1."""
    q = angle_rad * angle_rad
    return angle_rad * (1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0)))


@formula
def cosine(angle_rad: float) -> float:
    """Return the cosine of an angle below 0.8; the error stays below 3e-8."""
    q = angle_rad * angle_rad
    return 1.0 - q / 2.0 * (1.0 - q / 12.0 * (1.0 - q / 30.0 * (1.0 - q / 56.0)))


@formula
def give_way(state: FloatArray, lane: int, step_s: float) -> None:
    """Advance the angle by which the front wheels give way to their lateral force.

    Args:
        state: Of all lanes.
        lane: Which one.
        step_s: Time step.
    """
    vehicle = vehicle_at(state, lane)
    force = state[WHEEL_FORCE_Y + lane] + state[WHEEL_FORCE_Y + LANES + lane]
    far = vehicle.steer_compliance_radpn * force
    state[YIELDED + lane] += (far - state[YIELDED + lane]) * step_s / vehicle.steer_compliance_lag_s


@formula
def set_loads(state: FloatArray, lane: int) -> None:
    """Write the four wheel loads for the present roll, accelerations and road; roughness comes on top in `shake`.

    Args:
        state: Of all lanes.
        lane: Which one.
    """
    vehicle = vehicle_at(state, lane)
    v = state[VELOCITY_X + lane]
    grade, cross = state[GRADE + lane], state[CROSS_SLOPE + lane]
    # Gravity across the surface, and the surface's own curvature in the direction of travel.
    normal = GRAVITY_MPS2 / math.sqrt(1.0 + grade * grade + cross * cross)
    normal += v * v * (state[GRADE_CHANGE + lane] - state[CURVATURE + lane] * cross)
    m, wheelbase = vehicle.mass_kg, vehicle.front_axle_m + vehicle.rear_axle_m
    pitch = m * vehicle.cog_height_m * state[LAGGED_X + lane] / wheelbase
    front = m * normal * vehicle.rear_axle_m / wheelbase - pitch
    rear = m * normal * vehicle.front_axle_m / wheelbase + pitch
    roll_nm = (
        vehicle.roll_stiffness_nmprad * state[ROLL + lane] + vehicle.roll_damping_nmsprad * state[ROLL_RATE + lane]
    )
    side = m * state[FORCE_Y + lane] / wheelbase
    share = vehicle.front_roll_stiffness_frac
    shift_front = (share * roll_nm + side * vehicle.rear_axle_m * vehicle.front_roll_centre_m) / vehicle.front_track_m
    shift_rear = ((1.0 - share) * roll_nm + side * vehicle.front_axle_m * vehicle.rear_roll_centre_m) / (
        vehicle.rear_track_m
    )
    state[LOAD + lane] = 0.5 * front - shift_front
    state[LOAD + LANES + lane] = 0.5 * front + shift_front
    state[LOAD + 2 * LANES + lane] = 0.5 * rear - shift_rear
    state[LOAD + 3 * LANES + lane] = 0.5 * rear + shift_rear


@formula
def set_hubs(state: FloatArray, lane: int, step_s: float) -> None:
    """Write the angle of each wheel and the velocity of its hub in the wheel's axes, in the middle of a time step.

    The velocities there follow from how they changed over the step before.

    Args:
        state: Of all lanes.
        lane: Which one.
        step_s: Time step.
    """
    half_s = 0.5 * step_s
    vx = state[VELOCITY_X + lane] + half_s * state[DRIFT_X + lane]
    vy = state[VELOCITY_Y + lane] + half_s * state[DRIFT_Y + lane]
    yaw = state[YAW_RATE + lane] + half_s * state[DRIFT_YAW + lane]
    # Ackermann: the front wheels' axes meet on the rear axle's.
    steer = state[HELD_STEER + lane] - state[YIELDED + lane]
    per_wheelbase = sine(steer) / cosine(steer)
    _set_hub(state, lane, lane, vx, vy, yaw, per_wheelbase)
    _set_hub(state, lane, LANES + lane, vx, vy, yaw, per_wheelbase)
    _set_hub(state, lane, 2 * LANES + lane, vx, vy, yaw, 0.0)
    _set_hub(state, lane, 3 * LANES + lane, vx, vy, yaw, 0.0)


@formula
def _set_hub(  # noqa: PLR0917 - the compiler knows no keyword-only arguments
    state: FloatArray, lane: int, wheel: int, vx: float, vy: float, yaw: float, per_wheelbase: float
) -> None:
    vehicle = vehicle_at(state, lane)
    x, y = state[LEVER_X + wheel], state[LEVER_Y + wheel]
    hub_x, hub_y = vx - yaw * y, vy + yaw * x
    turn = per_wheelbase / (1.0 - per_wheelbase * y / (vehicle.front_axle_m + vehicle.rear_axle_m))
    along = 1.0 / math.sqrt(1.0 + turn * turn)
    across = turn * along
    state[COSINE + wheel], state[SINE + wheel] = along, across
    state[SPIN_DRIFT + wheel] = state[DRIFT_X + lane] / vehicle.tyre.rolling_radius_m
    state[ALONG + wheel] = hub_x * along + hub_y * across
    state[ACROSS + wheel] = hub_y * along - hub_x * across


@formula
def shake(state: FloatArray, wheel: int, step_s: float) -> None:
    """Advance the quarter car of a corner by one step over the roughness, and add what it does to the wheel load.

    Args:
        state: Of all lanes.
        wheel: Which one, of all lanes' wheels.
        step_s: Time step.
    """
    vehicle = vehicle_at(state, wheel)
    corner_kg = 0.25 * vehicle.mass_kg - vehicle.unsprung_mass_kg
    unsprung, unsprung_v = state[UNSPRUNG_Z + wheel], state[UNSPRUNG_V + wheel]
    sprung, sprung_v = state[SPRUNG_Z + wheel], state[SPRUNG_V + wheel]
    tyre = vehicle.tyre.vertical_stiffness_npm * (state[ROAD_Z + wheel] - unsprung)
    spring = vehicle.wheel_rate_npm * (unsprung - sprung) + vehicle.damper_nspm * (unsprung_v - sprung_v)
    unsprung_v += step_s * (tyre - spring) / vehicle.unsprung_mass_kg
    sprung_v += step_s * spring / corner_kg
    state[UNSPRUNG_V + wheel], state[SPRUNG_V + wheel] = unsprung_v, sprung_v
    state[UNSPRUNG_Z + wheel] = unsprung + step_s * unsprung_v
    state[SPRUNG_Z + wheel] = sprung + step_s * sprung_v
    state[LOAD + wheel] = max(0.0, state[LOAD + wheel] + tyre)


@formula
def roll_wheel(state: FloatArray, wheel: int, step_s: float) -> None:
    """Advance spin and tyre forces of one wheel.

    The spin is solved together with the longitudinal force; brake and rolling resistance stop a wheel but never turn
    it back.

    Args:
        state: Of all lanes.
        wheel: Which one, of all lanes' wheels.
        step_s: Time step.
    """
    vehicle, tyre = vehicle_at(state, wheel), tyre_at(state, wheel)
    along_mps, across_mps = state[ALONG + wheel], state[ACROSS + wheel]
    radius = tyre.rolling_radius_m
    spin = state[SPIN + wheel]
    mid_spin = spin + 0.5 * step_s * state[SPIN_DRIFT + wheel]
    rolling = abs(mid_spin) * radius + SPEED_FLOOR_MPS
    slip_x, slip_y = (mid_spin * radius - along_mps) / rolling, -across_mps / rolling
    load = state[LOAD + wheel]
    slope, hx, hy, over_peak = slip_slope(slip_x, slip_y, load, state[FRICTION + wheel], tyre)

    old = state[BRISTLE_X + wheel]
    _, force, loss = built_up_force_n(
        old, along_mps - spin * radius, rolling, slope, hx, tyre.stiffness_x_npm, tyre.damping_x_nspm, step_s
    )
    # I dw/dt = T - R (F - loss R dw / 2): the force falls as the spin changes until the middle of the step.
    gain = step_s / vehicle.wheel_inertia_kgm2
    total = 1.0 + 0.5 * gain * loss * radius * radius
    free = spin + gain * (state[DRIVE_NM + wheel] - radius * force) / total
    hold = gain * (state[BRAKE_NM + wheel] + tyre.rolling_resistance_ratio * load * radius) / total
    turned = math.copysign(max(0.0, abs(free) - hold), free)
    state[SPIN + wheel] = turned
    moved, force, _ = built_up_force_n(
        old,
        along_mps - 0.5 * (spin + turned) * radius,
        rolling,
        slope,
        hx,
        tyre.stiffness_x_npm,
        tyre.damping_x_nspm,
        step_s,
    )
    state[BRISTLE_X + wheel] = moved
    state[WHEEL_FORCE_X + wheel] = force
    moved, force, _ = built_up_force_n(
        state[BRISTLE_Y + wheel], across_mps, rolling, slope, hy, tyre.stiffness_y_npm, tyre.damping_y_nspm, step_s
    )
    state[BRISTLE_Y + wheel] = moved
    state[WHEEL_FORCE_Y + wheel] = force
    state[SLIP_X + wheel] = slip_x
    state[SLIDE + wheel] = over_peak


@formula
def _axle_force(state: FloatArray, left: int) -> tuple[float, float, float]:
    right = left + LANES
    left_x = state[WHEEL_FORCE_X + left] * state[COSINE + left] - state[WHEEL_FORCE_Y + left] * state[SINE + left]
    left_y = state[WHEEL_FORCE_X + left] * state[SINE + left] + state[WHEEL_FORCE_Y + left] * state[COSINE + left]
    right_x = state[WHEEL_FORCE_X + right] * state[COSINE + right] - state[WHEEL_FORCE_Y + right] * state[SINE + right]
    right_y = state[WHEEL_FORCE_X + right] * state[SINE + right] + state[WHEEL_FORCE_Y + right] * state[COSINE + right]
    # Left and right first: the sum of a mirrored car is the mirrored sum to the last bit.
    force_y = left_y + right_y
    return left_x + right_x, force_y, state[LEVER_X + left] * force_y - state[LEVER_Y + left] * (left_x - right_x)


@formula
def move(state: FloatArray, lane: int, step_s: float) -> None:
    """Advance the body by what tyres, air and gravity do to it, and its place on the road.

    Args:
        state: Of all lanes.
        lane: Which one.
        step_s: Time step.
    """
    vehicle = vehicle_at(state, lane)
    m = vehicle.mass_kg
    vx, vy, yaw = state[VELOCITY_X + lane], state[VELOCITY_Y + lane], state[YAW_RATE + lane]
    front_x, front_y, front_nm = _axle_force(state, lane)
    rear_x, rear_y, rear_nm = _axle_force(state, 2 * LANES + lane)
    sum_x, sum_y, moment = front_x + rear_x, front_y + rear_y, front_nm + rear_nm

    # Specific force and gravity in the road plane, in the vehicle's axes.
    angle = state[ANGLE + lane]
    cos_angle, sin_angle = cosine(angle), sine(angle)
    grade, cross = state[GRADE + lane], state[CROSS_SLOPE + lane]
    fall = GRAVITY_MPS2 / math.sqrt(1.0 + grade * grade + cross * cross)
    force_x = (sum_x - vehicle.drag_npm2ps2_ratio * vx * abs(vx)) / m
    force_y = sum_y / m
    accel_x = force_x - fall * (grade * cos_angle + cross * sin_angle)
    accel_y = force_y - fall * (cross * cos_angle - grade * sin_angle)

    # The axes turn under the velocity: turn it back exactly, so that turning costs and gains no energy.
    turn = yaw * step_s
    cos_turn, sin_turn = cosine(turn), sine(turn)
    new_vx = vx * cos_turn + vy * sin_turn + accel_x * step_s
    new_vy = vy * cos_turn - vx * sin_turn + accel_y * step_s
    new_yaw = yaw + moment / vehicle.yaw_inertia_kgm2 * step_s
    state[DRIFT_X + lane], state[DRIFT_Y + lane] = (new_vx - vx) / step_s, (new_vy - vy) / step_s
    state[DRIFT_YAW + lane] = (new_yaw - yaw) / step_s
    state[VELOCITY_X + lane], state[VELOCITY_Y + lane], state[YAW_RATE + lane] = new_vx, new_vy, new_yaw
    state[FORCE_X + lane], state[FORCE_Y + lane] = force_x, force_y
    state[ACCEL_X + lane], state[ACCEL_Y + lane] = accel_x, accel_y
    state[LAGGED_X + lane] += (force_x - state[LAGGED_X + lane]) * step_s / vehicle.load_transfer_lag_s

    roll, roll_rate = state[ROLL + lane], state[ROLL_RATE + lane]
    arm = vehicle.cog_height_m - (
        vehicle.front_roll_centre_m * vehicle.rear_axle_m + vehicle.rear_roll_centre_m * vehicle.front_axle_m
    ) / (vehicle.front_axle_m + vehicle.rear_axle_m)
    roll_nm = m * arm * (force_y + fall * roll) - vehicle.roll_stiffness_nmprad * roll
    roll_rate += (roll_nm - vehicle.roll_damping_nmsprad * roll_rate) / vehicle.roll_inertia_kgm2 * step_s
    state[ROLL_RATE + lane] = roll_rate
    state[ROLL + lane] = roll + roll_rate * step_s

    # Along the road.
    curvature = state[CURVATURE + lane] / math.sqrt(1.0 + cross * cross)
    mean_vx, mean_vy, mean_yaw = 0.5 * (vx + new_vx), 0.5 * (vy + new_vy), 0.5 * (yaw + new_yaw)
    pace = (mean_vx * cos_angle - mean_vy * sin_angle) / (1.0 - curvature * state[OFFSET + lane])
    state[PACE + lane] = pace
    state[STATION + lane] += pace * step_s
    state[OFFSET + lane] += (mean_vx * sin_angle + mean_vy * cos_angle) * step_s
    state[ANGLE + lane] = angle + (mean_yaw - curvature * pace) * step_s

"""The body on its four wheels: one step in time of the double-track model.

States are velocities in the road plane, yaw rate, chassis roll and the four wheel spins; pitch is quasi-static and
acts as load transfer. The vehicle moves along the road's own coordinates (station, offset from the centre line, angle
against it), so that no error of position adds up. Gravity on bank and grade acts as the component in the road plane;
crests, dips and banked curves change the wheel loads. Roughness shakes a quarter car at each corner, whose tyre
deflection adds to the load; body motions from it are superposed where sensors look, not fed back.

References:
    Rill, Road Vehicle Dynamics, chapter 9-10 (full vehicle model); Mitschke and Wallentowitz, Dynamik der
    Kraftfahrzeuge, part III (load transfer over roll centres, steady cornering).
"""

# ruff: noqa: PLR0917 - the compiler knows no keyword-only arguments

from __future__ import annotations

import math

from roadgrip.units import GRAVITY_MPS2, FloatArray
from vehicle_client.simulator.compilation import kernel
from vehicle_client.simulator.tyre import SPEED_FLOOR_MPS, built_up_force_n, slip_slope
from vehicle_client.simulator.vehicle import Vehicle

# Body state: one array.
VELOCITY_X, VELOCITY_Y, YAW_RATE, ROLL, ROLL_RATE = 0, 1, 2, 3, 4
STATION, OFFSET, ANGLE = 5, 6, 7
FORCE_X, FORCE_Y = 8, 9  # specific, of tyres and air; the accelerometer's share in the road plane
LAGGED_X = 10  # specific force as the springs have answered it
ACCEL_X, ACCEL_Y = 11, 12
STEER = 13
BODY_SIZE = 14

# Wheel state: one row per wheel, in the order of `vehicle_client.estimation.trace.WHEELS`.
SPIN, BRISTLE_X, BRISTLE_Y, LOAD, WHEEL_FORCE_X, WHEEL_FORCE_Y, SLIP_X, SLIDE = 0, 1, 2, 3, 4, 5, 6, 7
DRIVE_NM, BRAKE_NM, FRICTION, ROAD_Z = 8, 9, 10, 11
SPRUNG_Z, SPRUNG_V, UNSPRUNG_Z, UNSPRUNG_V = 12, 13, 14, 15
WHEEL_SIZE = 16

# Road under the vehicle: one array.
CURVATURE, GRADE, CROSS_SLOPE, GRADE_CHANGE, CROSS_CHANGE = 0, 1, 2, 3, 4


@kernel
def _sine(angle_rad: float) -> float:
    # Seven terms of the library's are more than an angle below 0.8 needs: the error stays below 4e-7.
    q = angle_rad * angle_rad
    return angle_rad * (1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0)))


@kernel
def _cosine(angle_rad: float) -> float:
    q = angle_rad * angle_rad
    return 1.0 - q / 2.0 * (1.0 - q / 12.0 * (1.0 - q / 30.0 * (1.0 - q / 56.0)))


@kernel
def set_loads(body: FloatArray, wheels: FloatArray, road: FloatArray, vehicle: Vehicle) -> None:
    """Write the four wheel loads for the present roll, accelerations, road and roughness.

    Args:
        body: State of the body.
        wheels: State of the wheels; column LOAD is written.
        road: Road under the vehicle.
        vehicle: The car.
    """
    v = body[VELOCITY_X]
    grade, cross = road[GRADE], road[CROSS_SLOPE]
    # Gravity across the surface, and the surface's own curvature in the direction of travel.
    normal = GRAVITY_MPS2 / math.sqrt(1.0 + grade * grade + cross * cross)
    normal += v * v * (road[GRADE_CHANGE] - road[CURVATURE] * cross)
    m, wheelbase = vehicle.mass_kg, vehicle.front_axle_m + vehicle.rear_axle_m
    pitch = m * vehicle.cog_height_m * body[LAGGED_X] / wheelbase
    front = m * normal * vehicle.rear_axle_m / wheelbase - pitch
    rear = m * normal * vehicle.front_axle_m / wheelbase + pitch
    roll_nm = vehicle.roll_stiffness_nmprad * body[ROLL] + vehicle.roll_damping_nmsprad * body[ROLL_RATE]
    side = m * body[FORCE_Y] / wheelbase
    share = vehicle.front_roll_stiffness_frac
    shift_front = (share * roll_nm + side * vehicle.rear_axle_m * vehicle.front_roll_centre_m) / vehicle.front_track_m
    shift_rear = ((1.0 - share) * roll_nm + side * vehicle.front_axle_m * vehicle.rear_roll_centre_m) / (
        vehicle.rear_track_m
    )
    wheels[0, LOAD] = 0.5 * front - shift_front
    wheels[1, LOAD] = 0.5 * front + shift_front
    wheels[2, LOAD] = 0.5 * rear - shift_rear
    wheels[3, LOAD] = 0.5 * rear + shift_rear
    for i in range(4):
        shaken = vehicle.tyre.vertical_stiffness_npm * (wheels[i, ROAD_Z] - wheels[i, UNSPRUNG_Z])
        wheels[i, LOAD] = max(0.0, wheels[i, LOAD] + shaken)


@kernel
def shake(wheels: FloatArray, vehicle: Vehicle, step_s: float) -> None:
    """Advance the quarter car of each corner by one step over the roughness.

    Args:
        wheels: State of the wheels; the sprung and unsprung columns are advanced.
        vehicle: The car.
        step_s: Time step.
    """
    corner_kg = 0.25 * vehicle.mass_kg - vehicle.unsprung_mass_kg
    for i in range(4):
        spring = vehicle.wheel_rate_npm * (wheels[i, UNSPRUNG_Z] - wheels[i, SPRUNG_Z]) + vehicle.damper_nspm * (
            wheels[i, UNSPRUNG_V] - wheels[i, SPRUNG_V]
        )
        tyre = vehicle.tyre.vertical_stiffness_npm * (wheels[i, ROAD_Z] - wheels[i, UNSPRUNG_Z])
        wheels[i, UNSPRUNG_V] += step_s * (tyre - spring) / vehicle.unsprung_mass_kg
        wheels[i, SPRUNG_V] += step_s * spring / corner_kg
        wheels[i, UNSPRUNG_Z] += step_s * wheels[i, UNSPRUNG_V]
        wheels[i, SPRUNG_Z] += step_s * wheels[i, SPRUNG_V]


@kernel
def roll_wheel(
    wheels: FloatArray, i: int, along_mps: float, across_mps: float, vehicle: Vehicle, step_s: float
) -> None:
    """Advance spin and tyre forces of one wheel.

    The spin is solved together with the longitudinal force; brake and rolling resistance stop a wheel but never turn
    it back.

    Args:
        wheels: State of the wheels; row i is advanced.
        i: Index of the wheel.
        along_mps: Velocity of the hub in the wheel's plane.
        across_mps: Velocity of the hub across it, left positive.
        vehicle: The car.
        step_s: Time step.
    """
    tyre = vehicle.tyre
    radius = tyre.rolling_radius_m
    spin = wheels[i, SPIN]
    rolling = abs(spin) * radius + SPEED_FLOOR_MPS
    slide_x = along_mps - spin * radius
    slip_x, slip_y = -slide_x / rolling, -across_mps / rolling
    load = wheels[i, LOAD]
    slope, hx, hy, over_peak = slip_slope(slip_x, slip_y, load, wheels[i, FRICTION], tyre)

    old = wheels[i, BRISTLE_X]
    _, force, loss = built_up_force_n(
        old, slide_x, rolling, slope, hx, tyre.stiffness_x_npm, tyre.damping_x_nspm, step_s
    )
    # I dw/dt = T - R (F - loss R dw): the force falls as the spin changes within the step.
    gain = step_s / vehicle.wheel_inertia_kgm2
    total = 1.0 + gain * loss * radius * radius
    free = spin + gain * (wheels[i, DRIVE_NM] - radius * force) / total
    hold = gain * (wheels[i, BRAKE_NM] + tyre.rolling_resistance_ratio * load * radius) / total
    turned = max(0.0, free - hold) if free > 0.0 else min(0.0, free + hold)
    wheels[i, SPIN] = turned
    moved, force, _ = built_up_force_n(
        old, along_mps - turned * radius, rolling, slope, hx, tyre.stiffness_x_npm, tyre.damping_x_nspm, step_s
    )
    wheels[i, BRISTLE_X] = moved
    wheels[i, WHEEL_FORCE_X] = force
    moved, force, _ = built_up_force_n(
        wheels[i, BRISTLE_Y], across_mps, rolling, slope, hy, tyre.stiffness_y_npm, tyre.damping_y_nspm, step_s
    )
    wheels[i, BRISTLE_Y] = moved
    wheels[i, WHEEL_FORCE_Y] = force
    wheels[i, SLIP_X] = slip_x
    wheels[i, SLIDE] = over_peak


@kernel
def advance(body: FloatArray, wheels: FloatArray, road: FloatArray, vehicle: Vehicle, step_s: float) -> None:
    """Advance body and wheels by one step.

    Args:
        body: State of the body, steering angle included.
        wheels: State of the wheels with drive and brake torques, friction and road height set.
        road: Road under the vehicle.
        vehicle: The car.
        step_s: Time step, 1 to 2 ms.
    """
    m = vehicle.mass_kg
    a, b = vehicle.front_axle_m, vehicle.rear_axle_m
    half_front, half_rear = 0.5 * vehicle.front_track_m, 0.5 * vehicle.rear_track_m
    vx, vy, yaw = body[VELOCITY_X], body[VELOCITY_Y], body[YAW_RATE]
    set_loads(body, wheels, road, vehicle)
    shake(wheels, vehicle, step_s)

    # Ackermann: the front wheels' axes meet on the rear axle's.
    tangent = _sine(body[STEER]) / _cosine(body[STEER])
    wheelbase = a + b
    sum_x = sum_y = moment = 0.0
    for i in range(4):
        front = i < 2
        x = a if front else -b
        y = half_front if front else half_rear
        if i % 2 == 1:
            y = -y
        hub_x, hub_y = vx - yaw * y, vy + yaw * x
        cosine, sine = 1.0, 0.0
        if front:
            turn = tangent / (1.0 - tangent * y / wheelbase)
            cosine = 1.0 / math.sqrt(1.0 + turn * turn)
            sine = turn * cosine
        roll_wheel(wheels, i, hub_x * cosine + hub_y * sine, hub_y * cosine - hub_x * sine, vehicle, step_s)
        force_x = wheels[i, WHEEL_FORCE_X] * cosine - wheels[i, WHEEL_FORCE_Y] * sine
        force_y = wheels[i, WHEEL_FORCE_X] * sine + wheels[i, WHEEL_FORCE_Y] * cosine
        sum_x += force_x
        sum_y += force_y
        moment += x * force_y - y * force_x

    # Specific force and gravity in the road plane, in the vehicle's axes.
    angle = body[ANGLE]
    cos_angle, sin_angle = _cosine(angle), _sine(angle)
    grade, cross = road[GRADE], road[CROSS_SLOPE]
    fall = GRAVITY_MPS2 / math.sqrt(1.0 + grade * grade + cross * cross)
    force_x = (sum_x - vehicle.drag_npm2ps2_ratio * vx * abs(vx)) / m
    force_y = sum_y / m
    accel_x = force_x - fall * (grade * cos_angle + cross * sin_angle)
    accel_y = force_y - fall * (cross * cos_angle - grade * sin_angle)

    # The axes turn under the velocity: turn it back exactly, so that turning costs and gains no energy.
    turn = yaw * step_s
    cosine, sine = _cosine(turn), _sine(turn)
    body[VELOCITY_X] = vx * cosine + vy * sine + accel_x * step_s
    body[VELOCITY_Y] = vy * cosine - vx * sine + accel_y * step_s
    body[YAW_RATE] = yaw + moment / vehicle.yaw_inertia_kgm2 * step_s
    body[FORCE_X], body[FORCE_Y] = force_x, force_y
    body[ACCEL_X], body[ACCEL_Y] = accel_x, accel_y
    body[LAGGED_X] += (force_x - body[LAGGED_X]) * step_s / (vehicle.load_transfer_lag_s + step_s)

    arm = vehicle.cog_height_m - (vehicle.front_roll_centre_m * b + vehicle.rear_roll_centre_m * a) / wheelbase
    roll_nm = (
        m * arm * (force_y + fall * body[ROLL])
        - vehicle.roll_stiffness_nmprad * body[ROLL]
        - vehicle.roll_damping_nmsprad * body[ROLL_RATE]
    )
    body[ROLL_RATE] += roll_nm / vehicle.roll_inertia_kgm2 * step_s
    body[ROLL] += body[ROLL_RATE] * step_s

    # Along the road.
    vx, vy = body[VELOCITY_X], body[VELOCITY_Y]
    curvature = road[CURVATURE] / math.sqrt(1.0 + cross * cross)
    pace = (vx * cos_angle - vy * sin_angle) / (1.0 - curvature * body[OFFSET])
    body[STATION] += pace * step_s
    body[OFFSET] += (vx * sin_angle + vy * cos_angle) * step_s
    body[ANGLE] += (body[YAW_RATE] - curvature * pace) * step_s

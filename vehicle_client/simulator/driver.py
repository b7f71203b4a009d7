"""A skilled driver: reads the curve ahead, chooses a speed, steers, and lowers both when he feels the tyres slide.

He uses what a person has: the line of the road as far as he sees it, his speed, the car's motion, the forces on his
body, and the steering wheel, which goes light when the front tyres slide. Friction reaches him only through these.

References:
    Speed: he keeps the lateral acceleration below a share of the guessed grip, the usual criterion of curve speed
    models (Reymond et al., Role of lateral acceleration in curve driving, Human Factors 43, 2001). Steering:
    feed-forward of the curvature and feedback of the path error at a preview point (Donges, A two-level model of
    driver steering behavior, Human Factors 20, 1978).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.simulator.compilation import formula, kernel
from vehicle_client.simulator.lanes import (
    ACCEL_WISH,
    AHEAD_CROSS_SLOPE,
    AHEAD_CURVATURE,
    ALLOWED_MPS,
    ANGLE,
    ASKED_BRAKE_NM,
    ASKED_DRIVE_NM,
    BRAKE_FROM_M,
    BRAKE_MPS2,
    BRAKE_UNTIL_MPS,
    CURVATURE,
    FELT_FORCE,
    FELT_SLIDE,
    FORCE_X,
    FORCE_Y,
    FRICTION,
    GRADE,
    GRADIENT,
    GUESS_MU,
    HELD_STEER,
    LANES,
    NEEDED_MPS2,
    OFFSET,
    ORDERED,
    PEDALS_MPS2,
    SLIDE,
    SPIN,
    STATION,
    STEER,
    STEER_WISH,
    TARGET_MPS,
    VELOCITY_X,
    VELOCITY_Y,
    YAW_RATE,
    YIELDED,
    driver_at,
    ramp_ratio,
    vehicle_at,
)

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.simulator.vehicle import Vehicle

SURE_MU = 1.2
"""The guess of a driver who does not judge by looks, before he feels anything."""
_FEELING_S = 0.12
_DOUBT_S = 0.25
_CLEAR_SLIDE = 0.1
_NO_FURTHER_SLIDE = 3.0
_PEDAL_S = 0.25
_OVERDRIVE = 1.5
_CLUTCH_MPS = 3.0
_WALK_MPS = 2.0


@kernel
def understeer_gradient_s2pm(vehicle: Vehicle) -> float:
    """Return the additional steering per lateral acceleration of the linear car, rad per m/s2.

    Args:
        vehicle: The car.

    References:
        Mitschke and Wallentowitz: (m / L) (b / Cf - a / Cr) with the axles' cornering stiffnesses, and the compliance
        of the steering times the lateral force of the front axle.
    """
    wheelbase = vehicle.front_axle_m + vehicle.rear_axle_m
    front = 0.5 * vehicle.mass_kg * GRAVITY_MPS2 * vehicle.rear_axle_m / wheelbase
    rear = 0.5 * vehicle.mass_kg * GRAVITY_MPS2 * vehicle.front_axle_m / wheelbase
    tyres = (1.0 / _slope_ratio(front, vehicle) - 1.0 / _slope_ratio(rear, vehicle)) / GRAVITY_MPS2
    return tyres + vehicle.steer_compliance_radpn * 2.0 * front / GRAVITY_MPS2


@kernel
def _slope_ratio(load_n: float, vehicle: Vehicle) -> float:
    tyre = vehicle.tyre
    return tyre.slope_y1_ratio + (tyre.slope_y2_ratio - tyre.slope_y1_ratio) * (load_n / tyre.nominal_load_n - 1.0)


@formula
def willing_mps2(guess_mu: float, grip_share_ratio: float, comfort_accel_mps2: float) -> float:
    """Return the lateral acceleration that a driver is willing to bear, by his guess of the surface."""
    return min(comfort_accel_mps2, grip_share_ratio * guess_mu * GRAVITY_MPS2)


@formula
def planned_braking_mps2(guess_mu: float, braking_mps2: float) -> float:
    """Return the deceleration that a driver plans with, by his guess of the surface."""
    return min(braking_mps2, max(0.5, 0.4 * guess_mu * GRAVITY_MPS2))


@formula
def feel(state: FloatArray, lane: int, sample_s: float) -> None:
    """Update what the driver feels, and lower his guess of the surface while the tyres slide.

    Args:
        state: Of all lanes.
        lane: Which one.
        sample_s: Time since the last call.
    """
    driver = driver_at(state, lane)
    front = state[SLIDE + lane] + state[SLIDE + LANES + lane]
    rear = state[SLIDE + 2 * LANES + lane] + state[SLIDE + 3 * LANES + lane]
    slide = min(0.5 * max(front, rear), _NO_FURTHER_SLIDE)
    force = math.sqrt(state[FORCE_X + lane] ** 2 + state[FORCE_Y + lane] ** 2)
    state[FELT_SLIDE + lane] += (slide - state[FELT_SLIDE + lane]) * sample_s / _FEELING_S
    state[FELT_FORCE + lane] += (force - state[FELT_FORCE + lane]) * sample_s / _FEELING_S
    sliding = _sliding_ratio(state[FELT_SLIDE + lane], driver.slide_feeling_ratio)
    shown = max(0.05, state[FELT_FORCE + lane] / GRAVITY_MPS2)
    state[GUESS_MU + lane] -= sliding * max(0.0, state[GUESS_MU + lane] - shown) * sample_s / _DOUBT_S


@formula
def _sliding_ratio(felt: float, threshold: float) -> float:
    # How sure he is that the tyres slide.
    return ramp_ratio(felt, threshold, threshold + _CLEAR_SLIDE)


@formula
def choose_pedals(state: FloatArray, lane: int, sample_s: float) -> None:
    """Update the acceleration that the driver's feet ask for.

    Args:
        state: Of all lanes.
        lane: Which one.
        sample_s: Time since the last call.
    """
    driver, vehicle = driver_at(state, lane), vehicle_at(state, lane)
    speed, guess = state[VELOCITY_X + lane], state[GUESS_MU + lane]
    until = state[BRAKE_UNTIL_MPS + lane]
    due = 1.0 if state[STATION + lane] >= state[BRAKE_FROM_M + lane] else 0.0
    # An order is fulfilled once its end speed is reached, which is the one to go on with.
    target = state[TARGET_MPS + lane]
    target = until if due > 0.0 and speed <= until else target
    state[TARGET_MPS + lane] = target
    ordered = due if target != until else 0.0
    released = max(0.0, state[ORDERED + lane] - ordered)
    state[ORDERED + lane] = ordered

    wish = min(2.0, 0.8 * (min(target, state[ALLOWED_MPS + lane]) - speed))
    needed = state[NEEDED_MPS2 + lane]
    urgent = ramp_ratio(needed / planned_braking_mps2(guess, driver.braking_mps2), 0.5, 0.7)
    wish -= urgent * max(0.0, wish + needed)
    # In a curve the brakes get what cornering leaves, by his guess; while he feels the car slide, very little.
    grip = guess * GRAVITY_MPS2
    left = 1.0 - min(1.0, (state[FORCE_Y + lane] / grip) ** 2)
    cap = min(4.0, max(1.0, 0.7 * grip)) * max(0.15, math.sqrt(left))
    sliding = _sliding_ratio(state[FELT_SLIDE + lane], driver.slide_feeling_ratio)
    wish -= sliding * max(0.0, wish + 0.3)
    cap -= sliding * max(0.0, cap - max(0.5, 0.3 * grip))
    before = state[ACCEL_WISH + lane] * (1.0 - released)
    free = before + (max(-cap, wish) - before) * sample_s / _PEDAL_S
    chosen = ordered * -state[BRAKE_MPS2 + lane] + (1.0 - ordered) * free
    state[ACCEL_WISH + lane] = chosen
    state[PEDALS_MPS2 + lane] += (chosen - state[PEDALS_MPS2 + lane]) * sample_s / (vehicle.brake_lag_s + sample_s)


@formula
def press_pedals(state: FloatArray, lane: int, accel_mps2: float) -> None:
    """Write the drive and brake torques that give an acceleration, air and grade allowed for.

    Open differentials; a fixed share per axle. A released pedal brakes with the engine up to its limit, the brakes do
    the rest.

    Args:
        state: Of all lanes; drive and brake torques are written.
        lane: Which one.
        accel_mps2: What the pedals ask for.
    """
    vehicle = vehicle_at(state, lane)
    m, radius = vehicle.mass_kg, vehicle.tyre.rolling_radius_m
    speed = state[VELOCITY_X + lane]
    force = m * (accel_mps2 + GRAVITY_MPS2 * (state[GRADE + lane] + vehicle.tyre.rolling_resistance_ratio))
    force += vehicle.drag_npm2ps2_ratio * speed * speed
    # Near standstill the clutch opens.
    engine_brake = m * vehicle.engine_brake_mps2 * ramp_ratio(speed, 0.5, 1.5)
    # The engine's power goes into the wheels, however fast they spin.
    front_spin = 0.5 * (state[SPIN + lane] + state[SPIN + LANES + lane])
    rear_spin = 0.5 * (state[SPIN + 2 * LANES + lane] + state[SPIN + 3 * LANES + lane])
    turning = radius * (rear_spin + vehicle.front_drive_frac * (front_spin - rear_spin))
    drive = min(max(force, -engine_brake), vehicle.power_w / max(_CLUTCH_MPS, speed, turning))
    brake = min(max(0.0, drive - force), m * vehicle.brake_limit_mps2)
    drive_nm, brake_nm = 0.5 * drive * radius, 0.5 * brake * radius
    state[ASKED_DRIVE_NM + lane] = state[ASKED_DRIVE_NM + LANES + lane] = vehicle.front_drive_frac * drive_nm
    state[ASKED_DRIVE_NM + 2 * LANES + lane] = (1.0 - vehicle.front_drive_frac) * drive_nm
    state[ASKED_DRIVE_NM + 3 * LANES + lane] = (1.0 - vehicle.front_drive_frac) * drive_nm
    state[ASKED_BRAKE_NM + lane] = state[ASKED_BRAKE_NM + LANES + lane] = vehicle.front_brake_frac * brake_nm
    state[ASKED_BRAKE_NM + 2 * LANES + lane] = (1.0 - vehicle.front_brake_frac) * brake_nm
    state[ASKED_BRAKE_NM + 3 * LANES + lane] = (1.0 - vehicle.front_brake_frac) * brake_nm


@formula
def choose_steering(state: FloatArray, lane: int) -> None:
    """Update the steering angle that the driver's hands ask for.

    The friction under the front wheels sets only where the steering wheel goes light: he does not turn it further than
    one and a half times the slip of the peak.

    Args:
        state: Of all lanes.
        lane: Which one.
    """
    driver, vehicle = driver_at(state, lane), vehicle_at(state, lane)
    wheelbase = vehicle.front_axle_m + vehicle.rear_axle_m
    gradient = state[GRADIENT + lane]
    # At a walk his eyes tell hardly any drift from standing still.
    vx = max(_WALK_MPS, state[VELOCITY_X + lane])
    curvature, cross = state[AHEAD_CURVATURE + lane], state[AHEAD_CROSS_SLOPE + lane]
    wish = wheelbase * curvature + gradient * (vx * vx * curvature + GRAVITY_MPS2 * cross)

    aim_m = max(4.0, vx * driver.preview_s)
    drift = state[ANGLE + lane] + state[VELOCITY_Y + lane] / vx
    gain = 2.0 * (wheelbase + max(0.0, gradient) * vx * vx) / (aim_m * aim_m)
    wish -= gain * (state[OFFSET + lane] + aim_m * drift)
    wish -= driver.yaw_damping_s_ratio * (state[YAW_RATE + lane] - state[CURVATURE + lane] * vx)

    front_mu = 0.5 * (state[FRICTION + lane] + state[FRICTION + LANES + lane])
    light = _OVERDRIVE * front_mu * vehicle.tyre.peak_slip_y1_ratio / vehicle.tyre.peak_y1_ratio
    rolling = (state[VELOCITY_Y + lane] + vehicle.front_axle_m * state[YAW_RATE + lane]) / vx + state[YIELDED + lane]
    wish = min(max(wish, rolling - light), rolling + light)
    state[STEER_WISH + lane] = min(max(wish, -vehicle.steer_limit_rad), vehicle.steer_limit_rad)


@formula
def turn_wheel(state: FloatArray, lane: int, step_s: float) -> None:
    """Advance the steering angle towards what the hands ask for, as fast as arms and steering gear let them.

    Args:
        state: Of all lanes.
        lane: Which one.
        step_s: Time step.
    """
    limit = vehicle_at(state, lane).steer_rate_limit_radps
    before = state[STEER + lane]
    rate = (state[STEER_WISH + lane] - before) / (driver_at(state, lane).steer_lag_s + 0.5 * step_s)
    turn = min(max(rate, -limit), limit) * step_s
    state[HELD_STEER + lane] = before + 0.5 * turn
    state[STEER + lane] = before + turn

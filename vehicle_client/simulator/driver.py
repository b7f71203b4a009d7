"""A skilled driver: reads the curve ahead, chooses a speed, steers, and lowers both when he feels the tyres slide.

He uses what a person has: the line of the road as far as he sees it, his speed, the car's motion, the forces on his
body, and the steering wheel, which goes light when the front tyres slide. Friction reaches him only through these.

References:
    Speed: he keeps the lateral acceleration below a share of the guessed grip, the usual criterion of curve speed
    models (Reymond et al., Role of lateral acceleration in curve driving, Human Factors 43, 2001). Steering:
    feed-forward of the curvature and feedback of the path error at a preview point (Donges, A two-level model of
    driver steering behavior, Human Factors 20, 1978).
"""

# ruff: noqa: PLR0917 - the compiler knows no keyword-only arguments

from __future__ import annotations

import math

from roadgrip.units import GRAVITY_MPS2, FloatArray
from vehicle_client.simulator.chassis import (
    ANGLE,
    CROSS_SLOPE,
    CURVATURE,
    FORCE_X,
    FORCE_Y,
    OFFSET,
    SLIDE,
    STATION,
    VELOCITY_X,
    VELOCITY_Y,
    YAW_RATE,
)
from vehicle_client.simulator.compilation import kernel
from vehicle_client.simulator.plan import Driver
from vehicle_client.simulator.vehicle import Vehicle

# State of mind: one array.
GUESS_MU, FELT_SLIDE, FELT_FORCE, ACCEL_WISH, STEER_WISH = 0, 1, 2, 3, 4
MIND_SIZE = 5

_SCAN_M = 4.0
_FEELING_S = 0.12
_DOUBT_S = 0.25
_SURE_MU = 1.2
_SLOWEST_MPS = 3.0
_STRAIGHT_1PM = 1e-4
_PEDAL_S = 0.25
_OVERDRIVE = 1.5


@kernel
def understeer_gradient_s2pm(vehicle: Vehicle) -> float:
    """Return the additional steering per lateral acceleration of the linear car, rad per m/s2.

    Args:
        vehicle: The car.

    References:
        Mitschke and Wallentowitz: (m / L) (b / Cf - a / Cr) with the axles' cornering stiffnesses.
    """
    wheelbase = vehicle.front_axle_m + vehicle.rear_axle_m
    front = 0.5 * vehicle.mass_kg * GRAVITY_MPS2 * vehicle.rear_axle_m / wheelbase
    rear = 0.5 * vehicle.mass_kg * GRAVITY_MPS2 * vehicle.front_axle_m / wheelbase
    return (1.0 / _slope_ratio(front, vehicle) - 1.0 / _slope_ratio(rear, vehicle)) / GRAVITY_MPS2


@kernel
def _slope_ratio(load_n: float, vehicle: Vehicle) -> float:
    tyre = vehicle.tyre
    return tyre.slope_y1_ratio + (tyre.slope_y2_ratio - tyre.slope_y1_ratio) * (load_n / tyre.nominal_load_n - 1.0)


@kernel
def scan_ahead(
    lines: FloatArray,
    start_m: float,
    step_m: float,
    station_m: float,
    speed_mps: float,
    guess_mu: float,
    driver: Driver,
) -> tuple[float, float]:
    """Return the speed that the road ahead allows now, and the deceleration that it asks for.

    Args:
        lines: `track.Track.lines`.
        start_m: Station of its first row.
        step_m: Between its rows.
        station_m: Where the car is.
        speed_mps: How fast it goes.
        guess_mu: What the driver thinks of the surface.
        driver: The driver.

    Returns:
        Speed in m/s; deceleration in m/s2, zero where none is needed.
    """
    willing = min(driver.comfort_accel_mps2, driver.grip_share_ratio * guess_mu * GRAVITY_MPS2)
    braking = min(driver.braking_mps2, max(0.5, 0.4 * guess_mu * GRAVITY_MPS2))
    # Nearer than what he covers while his foot moves, there is nothing to plan.
    nearest = max(2.0, 0.7 * speed_mps)
    allowed = 1e4
    needed = 0.0
    distance = 0.0
    while distance < driver.sight_m:
        i = min(len(lines) - 1, int((station_m + distance - start_m) / step_m + 0.5))
        curvature = lines[i, CURVATURE]
        if abs(curvature) > _STRAIGHT_1PM:
            helping = -GRAVITY_MPS2 * lines[i, CROSS_SLOPE] * (1.0 if curvature > 0.0 else -1.0)
            safe = max(_SLOWEST_MPS**2, (willing + helping) / abs(curvature))
            allowed = min(allowed, safe + 2.0 * braking * distance)
            needed = max(needed, 0.5 * (speed_mps**2 - safe) / max(distance, nearest))
        distance += _SCAN_M
    return math.sqrt(allowed), needed


@kernel
def feel(mind: FloatArray, body: FloatArray, wheels: FloatArray, driver: Driver, sample_s: float) -> None:
    """Update what the driver feels, and lower his guess of the surface while the tyres slide.

    Args:
        mind: State of mind; guess and feelings are updated.
        body: State of the body.
        wheels: State of the wheels.
        driver: The driver.
        sample_s: Time since the last call.
    """
    slide = max(0.5 * (wheels[0, SLIDE] + wheels[1, SLIDE]), 0.5 * (wheels[2, SLIDE] + wheels[3, SLIDE]))
    force = math.sqrt(body[FORCE_X] ** 2 + body[FORCE_Y] ** 2)
    mind[FELT_SLIDE] += (slide - mind[FELT_SLIDE]) * sample_s / _FEELING_S
    mind[FELT_FORCE] += (force - mind[FELT_FORCE]) * sample_s / _FEELING_S
    if mind[FELT_SLIDE] > driver.slide_feeling_ratio:
        shown = max(0.05, mind[FELT_FORCE] / GRAVITY_MPS2)
        if shown < mind[GUESS_MU]:
            mind[GUESS_MU] += (shown - mind[GUESS_MU]) * sample_s / _DOUBT_S


@kernel
def choose_pedals(
    mind: FloatArray,
    body: FloatArray,
    lines: FloatArray,
    start_m: float,
    step_m: float,
    target_mps: float,
    driver: Driver,
    sample_s: float,
) -> None:
    """Update the acceleration that the driver's feet ask for.

    Args:
        mind: State of mind; the wish is updated.
        body: State of the body.
        lines: `track.Track.lines`.
        start_m: Station of its first row.
        step_m: Between its rows.
        target_mps: Speed he likes where nothing holds him back.
        driver: The driver.
        sample_s: Time since the last call.
    """
    speed = body[VELOCITY_X]
    guess = mind[GUESS_MU]
    allowed, needed = scan_ahead(lines, start_m, step_m, body[STATION], speed, guess, driver)
    wish = min(2.0, 0.8 * (min(target_mps, allowed) - speed))
    braking = min(driver.braking_mps2, max(0.5, 0.4 * guess * GRAVITY_MPS2))
    if needed > 0.6 * braking:
        wish = min(wish, -needed)
    # In a curve the brakes get what cornering leaves, by his guess; while he feels the car slide, very little.
    left = 1.0 - min(1.0, (body[FORCE_Y] / (guess * GRAVITY_MPS2)) ** 2)
    cap = min(4.0, max(1.0, 0.7 * guess * GRAVITY_MPS2)) * max(0.15, math.sqrt(left))
    if mind[FELT_SLIDE] > driver.slide_feeling_ratio:
        wish = min(wish, -0.3)
        cap = min(cap, max(0.5, 0.3 * guess * GRAVITY_MPS2))
    mind[ACCEL_WISH] += (max(-cap, wish) - mind[ACCEL_WISH]) * sample_s / _PEDAL_S


@kernel
def choose_steering(
    mind: FloatArray,
    body: FloatArray,
    lines: FloatArray,
    start_m: float,
    step_m: float,
    front_mu: float,
    gradient_s2pm: float,
    vehicle: Vehicle,
    driver: Driver,
) -> None:
    """Update the steering angle that the driver's hands ask for.

    Args:
        mind: State of mind; the wish is updated.
        body: State of the body.
        lines: `track.Track.lines`.
        start_m: Station of its first row.
        step_m: Between its rows.
        front_mu: Friction under the front wheels. It sets only where the steering wheel goes light: he does not turn
            it further than one and a half times the slip of the peak.
        gradient_s2pm: Understeer gradient of his car, which he knows.
        vehicle: The car.
        driver: The driver.
    """
    wheelbase = vehicle.front_axle_m + vehicle.rear_axle_m
    vx = max(1.0, body[VELOCITY_X])
    ahead = body[STATION] + vx * (driver.steer_lag_s + 0.05)
    p = min(max((ahead - start_m) / step_m, 0.0), len(lines) - 2.0)
    i = int(p)
    part = p - i
    curvature = lines[i, CURVATURE] * (1.0 - part) + lines[i + 1, CURVATURE] * part
    cross = lines[i, CROSS_SLOPE] * (1.0 - part) + lines[i + 1, CROSS_SLOPE] * part
    wish = wheelbase * curvature + gradient_s2pm * (vx * vx * curvature + GRAVITY_MPS2 * cross)

    aim_m = max(4.0, vx * driver.preview_s)
    drift = body[ANGLE] + body[VELOCITY_Y] / vx
    gain = 2.0 * (wheelbase + max(0.0, gradient_s2pm) * vx * vx) / (aim_m * aim_m)
    wish -= gain * (body[OFFSET] + aim_m * drift)
    here = min(max(int((body[STATION] - start_m) / step_m + 0.5), 0), len(lines) - 1)
    wish -= driver.yaw_damping_s_ratio * (body[YAW_RATE] - lines[here, CURVATURE] * vx)

    light = _OVERDRIVE * front_mu * vehicle.tyre.peak_slip_y1_ratio / vehicle.tyre.peak_y1_ratio
    rolling = (body[VELOCITY_Y] + vehicle.front_axle_m * body[YAW_RATE]) / vx
    wish = min(max(wish, rolling - light), rolling + light)
    mind[STEER_WISH] = min(max(wish, -vehicle.steer_limit_rad), vehicle.steer_limit_rad)


@kernel
def sit_down(mind: FloatArray, driver: Driver) -> None:
    """Write the state of mind of a driver who has just met the road.

    Args:
        mind: Is overwritten.
        driver: The driver.
    """
    mind[:] = 0.0
    mind[GUESS_MU] = min(_SURE_MU, driver.friction_guess_mu)

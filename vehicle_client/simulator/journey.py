"""A whole drive in one compiled call: road, driver, stability control and car, from the approach to the exit."""

# ruff: noqa: PLR0917 - the compiler knows no keyword-only arguments

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from roadgrip.units import GRAVITY_MPS2, SAMPLE_S, FloatArray
from vehicle_client.simulator.chassis import (
    ANGLE,
    BODY_SIZE,
    BRAKE_NM,
    CROSS_CHANGE,
    CROSS_SLOPE,
    DRIVE_NM,
    FRICTION,
    GRADE,
    LOAD,
    OFFSET,
    ROAD_Z,
    SPIN,
    SPRUNG_V,
    SPRUNG_Z,
    STATION,
    STEER,
    VELOCITY_X,
    VELOCITY_Y,
    WHEEL_FORCE_X,
    WHEEL_FORCE_Y,
    WHEEL_SIZE,
    advance,
    set_loads,
)
from vehicle_client.simulator.compilation import cached_kernel, code_digest, kernel
from vehicle_client.simulator.driver import (
    ACCEL_WISH,
    FELT_SLIDE,
    GUESS_MU,
    MIND_SIZE,
    STEER_WISH,
    choose_pedals,
    choose_steering,
    feel,
    scan_ahead,
    sit_down,
    understeer_gradient_s2pm,
)
from vehicle_client.simulator.plan import Driver
from vehicle_client.simulator.stability import ABS_ACTIVE, AIDS_SIZE, ESC_ACTIVE, TCS_ACTIVE, intervene, switch_on
from vehicle_client.simulator.surface import GRID_M
from vehicle_client.simulator.track import LEFT_MU
from vehicle_client.simulator.vehicle import Vehicle

if TYPE_CHECKING:
    from collections.abc import Callable

COMPLETED, LEFT_ROAD, SPUN, STOPPED, TIMED_OUT = 0, 1, 2, 3, 4

ROAD_MARGIN_M = 2.5
"""A drive has left the road when the centre of gravity is further than this from the lane's centre line."""
SPIN_RAD = 0.8
"""A drive has spun when sideslip or angle against the road is larger."""
SLOWEST_MEAN_MPS = 2.5
"""A drive times out when it takes longer than at this mean speed."""
STEP_S = 0.002

# Columns of the log: the body first, as in `chassis`.
LOG_ROLL_RATE_ROAD, LOG_BANK, LOG_GRADE, LOG_NORMAL, LOG_SHAKE_ROLL, LOG_SHAKE_RATE = 14, 15, 16, 17, 18, 19
LOG_ABS, LOG_TCS, LOG_ESC, LOG_GUESS, LOG_SLIDE = 20, 21, 22, 23, 24
LOG_SPIN, LOG_LOAD, LOG_FORCE_X, LOG_FORCE_Y, LOG_FRICTION = 25, 29, 33, 37, 41
LOG_SIZE = 45


class Errand(NamedTuple):
    """The numbers of one drive that are neither car nor driver.

    Attributes:
        start_m: Station of the first sample of the road.
        step_m: Between samples of the road.
        approach_m: The drive starts at the negative of this station.
        finish_m: Station where the drive is complete.
        target_mps: Speed the driver likes.
        brake_from_m: Station where he is ordered to brake; infinite if he is not.
        brake_mps2: Deceleration that the order asks for.
        brake_until_mps: Speed at which the order is fulfilled, and the one he likes from there on.
        abs_on: 1 with anti-lock braking, 0 without.
        tcs_on: 1 with traction control, 0 without.
        esc_on: 1 with yaw control, 0 without.
        step_s: Time step.
    """

    start_m: float
    step_m: float
    approach_m: float
    finish_m: float
    target_mps: float
    brake_from_m: float
    brake_mps2: float
    brake_until_mps: float
    abs_on: float
    tcs_on: float
    esc_on: float
    step_s: float


@kernel
def look_at_road(
    road: FloatArray,
    wheels: FloatArray,
    lines: FloatArray,
    rough_m: FloatArray,
    station_m: float,
    errand: Errand,
    vehicle: Vehicle,
) -> None:
    """Write the road under the vehicle and friction and height under its wheels.

    Args:
        road: Is overwritten.
        wheels: Columns FRICTION and ROAD_Z are written.
        lines: `track.Track.lines`.
        rough_m: Height of both wheel tracks every 0.1 m from the start of the road; empty for a plane. (k, 2)
        station_m: Where the centre of gravity is.
        errand: For start and step of the road.
        vehicle: The car.
    """
    p = (station_m - errand.start_m) / errand.step_m
    last = len(lines) - 2.0
    q = min(max(p, 0.0), last)
    i = int(q)
    part = q - i
    for j in range(5):
        road[j] = lines[i, j] + part * (lines[i + 1, j] - lines[i, j])
    for axle in range(2):
        ahead = vehicle.front_axle_m if axle == 0 else -vehicle.rear_axle_m
        q = min(max(p + ahead / errand.step_m, 0.0), last)
        i = int(q)
        part = q - i
        for side in range(2):
            j = LEFT_MU + side
            wheels[2 * axle + side, FRICTION] = lines[i, j] + part * (lines[i + 1, j] - lines[i, j])
        if len(rough_m) > 0:
            q = min(max((station_m + ahead - errand.start_m) / GRID_M, 0.0), len(rough_m) - 2.0)
            i = int(q)
            part = q - i
            for side in range(2):
                wheels[2 * axle + side, ROAD_Z] = rough_m[i, side] + part * (rough_m[i + 1, side] - rough_m[i, side])


@kernel
def set_torques(wheels: FloatArray, body: FloatArray, road: FloatArray, accel_mps2: float, vehicle: Vehicle) -> None:
    """Write the drive and brake torques that give an acceleration, air and grade allowed for.

    Open differentials; a fixed share per axle. A released pedal brakes with the engine up to its limit, the brakes do
    the rest.

    Args:
        wheels: Columns DRIVE_NM and BRAKE_NM are written.
        body: State of the body.
        road: Road under the vehicle.
        accel_mps2: What the pedals ask for.
        vehicle: The car.
    """
    m, radius = vehicle.mass_kg, vehicle.tyre.rolling_radius_m
    speed = body[VELOCITY_X]
    force = m * (accel_mps2 + GRAVITY_MPS2 * (road[GRADE] + vehicle.tyre.rolling_resistance_ratio))
    force += vehicle.drag_npm2ps2_ratio * speed * speed
    drive = min(max(force, -m * vehicle.engine_brake_mps2), vehicle.power_w / max(3.0, speed))
    if speed < 1.0:
        drive = max(0.0, drive)
    brake = min(max(0.0, drive - force), m * vehicle.brake_limit_mps2) if force < 0.0 else 0.0
    for i in range(4):
        drive_frac = vehicle.front_drive_frac if i < 2 else 1.0 - vehicle.front_drive_frac
        brake_frac = vehicle.front_brake_frac if i < 2 else 1.0 - vehicle.front_brake_frac
        wheels[i, DRIVE_NM] = 0.5 * drive_frac * drive * radius
        wheels[i, BRAKE_NM] = 0.5 * brake_frac * brake * radius


@kernel
def _write_log(
    row: FloatArray,
    body: FloatArray,
    wheels: FloatArray,
    road: FloatArray,
    aids: FloatArray,
    mind: FloatArray,
    vehicle: Vehicle,
) -> None:
    for j in range(BODY_SIZE):
        row[j] = body[j]
    angle = body[ANGLE]
    grade, cross = road[GRADE], road[CROSS_SLOPE]
    row[LOG_GRADE] = grade * math.cos(angle) + cross * math.sin(angle)
    bank = math.atan(cross * math.cos(angle) - grade * math.sin(angle))
    row[LOG_BANK] = bank
    # The body turns with the surface: its bank changes along the road, and on a grade yaw has a part along x.
    row[LOG_ROLL_RATE_ROAD] = road[CROSS_CHANGE] * body[VELOCITY_X] / (1.0 + cross * cross)
    load = 0.0
    for i in range(4):
        load += wheels[i, LOAD]
        row[LOG_SPIN + i] = wheels[i, SPIN]
        row[LOG_LOAD + i] = wheels[i, LOAD]
        row[LOG_FORCE_X + i] = wheels[i, WHEEL_FORCE_X]
        row[LOG_FORCE_Y + i] = wheels[i, WHEEL_FORCE_Y]
        row[LOG_FRICTION + i] = wheels[i, FRICTION]
    row[LOG_NORMAL] = load / vehicle.mass_kg
    track = vehicle.front_track_m + vehicle.rear_track_m
    row[LOG_SHAKE_ROLL] = (
        wheels[0, SPRUNG_Z] + wheels[2, SPRUNG_Z] - wheels[1, SPRUNG_Z] - wheels[3, SPRUNG_Z]
    ) / track
    row[LOG_SHAKE_RATE] = (
        wheels[0, SPRUNG_V] + wheels[2, SPRUNG_V] - wheels[1, SPRUNG_V] - wheels[3, SPRUNG_V]
    ) / track
    row[LOG_ABS] = aids[ABS_ACTIVE]
    row[LOG_TCS] = aids[TCS_ACTIVE]
    row[LOG_ESC] = aids[ESC_ACTIVE]
    row[LOG_GUESS] = mind[GUESS_MU]
    row[LOG_SLIDE] = mind[FELT_SLIDE]


@kernel
def _ending(body: FloatArray, finish_m: float) -> int:
    if body[STATION] >= finish_m:
        return COMPLETED
    if abs(body[OFFSET]) > ROAD_MARGIN_M:
        return LEFT_ROAD
    vx, vy = body[VELOCITY_X], body[VELOCITY_Y]
    if vx < 0.3:
        return STOPPED
    if abs(body[ANGLE]) > SPIN_RAD or abs(math.atan2(vy, vx)) > SPIN_RAD:
        return SPUN
    return -1


@kernel
def _drive(
    lines: FloatArray,
    rough_m: FloatArray,
    errand: Errand,
    driver: Driver,
    vehicle: Vehicle,
    log: FloatArray,
) -> tuple[int, int]:
    body = np.zeros(BODY_SIZE)
    wheels = np.zeros((4, WHEEL_SIZE))
    road = np.zeros(5)
    mind = np.zeros(MIND_SIZE)
    aids = np.zeros(AIDS_SIZE)
    gradient = understeer_gradient_s2pm(vehicle)
    substeps = int(SAMPLE_S / errand.step_s + 0.5)
    dt = errand.step_s

    sit_down(mind, driver)
    switch_on(aids)
    body[STATION] = -errand.approach_m
    allowed, _ = scan_ahead(
        lines, errand.start_m, errand.step_m, body[STATION], errand.target_mps, mind[GUESS_MU], driver
    )
    body[VELOCITY_X] = min(errand.target_mps, allowed)
    look_at_road(road, wheels, lines, rough_m, body[STATION], errand, vehicle)
    for i in range(4):
        wheels[i, SPIN] = body[VELOCITY_X] / vehicle.tyre.rolling_radius_m
        # On the surface and at rest over it.
        wheels[i, SPRUNG_Z] = wheels[i, ROAD_Z]
        wheels[i, SPRUNG_Z + 2] = wheels[i, ROAD_Z]
    set_loads(body, wheels, road, vehicle)
    asked = 0.0
    target_mps = errand.target_mps

    for k in range(len(log)):
        feel(mind, body, wheels, driver, SAMPLE_S)
        choose_pedals(mind, body, lines, errand.start_m, errand.step_m, target_mps, driver, SAMPLE_S)
        if body[STATION] >= errand.brake_from_m and target_mps != errand.brake_until_mps:
            mind[ACCEL_WISH] = -errand.brake_mps2
            if body[VELOCITY_X] <= errand.brake_until_mps:
                target_mps = errand.brake_until_mps
        front_mu = 0.5 * (wheels[0, FRICTION] + wheels[1, FRICTION])
        choose_steering(mind, body, lines, errand.start_m, errand.step_m, front_mu, gradient, vehicle, driver)
        asked += (mind[ACCEL_WISH] - asked) * (1.0 - math.exp(-SAMPLE_S / vehicle.brake_lag_s))
        set_torques(wheels, body, road, asked, vehicle)
        intervene(aids, body, wheels, gradient, errand.abs_on, errand.tcs_on, errand.esc_on, vehicle, SAMPLE_S)
        _write_log(log[k], body, wheels, road, aids, mind, vehicle)
        ending = _ending(body, errand.finish_m)
        if ending >= 0:
            return k + 1, ending
        for _ in range(substeps):
            turn = (mind[STEER_WISH] - body[STEER]) / (driver.steer_lag_s + dt)
            turn = min(max(turn, -vehicle.steer_rate_limit_radps), vehicle.steer_rate_limit_radps)
            body[STEER] += turn * dt
            look_at_road(road, wheels, lines, rough_m, body[STATION], errand, vehicle)
            advance(body, wheels, road, vehicle, dt)
    return len(log), TIMED_OUT


def _compiled(digest: int) -> Callable[..., tuple[int, int]]:
    @cached_kernel
    def drive(
        lines: FloatArray,
        rough_m: FloatArray,
        errand: Errand,
        driver: Driver,
        vehicle: Vehicle,
        log: FloatArray,
    ) -> tuple[int, int]:
        """Run a drive and return how many samples it wrote into the log, and how it ended."""
        if digest == 0:
            return 0, TIMED_OUT
        return _drive(lines, rough_m, errand, driver, vehicle, log)

    compiled: Callable[..., tuple[int, int]] = drive
    return compiled


DIGEST = code_digest(_drive)
"""Of all compiled code of the simulator; in the compiler's cache key, and the name of the simulator in records."""

drive = _compiled(DIGEST)
"""Run a drive: (lines, roughness, errand, driver, vehicle, log) -> (samples written, ending)."""

"""Whole drives, `LANES` of them side by side: road, driver, stability systems and cars, from approach to exit.

`drive` moves all lanes until at least one drive has ended. Whoever calls it takes that drive's log, may seat the next
drive in the free lane, and calls again.
"""

# ruff: noqa: PLR0917 - the compiler knows no keyword-only arguments

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from roadgrip.units import SAMPLE_S
from vehicle_client.simulator.chassis import advance, cosine, set_hubs, set_loads, sine
from vehicle_client.simulator.compilation import cached_kernel, code_digest, formula, kernel
from vehicle_client.simulator.driver import (
    choose_pedals,
    choose_steering,
    feel,
    press_pedals,
    turn_wheel,
)
from vehicle_client.simulator.ground import look_ahead, look_at_road, look_before_wheels, look_up_height
from vehicle_client.simulator.lanes import (
    ABS_ACTIVE,
    ACCEL_X,
    ACCEL_Y,
    ALLOWED_MPS,
    ANGLE,
    APPROACH_M,
    CROSS_CHANGE,
    CROSS_SLOPE,
    ESC_ACTIVE,
    FINISH_M,
    FORCE_X,
    FORCE_Y,
    FRICTION,
    GRADE,
    GRADE_CHANGE,
    LAGGED_X,
    LANES,
    LINE_HEADING,
    LINE_X,
    LINE_Y,
    LOAD,
    OFFSET,
    PACE,
    PEDALS_MPS2,
    REPORT,
    REPORT_COUNT,
    ROAD_Z,
    ROLL,
    ROLL_RATE,
    SPIN,
    SPRUNG_V,
    SPRUNG_Z,
    STATION,
    STEER,
    TARGET_MPS,
    TCS_ACTIVE,
    UNSPRUNG_Z,
    VELOCITY_X,
    VELOCITY_Y,
    WHEEL_FORCE_X,
    WHEEL_FORCE_Y,
    WHEELS,
    YAW_RATE,
    vehicle_at,
)
from vehicle_client.simulator.stability import control_yaw, limit_braking, limit_drive, see_braking, select_low

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from roadgrip.units import FloatArray

    CountArray = NDArray[np.int64]

COMPLETED, LEFT_ROAD, SPUN, STOPPED, TIMED_OUT = 0, 1, 2, 3, 4
RUNNING, IDLE = -1, -2

ROAD_MARGIN_M = 2.5
"""A drive has left the road when the centre of gravity is further than this from the lane's centre line."""
SPIN_RAD = 0.8
"""A drive has spun when sideslip or angle against the road is larger."""
SLOWEST_MEAN_MPS = 2.5
"""A drive times out when it takes longer than at this mean speed."""
STEP_S = 0.002
GLANCE_SAMPLES = 5
"""The driver looks down the road twenty times a second."""
STANDSTILL_MPS = 0.3

# Rows of the table of counts: one column per lane.
SAMPLE, SAMPLES_LIMIT, LAST_LINE, LAST_HEIGHT, ENDING = 0, 1, 2, 3, 4
COUNTS_SIZE = 5

# Columns of the log.
LOG_STATION, LOG_OFFSET, LOG_LINE_X, LOG_LINE_Y, LOG_LINE_HEADING, LOG_ANGLE = 0, 1, 2, 3, 4, 5
LOG_VELOCITY_X, LOG_VELOCITY_Y, LOG_YAW_RATE, LOG_ROLL, LOG_BANK = 6, 7, 8, 9, 10
LOG_ACCEL_X, LOG_ACCEL_Y, LOG_STEER, LOG_FRICTION, LOG_UTILISATION = 11, 12, 13, 14, 15
LOG_ABS, LOG_TCS, LOG_ESC = 16, 17, 18
LOG_SENSED_FORCE, LOG_SENSED_RATE = 19, 22
LOG_LOAD, LOG_FORCE_X, LOG_FORCE_Y, LOG_WHEEL_SPEED = 25, 29, 33, 37


@kernel
def _set_off(state: FloatArray, lane: int, lines: FloatArray, last_line: int) -> None:
    """Place a car that has just been seated on the road, at the speed that the road allows."""
    state[STATION + lane] = -state[APPROACH_M + lane]
    look_ahead(state, lane, lines, last_line)
    speed = min(state[TARGET_MPS + lane], state[ALLOWED_MPS + lane])
    state[VELOCITY_X + lane] = state[PACE + lane] = speed
    for corner in range(4):
        wheel = corner * LANES + lane
        state[SPIN + wheel] = speed / vehicle_at(state, wheel).tyre.rolling_radius_m


@kernel
def _settle(state: FloatArray, lane: int) -> None:
    """Let a car that has just been placed rest on its springs."""
    for corner in range(4):
        wheel = corner * LANES + lane
        state[SPRUNG_Z + wheel] = state[UNSPRUNG_Z + wheel] = state[ROAD_Z + wheel]
    set_loads(state, lane)
    set_hubs(state, lane, 0.0)


@kernel
def _decide(state: FloatArray) -> None:
    """Let drivers and control units of all lanes act on the present sample, and report it."""
    for lane in range(LANES):
        feel(state, lane, SAMPLE_S)
        choose_pedals(state, lane, SAMPLE_S)
        choose_steering(state, lane)
        press_pedals(state, lane, state[PEDALS_MPS2 + lane])
        control_yaw(state, lane, SAMPLE_S)
        see_braking(state, lane)
        report(state, lane)


@kernel
def _act(state: FloatArray, step_s: float) -> None:
    """Let hands, engines and brakes of all lanes do what drivers and control units have decided."""
    for lane in range(LANES):
        turn_wheel(state, lane, step_s)
        limit_drive(state, lane)
    for wheel in range(WHEELS):
        limit_braking(state, wheel)
    for lane in range(LANES):
        select_low(state, lane)


@formula
def report(state: FloatArray, lane: int) -> None:
    """Write what the log keeps of a sample.

    Sensors sense in the axes of the body, which leans against the road.

    Args:
        state: Of all lanes.
        lane: Which one.
    """
    vehicle = vehicle_at(state, lane)
    front_left, front_right, rear_left, rear_right = lane, LANES + lane, 2 * LANES + lane, 3 * LANES + lane
    angle = state[ANGLE + lane]
    along, across = cosine(angle), sine(angle)
    grade, cross = state[GRADE + lane], state[CROSS_SLOPE + lane]
    bank = _arc_tangent(cross * along - grade * across)
    climb = grade * along + cross * across
    tracks = vehicle.front_track_m + vehicle.rear_track_m
    shaken = state[SPRUNG_Z + front_left] + state[SPRUNG_Z + rear_left]
    shaken -= state[SPRUNG_Z + front_right] + state[SPRUNG_Z + rear_right]
    shaking = state[SPRUNG_V + front_left] + state[SPRUNG_V + rear_left]
    shaking -= state[SPRUNG_V + front_right] + state[SPRUNG_V + rear_right]
    roll = state[ROLL + lane] + shaken / tracks
    pitch = -vehicle.pitch_per_accel_s2pm_ratio * state[LAGGED_X + lane]
    pitch_rate = (
        -vehicle.pitch_per_accel_s2pm_ratio
        * (state[FORCE_X + lane] - state[LAGGED_X + lane])
        / (vehicle.load_transfer_lag_s)
    )
    # The body turns with the surface, whose bank and grade change along the road; uphill the nose points up, and yaw
    # about the vertical has a part along x.
    turning = state[CROSS_CHANGE + lane] * state[VELOCITY_X + lane] / (1.0 + cross * cross)
    pitch_rate -= state[GRADE_CHANGE + lane] * state[VELOCITY_X + lane] / (1.0 + grade * grade)
    yaw = state[YAW_RATE + lane]
    nose_up = (climb * cosine(pitch) - sine(pitch)) / math.sqrt(1.0 + climb * climb)
    roll_rate = state[ROLL_RATE + lane] + shaking / tracks + turning + yaw * nose_up
    force_x, force_y = state[FORCE_X + lane], state[FORCE_Y + lane]
    load = (state[LOAD + front_left] + state[LOAD + front_right]) + (state[LOAD + rear_left] + state[LOAD + rear_right])
    normal = load / vehicle.mass_kg

    _log(state, lane, LOG_STATION, state[STATION + lane])
    _log(state, lane, LOG_OFFSET, state[OFFSET + lane])
    _log(state, lane, LOG_LINE_X, state[LINE_X + lane])
    _log(state, lane, LOG_LINE_Y, state[LINE_Y + lane])
    _log(state, lane, LOG_LINE_HEADING, state[LINE_HEADING + lane])
    _log(state, lane, LOG_ANGLE, angle)
    _log(state, lane, LOG_VELOCITY_X, state[VELOCITY_X + lane])
    _log(state, lane, LOG_VELOCITY_Y, state[VELOCITY_Y + lane])
    _log(state, lane, LOG_YAW_RATE, yaw)
    _log(state, lane, LOG_ROLL, roll)
    _log(state, lane, LOG_BANK, bank)
    _log(state, lane, LOG_ACCEL_X, state[ACCEL_X + lane])
    _log(state, lane, LOG_ACCEL_Y, state[ACCEL_Y + lane])
    _log(state, lane, LOG_STEER, state[STEER + lane])
    # Weighted by load; exactly the friction where it is the same under all wheels, whatever the loads.
    mu = state[FRICTION + front_left]
    others = (state[FRICTION + front_right] - mu) * state[LOAD + front_right]
    others += (state[FRICTION + rear_left] - mu) * state[LOAD + rear_left]
    others += (state[FRICTION + rear_right] - mu) * state[LOAD + rear_right]
    _log(state, lane, LOG_FRICTION, mu + others / max(1.0, load))
    front, rear = _utilisation_ratio(state, front_left), _utilisation_ratio(state, rear_left)
    _log(state, lane, LOG_UTILISATION, max(front, rear))
    _log(state, lane, LOG_ABS, state[ABS_ACTIVE + lane])
    _log(state, lane, LOG_TCS, state[TCS_ACTIVE + lane])
    _log(state, lane, LOG_ESC, state[ESC_ACTIVE + lane])
    _log(state, lane, LOG_SENSED_FORCE, force_x * cosine(pitch) - normal * sine(pitch))
    _log(state, lane, LOG_SENSED_FORCE + 1, force_y * cosine(roll) + normal * sine(roll))
    up = normal * cosine(roll) * cosine(pitch) - force_y * sine(roll) + force_x * sine(pitch)
    _log(state, lane, LOG_SENSED_FORCE + 2, up)
    _log(state, lane, LOG_SENSED_RATE, roll_rate)
    _log(state, lane, LOG_SENSED_RATE + 1, pitch_rate + yaw * sine(bank + roll))
    _log(state, lane, LOG_SENSED_RATE + 2, yaw * cosine(roll))
    for corner in range(4):
        wheel = corner * LANES + lane
        _log(state, lane, LOG_LOAD + corner, state[LOAD + wheel])
        _log(state, lane, LOG_FORCE_X + corner, state[WHEEL_FORCE_X + wheel])
        _log(state, lane, LOG_FORCE_Y + corner, state[WHEEL_FORCE_Y + wheel])
        _log(state, lane, LOG_WHEEL_SPEED + corner, state[SPIN + wheel] * vehicle.tyre.rolling_radius_m)


@formula
def _log(state: FloatArray, lane: int, column: int, value: float) -> None:
    state[REPORT + column * WHEELS + lane] = value


@formula
def _arc_tangent(slope: float) -> float:
    # For a road's slopes: below 0.15 the error stays below 1e-10.
    q = slope * slope
    return slope * (1.0 - q * (1.0 / 3.0 - q * (1.0 / 5.0 - q * (1.0 / 7.0 - q / 9.0))))


@formula
def _utilisation_ratio(state: FloatArray, left: int) -> float:
    """Return the share of its grip that an axle uses."""
    right = left + LANES
    force_x = state[WHEEL_FORCE_X + left] + state[WHEEL_FORCE_X + right]
    force_y = state[WHEEL_FORCE_Y + left] + state[WHEEL_FORCE_Y + right]
    grip = state[FRICTION + left] * state[LOAD + left] + state[FRICTION + right] * state[LOAD + right]
    ratio: float = math.sqrt(force_x * force_x + force_y * force_y) / max(1.0, grip)
    return ratio


@kernel
def _ending(state: FloatArray, lane: int) -> int:
    if state[STATION + lane] >= state[FINISH_M + lane]:
        return COMPLETED
    if abs(state[OFFSET + lane]) > ROAD_MARGIN_M:
        return LEFT_ROAD
    vx, vy = state[VELOCITY_X + lane], state[VELOCITY_Y + lane]
    if vx < STANDSTILL_MPS:
        return STOPPED
    if abs(state[ANGLE + lane]) > SPIN_RAD or abs(math.atan2(vy, vx)) > SPIN_RAD:
        return SPUN
    return RUNNING


@kernel
def _look(
    state: FloatArray, counts: CountArray, lines: FloatArray, rough_m: FloatArray, lane: int, steps_count: int
) -> None:
    """Look up all that a car and its driver need for the coming sample; a car that was just seated sets off."""
    last_line = counts[LAST_LINE, lane]
    if counts[SAMPLE, lane] == 0:
        _set_off(state, lane, lines, last_line)
    elif counts[SAMPLE, lane] % GLANCE_SAMPLES == 0:
        look_ahead(state, lane, lines, last_line)
    look_at_road(state, lane, lines, last_line, steps_count)
    look_before_wheels(state, lane, lines, last_line)
    if counts[SAMPLE, lane] == 0:
        look_up_height(state, lane, rough_m, counts[LAST_HEIGHT, lane])
        _settle(state, lane)


@kernel
def _keep(state: FloatArray, counts: CountArray, log: FloatArray, lane: int) -> None:
    """Copy the report of a sample into the log, and note whether the drive ends here."""
    sample = counts[SAMPLE, lane]
    for column in range(REPORT_COUNT):
        log[column, sample] = state[REPORT + column * WHEELS + lane]
    counts[SAMPLE, lane] = sample + 1
    ending = _ending(state, lane)
    if ending == RUNNING and sample + 1 >= counts[SAMPLES_LIMIT, lane]:
        ending = TIMED_OUT
    counts[ENDING, lane] = ending


@kernel
def _drive(
    state: FloatArray, counts: CountArray, lines: FloatArray, rough_m: FloatArray, log: FloatArray, step_s: float
) -> None:
    steps_count = int(SAMPLE_S / step_s + 0.5)
    ended = False
    while not ended:
        for lane in range(LANES):
            if counts[ENDING, lane] == RUNNING:
                _look(state, counts, lines[lane], rough_m[lane], lane, steps_count)
        _decide(state)
        for lane in range(LANES):
            if counts[ENDING, lane] == RUNNING:
                _keep(state, counts, log[lane], lane)
                ended = ended or counts[ENDING, lane] != RUNNING
        # Those who have not ended finish the sample, so that the next call starts with a whole one.
        for _ in range(steps_count):
            for lane in range(LANES):
                if counts[ENDING, lane] == RUNNING:
                    look_up_height(state, lane, rough_m[lane], counts[LAST_HEIGHT, lane])
            _act(state, step_s)
            advance(state, step_s)


def _compiled(digest: int) -> Callable[..., None]:
    @cached_kernel
    def drive(
        state: FloatArray,
        counts: CountArray,
        lines: FloatArray,
        rough_m: FloatArray,
        log: FloatArray,
        step_s: float,
    ) -> None:
        """Move all lanes until at least one drive has ended."""
        if digest != 0:
            _drive(state, counts, lines, rough_m, log, step_s)

    compiled: Callable[..., None] = drive
    return compiled


DIGEST = code_digest(_drive)
"""Of all compiled code of the simulator; in the compiler's cache key, and the name of the simulator in records."""

drive = _compiled(DIGEST)
"""Move all lanes until at least one has ended: (state, counts, lines, roughness, log, time step).

`counts` (COUNTS_SIZE, LANES) of int64; `lines` (LANES, n, 12) as in `track.Track`; roughness (LANES, k, 2); `log`
(LANES, REPORT_COUNT, samples). A running lane has RUNNING in ENDING; one that has ended holds how, and in SAMPLE how
many samples its log has.
"""

"""What lies under the wheels and before the driver: table look-ups, one lane after another.

These jump about in memory, so that nothing is won by doing them side by side. Road and friction are looked up once per
sample, here and where the car will be a sample later; straight lines in time between. The roughness, which has waves
much shorter than that, is looked up every time step.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from roadgrip.units import SAMPLE_S
from vehicle_client.simulator.compilation import formula, kernel
from vehicle_client.simulator.driver import planned_braking_mps2, willing_mps2
from vehicle_client.simulator.lanes import (
    AHEAD_CROSS_SLOPE,
    AHEAD_CURVATURE,
    ALLOWED_MPS,
    CROSS_CHANGE,
    CROSS_CHANGE_STEP,
    CROSS_SLOPE,
    CROSS_SLOPE_STEP,
    CURVATURE,
    CURVATURE_STEP,
    FRICTION,
    FRICTION_STEP,
    GRADE,
    GRADE_CHANGE,
    GRADE_CHANGE_STEP,
    GRADE_STEP,
    GUESS_MU,
    LANES,
    LEVER_X,
    LINE_HEADING,
    LINE_X,
    LINE_Y,
    NEEDED_MPS2,
    PACE,
    ROAD_Z,
    START_M,
    STATION,
    STEP_M,
    VELOCITY_X,
    driver_at,
)
from vehicle_client.simulator.surface import GRID_M
from vehicle_client.simulator.track import (
    BANK_HELP,
    LEFT_MU,
    RADIUS,
    TRACK_CROSS_CHANGE,
    TRACK_CROSS_SLOPE,
    TRACK_CURVATURE,
    TRACK_GRADE,
    TRACK_GRADE_CHANGE,
    TRACK_HEADING,
    TRACK_X,
    TRACK_Y,
)

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

_SCAN_ROWS = 4
_SLOWEST_MPS = 3.0


@formula
def _place(position: float, last_row: int) -> tuple[int, float]:
    """Return the row before a position in a table, and the part of the way to the next."""
    inside = min(max(position, 0.0), float(last_row))
    row = min(int(inside), last_row - 1)
    return row, inside - row


@formula
def _read(lines: FloatArray, row: int, part: float, column: int) -> float:
    value: float = lines[row, column] + part * (lines[row + 1, column] - lines[row, column])
    return value


@kernel
def look_at_road(state: FloatArray, lane: int, lines: FloatArray, last_row: int, steps_count: int) -> None:
    """Write the road under a car and the friction under its wheels, and how they change per time step.

    Args:
        state: Of all lanes.
        lane: Which one.
        lines: Its `track.Track.lines`, perhaps with idle rows behind.
        last_row: Index of the last row of the road.
        steps_count: Time steps per sample.
    """
    per_step = 1.0 / steps_count
    position = (state[STATION + lane] - state[START_M + lane]) / state[STEP_M + lane]
    stride = state[PACE + lane] * SAMPLE_S / state[STEP_M + lane]
    row, part = _place(position, last_row)
    next_row, next_part = _place(position + stride, last_row)
    for target, target_step, column in (
        (CURVATURE, CURVATURE_STEP, TRACK_CURVATURE),
        (GRADE, GRADE_STEP, TRACK_GRADE),
        (CROSS_SLOPE, CROSS_SLOPE_STEP, TRACK_CROSS_SLOPE),
        (GRADE_CHANGE, GRADE_CHANGE_STEP, TRACK_GRADE_CHANGE),
        (CROSS_CHANGE, CROSS_CHANGE_STEP, TRACK_CROSS_CHANGE),
    ):
        here = _read(lines, row, part, column)
        change = (_read(lines, next_row, next_part, column) - here) * per_step
        # In the middle of each time step, the first one to begin with.
        state[target + lane], state[target_step + lane] = here + 0.5 * change, change
    state[LINE_X + lane] = _read(lines, row, part, TRACK_X)
    state[LINE_Y + lane] = _read(lines, row, part, TRACK_Y)
    state[LINE_HEADING + lane] = _read(lines, row, part, TRACK_HEADING)
    for axle in range(2):
        wheel = 2 * axle * LANES + lane
        there = position + state[LEVER_X + wheel] / state[STEP_M + lane]
        row, part = _place(there, last_row)
        next_row, next_part = _place(there + stride, last_row)
        for side in range(2):
            here = _read(lines, row, part, LEFT_MU + side)
            state[FRICTION + wheel + side * LANES] = here
            change = (_read(lines, next_row, next_part, LEFT_MU + side) - here) * per_step
            state[FRICTION_STEP + wheel + side * LANES] = change


@kernel
def look_up_height(state: FloatArray, lane: int, rough_m: FloatArray, last_row: int) -> None:
    """Write the height of the road under each wheel.

    Args:
        state: Of all lanes.
        lane: Which one.
        rough_m: Height of both wheel tracks every 0.1 m from the start of the road. (k, 2)
        last_row: Index of the last row; negative for a plane.
    """
    if last_row < 1:
        return
    along = state[STATION + lane] - state[START_M + lane]
    for axle in range(2):
        wheel = 2 * axle * LANES + lane
        row, part = _place((along + state[LEVER_X + wheel]) * (1.0 / GRID_M), last_row)
        state[ROAD_Z + wheel] = _read(rough_m, row, part, 0)
        state[ROAD_Z + wheel + LANES] = _read(rough_m, row, part, 1)


@kernel
def look_before_wheels(state: FloatArray, lane: int, lines: FloatArray, last_row: int) -> None:
    """Write curvature and cross slope where the driver's steering will take effect.

    Args:
        state: Of all lanes.
        lane: Which one.
        lines: Its `track.Track.lines`.
        last_row: Index of the last row of the road.
    """
    ahead_m = max(1.0, state[VELOCITY_X + lane]) * (driver_at(state, lane).steer_lag_s + 0.05)
    row, part = _place((state[STATION + lane] + ahead_m - state[START_M + lane]) / state[STEP_M + lane], last_row)
    state[AHEAD_CURVATURE + lane] = _read(lines, row, part, TRACK_CURVATURE)
    state[AHEAD_CROSS_SLOPE + lane] = _read(lines, row, part, TRACK_CROSS_SLOPE)


@kernel
def look_ahead(state: FloatArray, lane: int, lines: FloatArray, last_row: int) -> None:
    """Write the speed that the road ahead allows now, and the deceleration that it asks for.

    Args:
        state: Of all lanes.
        lane: Which one.
        lines: Its `track.Track.lines`.
        last_row: Index of the last row of the road.
    """
    driver = driver_at(state, lane)
    guess, speed = state[GUESS_MU + lane], state[VELOCITY_X + lane]
    willing = willing_mps2(guess, driver.grip_share_ratio, driver.comfort_accel_mps2)
    braking = planned_braking_mps2(guess, driver.braking_mps2)
    # Nearer than what he covers while his foot moves, there is nothing to plan.
    nearest = max(2.0, 0.7 * speed)
    allowed, needed, distance = 1e4, 0.0, 0.0
    row, part = _place((state[STATION + lane] - state[START_M + lane]) / state[STEP_M + lane], last_row)
    while distance < driver.sight_m and row < last_row:
        radius = _read(lines, row, part, RADIUS)
        safe = max(_SLOWEST_MPS * _SLOWEST_MPS, willing * radius + _read(lines, row, part, BANK_HELP))
        allowed = min(allowed, safe + 2.0 * braking * distance)
        needed = max(needed, 0.5 * (speed * speed - safe) / max(distance, nearest))
        distance += _SCAN_ROWS * state[STEP_M + lane]
        row += _SCAN_ROWS
    state[ALLOWED_MPS + lane] = math.sqrt(allowed)
    state[NEEDED_MPS2 + lane] = needed

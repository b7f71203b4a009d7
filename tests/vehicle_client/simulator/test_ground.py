import numpy as np
import pytest

from vehicle_client.simulator import lanes
from vehicle_client.simulator.ground import look_at_road, look_up_height
from vehicle_client.simulator.plan import ALL_SYSTEMS, UNIMPRESSED
from vehicle_client.simulator.seats import place_car
from vehicle_client.simulator.track import (
    COLUMNS_COUNT,
    LEFT_MU,
    RIGHT_MU,
    TRACK_CROSS_CHANGE,
    TRACK_CROSS_SLOPE,
    TRACK_CURVATURE,
    TRACK_GRADE,
    TRACK_GRADE_CHANGE,
)
from vehicle_client.simulator.vehicle import XC90

pytestmark = pytest.mark.sim

ROWS_COUNT = 101
START_M, STEP_M = -20.0, 1.0
LANE = lanes.LANES - 1


def car_at(station_m, *, pace_mps=20.0):
    state = np.zeros(lanes.STATE_SIZE)
    place_car(state, LANE, vehicle=XC90, driver=UNIMPRESSED, stability=ALL_SYSTEMS)
    for row, value in (
        (lanes.START_M, START_M),
        (lanes.STEP_M, STEP_M),
        (lanes.STATION, station_m),
        (lanes.PACE, pace_mps),
    ):
        state[row + LANE] = value
    return state


def wheels_of(state, row):
    return state[row + LANE : row + lanes.WHEELS : lanes.LANES]


def lines_with(columns):
    """Return a road of 100 m from station -20 m, with columns as functions of the station."""
    station = START_M + STEP_M * np.arange(ROWS_COUNT)
    lines = np.zeros((ROWS_COUNT, COLUMNS_COUNT))
    for column, of_station in columns.items():
        lines[:, column] = of_station(station)
    return lines


def test_each_wheel_has_the_friction_where_it_stands():
    lines = lines_with({LEFT_MU: lambda s: 0.5 + 0.001 * s, RIGHT_MU: lambda s: 0.9 - 0.002 * s})
    state = car_at(30.25)
    look_at_road(state, LANE, lines, ROWS_COUNT - 1, 5)
    front, rear = 30.25 + XC90.front_axle_m, 30.25 - XC90.rear_axle_m
    expected = [0.5 + 0.001 * front, 0.9 - 0.002 * front, 0.5 + 0.001 * rear, 0.9 - 0.002 * rear]
    np.testing.assert_allclose(wheels_of(state, lanes.FRICTION), expected, rtol=1e-12)


def test_after_a_sample_the_friction_has_become_that_of_the_next_place():
    # An edge under the front wheels: half of the metre that it takes is passed within the sample.
    lines = lines_with(
        {LEFT_MU: lambda s: np.where(s < 40.0, 0.8, 0.3), RIGHT_MU: lambda s: np.where(s < 40.0, 0.8, 0.3)}
    )
    before, after = car_at(39.0 - XC90.front_axle_m, pace_mps=50.0), car_at(39.5 - XC90.front_axle_m, pace_mps=50.0)
    for state in (before, after):
        look_at_road(state, LANE, lines, ROWS_COUNT - 1, 5)
    stepped = wheels_of(before, lanes.FRICTION) + 5 * wheels_of(before, lanes.FRICTION_STEP)
    np.testing.assert_allclose(stepped, wheels_of(after, lanes.FRICTION), rtol=1e-12)
    np.testing.assert_allclose(stepped, [0.55, 0.55, 0.8, 0.8], rtol=1e-12)


@pytest.mark.parametrize(
    ("row", "step_row", "column"),
    [
        (lanes.CURVATURE, lanes.CURVATURE_STEP, TRACK_CURVATURE),
        (lanes.GRADE, lanes.GRADE_STEP, TRACK_GRADE),
        (lanes.CROSS_SLOPE, lanes.CROSS_SLOPE_STEP, TRACK_CROSS_SLOPE),
        (lanes.GRADE_CHANGE, lanes.GRADE_CHANGE_STEP, TRACK_GRADE_CHANGE),
        (lanes.CROSS_CHANGE, lanes.CROSS_CHANGE_STEP, TRACK_CROSS_CHANGE),
    ],
)
def test_the_road_under_the_car_is_that_of_the_middle_of_each_time_step(row, step_row, column):
    state = car_at(30.25, pace_mps=20.0)
    look_at_road(state, LANE, lines_with({column: lambda s: 0.002 * s}), ROWS_COUNT - 1, 5)
    for k in range(5):
        middle = 30.25 + 20.0 * 0.002 * (k + 0.5)
        assert state[row + LANE] + k * state[step_row + LANE] == pytest.approx(0.002 * middle, rel=1e-12)


@pytest.mark.parametrize("station_m", [-1e3, START_M, 80.0, 1e3])
def test_beyond_its_ends_the_road_goes_on_as_it_ended(station_m):
    state = car_at(station_m, pace_mps=50.0)
    lines = lines_with({TRACK_CURVATURE: lambda s: 0.001 * s, LEFT_MU: lambda s: 0.5 + 0.001 * s})
    look_at_road(state, LANE, lines, ROWS_COUNT - 1, 5)
    for k in range(5):
        curvature = state[lanes.CURVATURE + LANE] + k * state[lanes.CURVATURE_STEP + LANE]
        assert -0.02 - 1e-12 <= curvature <= 0.08 + 1e-12
        friction = wheels_of(state, lanes.FRICTION)[[0, 2]] + k * wheels_of(state, lanes.FRICTION_STEP)[[0, 2]]
        assert ((friction >= 0.48 - 1e-12) & (friction <= 0.58 + 1e-12)).all()


def test_each_wheel_has_the_height_of_its_own_track():
    along = 0.1 * np.arange(1001)
    rough = np.column_stack([0.001 * along, -0.002 * along])
    state = car_at(30.03)
    look_up_height(state, LANE, rough, len(rough) - 1)
    front, rear = 50.03 + XC90.front_axle_m, 50.03 - XC90.rear_axle_m
    expected = [0.001 * front, -0.002 * front, 0.001 * rear, -0.002 * rear]
    np.testing.assert_allclose(wheels_of(state, lanes.ROAD_Z), expected, rtol=1e-9)

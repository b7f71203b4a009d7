import numpy as np
import pytest

from vehicle_client.simulator.lanes import (
    DRIVER,
    LANES,
    STATE_SIZE,
    TYRE,
    VEHICLE,
    WHEELS,
    driver_at,
    ramp_ratio,
    tyre_at,
    vehicle_at,
)
from vehicle_client.simulator.plan import ALL_SYSTEMS, UNIMPRESSED, Driver
from vehicle_client.simulator.seats import place_car
from vehicle_client.simulator.vehicle import Tyre, Vehicle

pytestmark = pytest.mark.sim


def record(kind, number, *more):
    """Return a record whose values are all different, and different for every number."""
    return kind(*(1.0 + 0.01 * i + 1e-4 * number for i in range(len(kind._fields) - len(more))), *more)


def test_every_field_that_is_placed_is_the_field_that_is_read():
    state = np.full(STATE_SIZE, np.nan)
    cars = [record(Vehicle, lane, record(Tyre, lane + 50)) for lane in range(LANES)]
    drivers = [record(Driver, lane) for lane in range(LANES)]
    for lane in range(LANES):
        place_car(state, lane, vehicle=cars[lane], driver=drivers[lane], stability=ALL_SYSTEMS)
    for lane in range(LANES):
        for place in range(lane, WHEELS, LANES):
            assert vehicle_at(state, place) == cars[lane]
            assert tyre_at(state, place) == cars[lane].tyre
        assert driver_at(state, lane) == drivers[lane]


def test_the_records_fill_their_rows():
    assert WHEELS * (len(Vehicle._fields) - 1) == TYRE - VEHICLE
    assert WHEELS * len(Tyre._fields) == DRIVER - TYRE


def test_a_car_is_placed_over_whatever_was_there():
    fresh, used = np.zeros(STATE_SIZE), np.full(STATE_SIZE, np.nan)
    for lane in range(LANES):
        for state in (fresh, used):
            place_car(state, lane, vehicle=Vehicle(), driver=UNIMPRESSED, stability=ALL_SYSTEMS)
    assert np.array_equal(fresh, used)


def test_placing_a_car_leaves_the_other_lanes_alone():
    state = np.arange(float(STATE_SIZE))
    place_car(state, 0, vehicle=Vehicle(), driver=UNIMPRESSED, stability=ALL_SYSTEMS)
    others = np.arange(STATE_SIZE) % LANES != 0
    assert np.array_equal(state[others], np.arange(float(STATE_SIZE))[others])


@pytest.mark.parametrize(("value", "expected"), [(-1.0, 0.0), (2.0, 0.0), (3.0, 0.5), (4.0, 1.0), (9.0, 1.0)])
def test_a_ramp_is_a_switch_without_a_jump(value, expected):
    assert ramp_ratio(value, 2.0, 4.0) == expected

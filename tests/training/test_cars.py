"""Cars keep what they are for all their life, whatever else there is beside them."""

from dataclasses import fields, replace

import pytest

from training.cars import Garage, Lives, any_car, car_of, cars_of, wrong_handling
from vehicle_client.estimation.handling import XC90_HANDLING
from vehicle_client.simulator.plan import SensorGrade
from vehicle_client.simulator.vehicle import XC90

FLEET = Lives("test-fleet", 2, SensorGrade.AUTOMOTIVE, 2, varied_vehicles=True)
PAPER = replace(FLEET, name="test-paper", varied_vehicles=False)


def test_a_careless_maker_is_off_by_the_same_share_everywhere(rng):
    wrong = wrong_handling(XC90_HANDLING, rng)
    for right, declared in ((XC90_HANDLING, wrong), (XC90_HANDLING.tyre, wrong.tyre)):
        for field in fields(right):
            if field.name != "tyre":
                ratio = getattr(declared, field.name) / getattr(right, field.name)
                assert abs(ratio - 1.0) == pytest.approx(0.1), field.name


def test_shares_that_are_wrong_are_shares(rng):
    all_in_front = replace(XC90_HANDLING, front_drive_frac=1.0)
    declared = {wrong_handling(all_in_front, rng).front_drive_frac for _ in range(20)}
    assert declared == {0.9, 1.0}


def test_cars_are_others_by_group_place_and_seed_and_the_same_again():
    cars = [car_of(FLEET, 0, 0), car_of(FLEET, 0, 1), car_of(FLEET, 1, 0), car_of(replace(FLEET, seed=3), 0, 0)]
    for attribute in ("vehicle", "sensor_seed", "wear_factor", "wrong"):
        assert len({repr(getattr(car, attribute)) for car in cars}) == 4
    assert car_of(FLEET, 0, 1) == cars[1]


def test_the_papers_car_differs_by_its_sensors_and_tyres_alone():
    cars = [car_of(PAPER, 0, place) for place in range(3)]
    assert all(car.vehicle == XC90 and car.matched == XC90_HANDLING for car in cars)
    assert len({car.sensor_seed for car in cars}) == 3


def test_more_groups_change_none_of_those_there_were():
    assert replace(FLEET, groups_count=9).identity == FLEET.identity
    assert replace(FLEET, seed=3).identity != FLEET.identity
    assert PAPER.identity != FLEET.identity


def test_the_same_cars_carry_any_sensors():
    assert car_of(replace(FLEET, grade=SensorGrade.IDEAL), 1, 2) == car_of(FLEET, 1, 2)


def test_every_car_is_met(rng):
    met = {any_car(rng, PAPER).name for _ in range(400)}
    assert met == {car.name for group in range(2) for car in cars_of(PAPER, group)}


@pytest.mark.parametrize(("groups_count", "remembering_count"), [(0, 0), (2, 3), (2, -1)])
def test_no_more_cars_have_learned_than_there_are(groups_count, remembering_count):
    with pytest.raises(ValueError, match="cannot have learned"):
        Garage(groups_count, remembering_count)

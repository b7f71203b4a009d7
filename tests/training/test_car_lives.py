"""Cars keep their sensors and tyres over their life, groups keep to themselves, and all tellings tell of one drive."""

from dataclasses import fields, replace

import numpy as np
import pytest

from roadgrip.features import GRIP_TABLE, PAPER_TABLE
from training import car_lives
from training.car_lives import Lives, Telling, car_of, everyday_road, judged_road, lived, wrong_handling
from training.dataset import COMPLETED
from training.designs import BASE_FRICTIONS_MU, random_roads
from training.scenarios import attempted
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


def test_judged_roads_are_those_of_the_random_roads_and_no_group_shares_any():
    known = [road.section for road in random_roads(2, 13, attempted(1))]
    assert judged_road(FLEET, 0, 3) == known[3]
    assert judged_road(FLEET, 1, 1) == known[12]
    assert everyday_road(FLEET, 0, 0).section_id != everyday_road(FLEET, 1, 0).section_id


def test_more_groups_change_none_of_those_there_were():
    assert replace(FLEET, groups_count=9).identity == FLEET.identity
    assert replace(FLEET, seed=3).identity != FLEET.identity
    assert PAPER.identity != FLEET.identity


@pytest.fixture(scope="module")
def runs():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(car_lives, "EVERYDAY_COUNT", 2)
        patch.setattr(car_lives, "FEW_COUNT", 1)
        patch.setattr(car_lives, "CARS_COUNT", 3)
        return lived(FLEET, 0)


@pytest.mark.sim
@pytest.mark.xdist_group("sim")
def test_every_car_meets_every_road_once_at_another_friction(runs):
    matched = runs.rows(np.flatnonzero(np.array(runs.scenario) == Telling.MATCHED.value))
    assert len(matched) == 9
    for road in set(matched.section_id):
        here = np.array(matched.section_id) == road
        assert sorted(matched.labels["base_friction_mu"][here]) == list(BASE_FRICTIONS_MU[:3])
    cars = np.array([key.rsplit("/", 2)[0] for key in matched.run_key])
    for car in set(cars.tolist()):
        assert sorted(matched.labels["base_friction_mu"][cars == car]) == list(BASE_FRICTIONS_MU[:3])
        assert len(set(matched.labels["wear_ratio"][cars == car].tolist())) == 1


@pytest.mark.sim
@pytest.mark.xdist_group("sim")
def test_tellings_differ_by_the_grip_alone(runs):
    assert runs.outcome.count(COMPLETED) > 0.5 * len(runs)
    assert len(set(runs.run_key)) == len(runs)
    told = {telling: np.flatnonzero(np.array(runs.scenario) == telling.value) for telling in Telling}
    first = runs.rows(told[Telling.MATCHED])
    kinematic = GRIP_TABLE.columns(PAPER_TABLE.names)
    for telling, rows in told.items():
        other = runs.rows(rows)
        for name, values in first.labels.items():
            assert np.array_equal(other.labels[name], values, equal_nan=True)
        assert np.array_equal(other.features[:, kinematic], first.features[:, kinematic], equal_nan=True)
        best = other.columns(["grip_all_best_mu"])[other.usable]
        changed = best != first.columns(["grip_all_best_mu"])[other.usable]
        assert changed.mean() > 0.9 or telling is Telling.MATCHED
        assert not changed.any() or telling is not Telling.MATCHED

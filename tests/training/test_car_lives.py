"""Cars keep their sensors and tyres over their life, groups keep to themselves, and all tellings tell of one drive."""

import numpy as np
import pytest

from roadgrip.features import GRIP_TABLE, PAPER_TABLE
from training import car_lives, cars
from training.car_lives import Telling, judged_road, lived
from training.cars import CARS_COUNT, Lives
from training.dataset import COMPLETED
from training.designs import BASE_FRICTIONS_MU, random_roads
from training.everyday import everyday_road
from training.scenarios import attempted
from vehicle_client.simulator.plan import SensorGrade

FLEET = Lives("test-fleet", 2, SensorGrade.AUTOMOTIVE, 2, varied_vehicles=True)


def test_a_group_has_a_car_for_each_base_friction():
    assert len(BASE_FRICTIONS_MU) == CARS_COUNT


def test_judged_roads_are_those_of_the_random_roads_and_no_group_shares_any():
    known = [road.section for road in random_roads(2, 13, attempted(1))]
    assert judged_road(FLEET, 0, 3) == known[3]
    assert judged_road(FLEET, 1, 1) == known[12]
    assert everyday_road(FLEET, 0, 0).section_id != everyday_road(FLEET, 1, 0).section_id


@pytest.fixture(scope="module")
def runs():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(car_lives, "EVERYDAY_COUNT", 2)
        patch.setattr(car_lives, "FEW_COUNT", 1)
        patch.setattr(car_lives, "CARS_COUNT", 3)
        patch.setattr(cars, "CARS_COUNT", 3)
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

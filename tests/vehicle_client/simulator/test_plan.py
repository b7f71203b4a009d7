import math

import numpy as np

from tests.vehicle_client.simulator.rig import curvy_road
from vehicle_client.simulator.plan import DriverKind, SensorGrade, draw_plan

ROAD = curvy_road(speed_mps=20.0)


def many(count=2000, **options):
    rng = np.random.default_rng(3)
    return [draw_plan(rng, section=ROAD, base_friction_mu=0.4, **options) for _ in range(count)]


def test_wear_is_uniform_and_speed_triangular_around_the_rated_one():
    plans = many()
    wear = np.array([p.wear_factor for p in plans])
    speed = np.array([p.target_speed_mps for p in plans])
    assert wear.min() >= 0.8
    assert wear.max() <= 1.0
    assert abs(wear.mean() - 0.9) < 0.005
    assert speed.min() >= 16.0
    assert speed.max() <= 24.0
    assert abs(speed.std() - 4.0 / math.sqrt(6.0)) < 0.1


def test_a_prudent_driver_guesses_within_a_third_and_does_not_know_the_wear():
    plans = many()
    error = np.log([p.driver.friction_guess_mu / 0.4 for p in plans])
    assert abs(error.mean()) < 0.03
    assert abs(error.std() - 0.35) < 0.02
    assert abs(np.corrcoef(error, [p.wear_factor for p in plans])[0, 1]) < 0.06


def test_a_reacting_driver_guesses_nothing_but_is_otherwise_the_same():
    prudent, reacting = many(5), many(5, kind=DriverKind.REACTING)
    assert all(math.isinf(p.driver.friction_guess_mu) for p in reacting)
    assert [p.driver[1:] for p in prudent] == [p.driver[1:] for p in reacting]


def test_the_grade_does_not_change_the_draws():
    one, two = many(5, grade=SensorGrade.IDEAL), many(5, grade=SensorGrade.AUTOMOTIVE)
    assert [p.seed for p in one] == [p.seed for p in two]

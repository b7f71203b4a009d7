"""Yaw rate excess."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_client.estimation.yaw_rate import intended_yaw_rate_radps, yaw_rate_excess_radps

XC90 = {"wheelbase_m": 2.984, "track_m": 1.67}


def test_it_is_the_papers_formula_in_a_left_turn():
    v, d = 15.0, 0.1
    paper = 2.0 * v * np.tan(d) / (2.0 * 2.984 + 1.67 * np.tan(d))
    assert intended_yaw_rate_radps(np.array([v]), np.array([d]), **XC90)[0] == pytest.approx(paper)


@pytest.mark.parametrize("radius_m", [20.0, 60.0, -60.0, 400.0])
def test_it_is_exact_for_the_inner_wheel_of_a_car_that_only_rolls(radius_m):
    inner = np.sign(radius_m) * np.arctan(2.984 / (abs(radius_m) - 1.67 / 2.0))
    assert intended_yaw_rate_radps(np.array([8.0]), np.array([inner]), **XC90)[0] == pytest.approx(8.0 / radius_m)


def test_with_the_mean_angle_a_car_that_only_rolls_shows_a_little_oversteer():
    mean = np.arctan(2.984 / 60.0)
    excess = yaw_rate_excess_radps(np.array([8.0 / 60.0]), np.array([8.0]), np.array([mean]), **XC90)[0]
    assert excess / (8.0 / 60.0) == pytest.approx(1.67 * np.tan(mean) / (2.0 * 2.984), rel=0.03)


@given(steer=st.floats(-0.7, 0.7), speed=st.floats(0.0, 40.0), yaw_rate=st.floats(-1.0, 1.0))
def test_the_mirror_only_changes_the_sign(steer, speed, yaw_rate):
    here = yaw_rate_excess_radps(np.array([yaw_rate]), np.array([speed]), np.array([steer]), **XC90)
    there = yaw_rate_excess_radps(np.array([-yaw_rate]), np.array([speed]), np.array([-steer]), **XC90)
    assert there[0] == -here[0]


def test_less_yaw_than_steered_in_a_left_turn_is_negative():
    excess = yaw_rate_excess_radps(np.array([0.2]), np.array([15.0]), np.array([0.1]), **XC90)
    assert excess[0] < 0.0


def test_a_standing_car_intends_nothing():
    assert yaw_rate_excess_radps(np.array([0.3]), np.array([0.0]), np.array([0.2]), **XC90)[0] == 0.3


def test_nan_in_nan_out():
    assert np.isnan(yaw_rate_excess_radps(np.array([np.nan]), np.array([1.0]), np.array([0.0]), **XC90)).all()

"""Climbing, told by the forward accelerometer."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.estimation.filters import integral
from vehicle_client.estimation.vertical import CLIMB_LIMIT_RATIO, vertical_velocity_mps

N = 1500
TIME_S = np.arange(N) * 0.01
ZERO = np.zeros(N)
SPEED_MPS = 15.0 + 2.0 * np.sin(0.5 * TIME_S)
ACCEL_MPS2 = np.cos(0.5 * TIME_S)


def test_speeding_up_and_braking_on_the_level_is_no_climb():
    assert np.abs(vertical_velocity_mps(ACCEL_MPS2, SPEED_MPS, ZERO)).max() < 0.02


def test_a_parked_car_gains_no_height():
    assert (vertical_velocity_mps(np.full(N, GRAVITY_MPS2 * 0.1), ZERO, ZERO) == 0.0).all()


@given(sine=st.floats(-0.12, 0.12))
def test_a_steady_climb_is_its_sine_times_the_way(sine):
    climbing = vertical_velocity_mps(ACCEL_MPS2 + GRAVITY_MPS2 * sine, SPEED_MPS, ZERO)
    assert integral(climbing)[-1] == pytest.approx(sine * integral(SPEED_MPS)[-1], abs=0.05)


def test_a_hill_is_driven_up_and_down():
    sine = 0.06 * np.cos(0.4 * TIME_S)
    height = integral(vertical_velocity_mps(ACCEL_MPS2 + GRAVITY_MPS2 * sine, SPEED_MPS, ZERO))
    assert np.abs(height - integral(sine * SPEED_MPS)).max() < 0.02


def test_a_sideways_velocity_in_a_turn_is_no_climb():
    yaw_rate, left = np.full(N, 0.3), 0.5 * np.sin(TIME_S)
    assert np.abs(vertical_velocity_mps(-yaw_rate * left, np.full(N, 15.0), yaw_rate, left)).max() < 1e-3


def test_an_offset_is_a_straight_line_over_the_distance():
    height = integral(vertical_velocity_mps(ACCEL_MPS2 + 0.1, SPEED_MPS, ZERO))
    assert np.abs(height - 0.1 / GRAVITY_MPS2 * integral(SPEED_MPS)).max() < 0.05


def test_the_mirrored_drive_climbs_the_same():
    rng = np.random.default_rng(1)
    ax, w, left = rng.normal(0.0, 0.3, (3, N))
    here = vertical_velocity_mps(ax, SPEED_MPS, w, left)
    assert np.array_equal(vertical_velocity_mps(ax, SPEED_MPS, -w, -left), here)


def test_no_climb_is_steeper_than_any_road():
    wild = vertical_velocity_mps(np.full(N, 30.0), np.full(N, 10.0), ZERO)
    assert np.abs(wild).max() == pytest.approx(10.0 * CLIMB_LIMIT_RATIO)


def test_a_third_is_the_steepest_climb_and_shaking_is_none():
    assert np.abs(vertical_velocity_mps(np.full(N, -30.0), np.full(N, 10.0), ZERO)).max() == pytest.approx(3.5)
    shaking = 3.0 * np.sin(2.0 * np.pi * 40.0 * TIME_S)
    assert np.abs(vertical_velocity_mps(shaking, np.full(N, 10.0), ZERO))[40:-40].max() < 1e-3

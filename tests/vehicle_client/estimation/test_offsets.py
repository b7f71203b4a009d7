"""Offsets on the straight before a section."""

import numpy as np
import pytest

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.estimation.offsets import NO_OFFSETS, sensor_offsets

N = 1000
SPEED_MPS = np.full(N, 20.0)
ZERO = np.zeros(N)


def offsets_of(accel_y, yaw_rate, steer, *, accel_x=ZERO, climb_rad=0.0, speed=SPEED_MPS, approach=None):
    everywhere = np.ones(N, dtype=bool) if approach is None else approach
    return sensor_offsets(
        accel_y, yaw_rate, steer, speed, everywhere, accel_x_mps2=accel_x, climb_rad=climb_rad, wheelbase_m=2.984
    )


def test_perfect_sensors_have_none():
    found = offsets_of(np.zeros(N), np.zeros(N), np.zeros(N))
    assert (found.yaw_rate_radps, found.accel_y_mps2, found.steer_rad) == (0.0, 0.0, 0.0)
    assert found.accel_x_mps2 == 0.0
    assert found.straight_s == pytest.approx(10.0)
    assert not found.uncertain


def test_offsets_are_found_within_what_is_said_about_them():
    rng = np.random.default_rng(1)
    for _ in range(20):
        yaw, accel, steer = rng.normal(0.0, [0.0017, 0.05, 0.002])
        found = offsets_of(
            accel + rng.normal(0.0, 0.03, N), yaw + rng.normal(0.0, 0.0017, N), steer + rng.normal(0.0, 0.0005, N)
        )
        assert abs(found.yaw_rate_radps - yaw) < 3.0 * found.yaw_rate_std_radps
        assert abs(found.accel_y_mps2 - accel) < 3.0 * found.accel_y_std_mps2
        assert abs(found.steer_rad - steer) < 3.0 * found.steer_std_rad


def test_forward_accelerometer_and_grade_of_the_approach_share_what_is_seen():
    # 0.08 m/s^2 of offset and a grade that is 1 % from the map's, on a car that slows down; 12 % uphill.
    slowing = 22.0 - 0.5 * 0.01 * np.arange(N)
    for offset, odd_grade in ((0.08, 0.0), (0.0, 0.01), (-0.05, 0.01)):
        climb = 0.12 + odd_grade
        found = offsets_of(
            ZERO,
            ZERO,
            ZERO,
            accel_x=np.full(N, -0.5 + offset + GRAVITY_MPS2 * np.sin(climb)),
            climb_rad=0.12,
            speed=slowing,
        )
        assert abs(found.accel_x_mps2 - offset) < 2.0 * found.accel_x_std_mps2
        assert 0.05 < found.accel_x_std_mps2 < NO_OFFSETS.accel_x_std_mps2


def test_slowing_down_is_no_offset_of_the_forward_accelerometer():
    found = offsets_of(ZERO, ZERO, ZERO, accel_x=np.full(N, -1.0), speed=25.0 - 0.01 * np.arange(N))
    assert found.accel_x_mps2 == pytest.approx(0.0, abs=1e-3)


def test_a_longer_straight_tells_more():
    signal = np.full(N, 0.0017)
    short = offsets_of(np.zeros(N), signal, np.zeros(N), approach=np.arange(N) < 200)
    long = offsets_of(np.zeros(N), signal, np.zeros(N))
    assert 0.0 < short.yaw_rate_radps < long.yaw_rate_radps < 0.0017
    assert short.yaw_rate_std_radps > long.yaw_rate_std_radps


@pytest.mark.parametrize(
    "case",
    [
        {"approach": np.zeros(N, dtype=bool)},
        {"approach": np.arange(N) < 50},
        {"speed": np.full(N, 3.0)},
    ],
)
def test_without_a_straight_nothing_is_corrected_and_that_is_said(case):
    found = offsets_of(np.full(N, 0.2), np.full(N, 0.002), np.full(N, 0.01), **case)
    assert found == NO_OFFSETS
    assert found.uncertain


def test_a_curve_is_not_taken_for_an_offset():
    assert offsets_of(np.full(N, 4.0), np.full(N, 0.2), np.full(N, 0.03)) == NO_OFFSETS


def test_the_mirror_has_the_opposite_offsets():
    rng = np.random.default_rng(2)
    accel, yaw, steer = rng.normal(0.0, [[0.05], [0.002], [0.001]], (3, N))
    here, there = offsets_of(accel, yaw, steer), offsets_of(-accel, -yaw, -steer)
    assert there.yaw_rate_radps == -here.yaw_rate_radps
    assert there.accel_y_mps2 == -here.accel_y_mps2
    assert there.accel_x_mps2 == here.accel_x_mps2
    assert there.steer_rad == -here.steer_rad

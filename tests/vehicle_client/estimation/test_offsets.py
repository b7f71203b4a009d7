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


def share(prior, *measured):
    """Return which share of a measurement is believed beside a prior around zero."""
    return prior**2 / (prior**2 + sum(one**2 for one in measured))


def test_each_offset_is_shrunk_by_what_a_straight_can_tell():
    # The figures of the docstrings, once more by hand: ten seconds at 20 m/s, sensors without noise.
    found = offsets_of(np.full(N, 0.05), np.full(N, 0.001), np.full(N, 0.002), accel_x=np.full(N, 0.04))
    gyro = share(0.002, 0.008 / 10.0)
    assert found.yaw_rate_radps == pytest.approx(gyro * 0.001)
    assert found.yaw_rate_std_radps == pytest.approx(np.sqrt(gyro) * 0.0008)
    left = (1.0 - gyro) * 0.001
    known = found.yaw_rate_std_radps
    assert found.accel_y_mps2 == pytest.approx(share(0.1, 0.2, 20.0 * known) * (0.05 - 20.0 * left))
    assert found.accel_x_mps2 == pytest.approx(share(0.1, 0.15, np.sqrt(2.0) * 0.05 / 10.0) * 0.04)
    lever = 2.984 / 20.0
    assert found.steer_rad == pytest.approx(share(0.009, 0.001, lever * known) * (0.002 - lever * left))
    assert found.accel_y_std_mps2 == pytest.approx(0.1 * np.sqrt(1.0 - share(0.1, 0.2, 20.0 * known)))


def test_noise_of_the_gyro_counts_on_a_short_straight():
    noise = 0.2 * np.where(np.arange(N) % 2, 1.0, -1.0)
    found = offsets_of(ZERO, noise, ZERO, approach=np.arange(N) // 100 == 3)
    assert found.yaw_rate_std_radps == pytest.approx(0.002 * np.sqrt(1.0 - share(0.002, 0.008, 0.2 / 10.0)), rel=1e-6)


@pytest.mark.parametrize(("radius_m", "straight"), [(-700.0, False), (700.0, False), (900.0, True), (-900.0, True)])
def test_a_bend_of_800_metres_is_the_tightest_straight(radius_m, straight):
    assert (offsets_of(ZERO, SPEED_MPS / radius_m, ZERO) != NO_OFFSETS) is straight


@pytest.mark.parametrize(("speed_mps", "count", "tells"), [(4.7, 900, False), (5.3, 900, True), (20.0, 95, False)])
def test_a_straight_tells_from_a_second_at_five_metres_a_second_on(speed_mps, count, tells):
    found = offsets_of(ZERO, ZERO, ZERO, speed=np.full(N, speed_mps), approach=np.arange(N) < count)
    assert (found != NO_OFFSETS) is tells
    assert offsets_of(ZERO, ZERO, ZERO, approach=np.arange(N) < 105).straight_s == pytest.approx(1.05)


def test_of_two_straights_the_longer_one_counts():
    for longer_first in (False, True):
        bend = np.arange(N) // 100 == (7 if longer_first else 2)
        found = offsets_of(ZERO, np.where(bend, 0.3, 0.0), ZERO)
        assert 6.0 < found.straight_s <= 7.0


def test_one_second_is_no_straight_if_a_bend_cuts_it():
    bend = np.arange(N) % 100 > 80
    assert offsets_of(ZERO, np.where(bend, 0.3, 0.0), ZERO) == NO_OFFSETS

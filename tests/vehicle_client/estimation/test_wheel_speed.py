"""Forward speed from four wheels."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from tests.vehicle_client.synthetic import motion
from vehicle_client.estimation.observer import XC90_PARAMETERS
from vehicle_client.estimation.trace import Trace, mirrored
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.estimation.wheel_speed import encoder_speed_mps, speed_at_wheels_mps

N = 600
TIME_S = np.arange(N) * 0.01


def speed_of(trace: Trace, velocity_y_mps=None):
    return encoder_speed_mps(
        trace.wheel_speed_mps,
        trace.yaw_rate_radps,
        trace.steer_rad,
        trace.accel_x_mps2,
        np.zeros(N) if velocity_y_mps is None else velocity_y_mps,
        vehicle=XC90,
        parameters=XC90_PARAMETERS,
    )


def test_on_a_circle_every_wheel_tells_the_speed_of_the_centre():
    trace = motion(np.full(N, 12.0), np.full(N, 0.3), velocity_y_mps=np.full(N, -0.2))
    speeds = speed_at_wheels_mps(
        trace.wheel_speed_mps, trace.yaw_rate_radps, trace.steer_rad, np.full(N, -0.2), vehicle=XC90
    )
    assert np.allclose(speeds, 12.0, atol=1e-12)


def test_a_steady_circle_gives_its_speed():
    trace = motion(np.full(N, 12.0), np.full(N, 0.3))
    assert np.allclose(speed_of(trace), 12.0, atol=1e-9)


def test_speed_that_swings_slowly_is_followed():
    speed = 15.0 + 2.0 * np.sin(2.0 * np.pi * 0.2 * TIME_S)
    trace = motion(speed, 0.2 * np.sin(2.0 * np.pi * 0.3 * TIME_S))
    assert np.abs(speed_of(trace) - speed)[40:-40].max() < 2e-3


def test_a_wheel_that_spins_up_counts_less_and_then_nothing():
    trace = motion(np.full(N, 12.0), np.zeros(N))
    wheels = trace.wheel_speed_mps.copy()
    wheels[200:300, 2] += np.linspace(0.0, 6.0, 100)
    error = np.abs(speed_of(replace(trace, wheel_speed_mps=wheels)) - 12.0)
    assert error.max() < 0.16  # the mean of the wheels is 1.5 off
    assert error[240:280].max() < 0.01


@pytest.mark.parametrize("stuck_mps", [0.0, 9.0, 20.0])
def test_an_encoder_that_hangs_is_left_out(stuck_mps):
    speed = 14.0 + np.sin(2.0 * np.pi * 0.1 * TIME_S)
    trace = motion(speed, np.zeros(N))
    wheels = trace.wheel_speed_mps.copy()
    wheels[:, 1] = stuck_mps
    assert np.abs(speed_of(replace(trace, wheel_speed_mps=wheels)) - speed).max() < 0.02


def test_four_locked_wheels_still_give_a_number():
    trace = motion(np.full(N, 12.0), np.zeros(N))
    locked = replace(trace, wheel_speed_mps=np.zeros((N, 4)), accel_x_mps2=np.full(N, -4.0))
    assert np.allclose(speed_of(locked), 0.0)


def test_the_mirror_gives_the_same_speed():
    rng = np.random.default_rng(4)
    trace = motion(np.full(N, 12.0), 0.2 * np.sin(TIME_S))
    trace = replace(trace, wheel_speed_mps=trace.wheel_speed_mps + rng.normal(0.0, 0.05, (N, 4)))
    assert np.allclose(speed_of(mirrored(trace)), speed_of(trace), atol=1e-12)


@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_driving_straight_it_does_not_matter_which_wheel_is_which(order):
    trace = motion(np.full(N, 12.0), np.zeros(N))
    # One wheel hangs, one creeps, two are noisy: all of the weighing is at work.
    wheels = trace.wheel_speed_mps + np.random.default_rng(5).normal(0.0, 0.05, (N, 4))
    wheels[:, 0], wheels[:, 1] = 9.0, wheels[:, 1] + np.linspace(0.0, 2.0, N)
    expected = speed_of(replace(trace, wheel_speed_mps=wheels))
    assert np.allclose(speed_of(replace(trace, wheel_speed_mps=wheels[:, list(order)])), expected, atol=1e-12)


def test_two_locked_and_two_spinning_wheels_still_give_a_number():
    trace = motion(np.full(N, 12.0), np.zeros(N))
    wheels = np.column_stack([np.zeros((N, 2)), np.full((N, 2), 30.0)])
    assert np.isfinite(speed_of(replace(trace, wheel_speed_mps=wheels))).all()


def test_a_stuck_encoder_moves_the_speed_by_less_than_a_millimetre_a_second():
    trace = motion(np.full(N, 20.0), np.zeros(N))
    wheels = trace.wheel_speed_mps.copy()
    wheels[:, 3] = 0.0
    assert np.abs(speed_of(replace(trace, wheel_speed_mps=wheels)) - 20.0).max() < 1e-3


def test_a_slipping_wheel_counts_less_while_the_car_brakes_than_on_a_steady_drive():
    # 2 m/s^2 more than the others, for half a second: Gaussians of width 1 and 4.5 leave 14 and 91 % of its voice.
    for accel_mps2, voice in ((-3.0, np.exp(-0.5 * 2.0**2)), (0.0, np.exp(-0.5 * (2.0 / 4.5) ** 2))):
        speed = np.asarray(30.0 + accel_mps2 * TIME_S, dtype=np.float64)
        trace = motion(speed, np.zeros(N))
        wheels = trace.wheel_speed_mps.copy()
        slip = np.clip(TIME_S - 3.0, 0.0, 0.5) * -2.0
        wheels[:, 2] += slip
        error = speed_of(replace(trace, wheel_speed_mps=wheels)) - speed
        assert error[325] == pytest.approx(slip[325] * voice / (3.0 + voice), rel=0.05)


def test_noise_costs_a_wheel_little_of_its_voice():
    trace = motion(np.full(N, 20.0), np.zeros(N))
    wheels = trace.wheel_speed_mps.copy()
    wheels[:, 0] += 0.3 + np.random.default_rng(3).normal(0.0, 0.1, N)
    assert np.mean(speed_of(replace(trace, wheel_speed_mps=wheels)) - 20.0) == pytest.approx(0.3 / 4.0, rel=0.12)

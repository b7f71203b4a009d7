"""Roll, and what remains of the lateral accelerometer without it."""

import numpy as np
import pytest

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.estimation.roll import chassis_roll_rad, reckoned_roll_rate_radps, road_accel_y_mps2

N = 3000
TIME_S = np.arange(N) * 0.01
ZERO = np.zeros(N)


def roll_of(
    accel_y, *, yaw_rate=ZERO, speed=ZERO, roll_rate=ZERO, bank=ZERO, climb=ZERO, gripping=ZERO, crossover_hz=0.1
):
    return chassis_roll_rad(
        accel_y,
        yaw_rate,
        speed,
        roll_rate,
        bank,
        climb_rad=climb,
        gripping_velocity_y_mps=gripping,
        crossover_hz=crossover_hz,
    )


def test_a_parked_car_that_leans_is_seen_to_lean():
    assert np.allclose(roll_of(np.full(N, GRAVITY_MPS2 * np.sin(0.05))), 0.05)


def test_a_parked_car_on_a_bank_does_not_lean_against_the_road():
    assert np.allclose(roll_of(np.full(N, GRAVITY_MPS2 * np.sin(0.05)), bank=np.full(N, 0.05)), 0.0, atol=1e-12)


@pytest.mark.parametrize("frequency_hz", [0.02, 0.1, 1.0])
def test_any_roll_is_seen_whole_when_both_sensors_agree(frequency_hz):
    omega = 2.0 * np.pi * frequency_hz
    roll = 0.03 * np.cos(omega * TIME_S)
    speed, yaw_rate = np.full(N, 15.0), np.full(N, 0.2)
    accel_y = 3.0 + GRAVITY_MPS2 * np.sin(roll)
    found = roll_of(accel_y, yaw_rate=yaw_rate, speed=speed, roll_rate=-0.03 * omega * np.sin(omega * TIME_S))
    assert np.allclose(found, roll, atol=2e-5)


def test_fast_roll_comes_from_the_gyro_and_slow_from_the_accelerometer():
    # A gyro that drifts does not run away; an accelerometer that shakes is not believed.
    drifting = roll_of(ZERO, roll_rate=np.full(N, 0.002), crossover_hz=0.2)
    assert np.abs(drifting[500:-500]).max() < 0.002
    shaking = roll_of(np.sin(2.0 * np.pi * 5.0 * TIME_S), crossover_hz=0.2)
    assert np.abs(shaking[500:-500]).max() < 0.001


@pytest.mark.parametrize("climb_rad", [-0.08, 0.1])
def test_turning_on_a_grade_is_no_roll(climb_rad):
    # The road turns about the vertical, the car's long axis points uphill: the roll gyro sees a share of the turn.
    yaw_rate, speed = 0.3 * np.sin(0.5 * TIME_S), np.full(N, 15.0)
    found = roll_of(
        yaw_rate * speed,
        yaw_rate=yaw_rate,
        speed=speed,
        roll_rate=yaw_rate * np.tan(climb_rad),
        climb=np.full(N, climb_rad),
    )
    assert np.abs(found).max() < 1e-12


def test_a_lateral_velocity_that_was_expected_is_no_roll():
    gripping = 0.5 * np.sin(0.3 * TIME_S)
    found = roll_of(np.gradient(gripping, 0.01), gripping=gripping)
    assert np.abs(found).max() < 1e-4


def test_without_a_gyro_a_body_that_leans_with_the_force_is_seen_all_the_same():
    # A body of 0.006 rad per m/s^2 on a bank that comes and goes, uphill.
    force, bank, climb = 3.0 * np.sin(TIME_S), 0.04 * np.sin(0.3 * TIME_S), np.full(N, 0.08)
    yaw_rate, speed = force / 15.0, np.full(N, 15.0)
    tilt = 0.006 * force + bank
    accel_y = force + GRAVITY_MPS2 * np.sin(tilt)
    # It goes by what the accelerometer reads, which holds the lean itself and the bank.
    gradient = 0.006 / (1.0 + GRAVITY_MPS2 * 0.006)
    roll_rate = reckoned_roll_rate_radps(accel_y, yaw_rate, bank, climb_rad=climb, roll_gradient_s2pm=gradient)
    found = roll_of(accel_y, yaw_rate=yaw_rate, speed=speed, roll_rate=roll_rate, bank=bank, climb=climb)
    assert np.abs(found - 0.006 * force)[300:-300].max() < 2e-3
    blind = roll_of(accel_y, yaw_rate=yaw_rate, speed=speed, bank=bank, climb=climb)
    assert np.abs(blind - 0.006 * force)[300:-300].max() > 1e-2


def test_gravity_is_taken_out():
    roll, bank = np.full(N, 0.03), np.full(N, -0.05)
    lateral = np.sin(TIME_S)
    measured = lateral * np.cos(roll + bank) + GRAVITY_MPS2 * np.sin(roll + bank)
    assert np.allclose(road_accel_y_mps2(measured, chassis_roll_rad=roll, bank_rad=bank), lateral)


def test_the_mirror_rolls_the_other_way():
    rng = np.random.default_rng(2)
    accel_y, yaw_rate, roll_rate, bank, gripping, climb = rng.normal(0.0, 0.1, (6, N))
    speed = np.full(N, 15.0)
    here = roll_of(
        accel_y, yaw_rate=yaw_rate, speed=speed, roll_rate=roll_rate, bank=bank, climb=climb, gripping=gripping
    )
    there = roll_of(
        -accel_y, yaw_rate=-yaw_rate, speed=speed, roll_rate=-roll_rate, bank=-bank, climb=climb, gripping=-gripping
    )
    assert np.allclose(there, -here, atol=1e-13)

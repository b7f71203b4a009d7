"""From where the sensor sits to the centre of gravity."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.estimation.mounting import InertialSignals, at_centre_of_gravity, levelled, mounting_rotation
from vehicle_client.estimation.vehicle_geometry import XC90

N = 400
TIME_S = np.arange(N) * 0.01


def signals(ax, ay, p, w):
    return InertialSignals(accel_x_mps2=ax, accel_y_mps2=ay, roll_rate_radps=p, yaw_rate_radps=w)


def test_a_sensor_at_the_centre_is_passed_through():
    seen = signals(*np.random.default_rng(1).normal(size=(4, N)))
    assert levelled(at_centre_of_gravity(seen, XC90), XC90) is seen


def test_a_sensor_ahead_of_the_centre_feels_the_turn():
    w = 0.3 + 0.1 * np.sin(TIME_S)
    dw = 0.1 * np.cos(TIME_S)
    x, y = 0.8, -0.3
    seen = signals(-dw * y - w**2 * x, dw * x - w**2 * y, np.zeros(N), w)
    found = at_centre_of_gravity(seen, replace(XC90, imu_x_m=x, imu_y_m=y))
    assert np.abs(found.accel_x_mps2)[40:-40].max() < 1e-4
    assert np.abs(found.accel_y_mps2)[40:-40].max() < 1e-4


def test_a_tilted_sensor_in_a_parked_car_reads_level_again():
    tilt = 0.03
    vehicle = replace(XC90, imu_roll_rad=tilt)
    # Left side up by 0.03: its y axis sees g sin(0.03).
    seen = signals(np.zeros(N), np.full(N, GRAVITY_MPS2 * np.sin(tilt)), np.zeros(N), np.zeros(N))
    assert np.allclose(levelled(seen, vehicle).accel_y_mps2, 0.0, atol=1e-12)


def test_a_sensor_turned_to_the_left_sees_braking_as_braking():
    turn = 0.2
    vehicle = replace(XC90, imu_yaw_rad=turn)
    seen = signals(np.full(N, -3.0 * np.cos(turn)), np.full(N, 3.0 * np.sin(turn)), np.zeros(N), np.full(N, 0.1))
    found = levelled(seen, vehicle)
    assert np.allclose(found.accel_x_mps2, -3.0)
    assert np.allclose(found.accel_y_mps2, 0.0, atol=1e-12)
    assert np.allclose(found.yaw_rate_radps, 0.1)


def test_a_sensor_is_turned_to_the_left_then_nose_down_then_onto_its_side():
    roll, pitch, yaw = 0.3, 0.2, 0.5
    turn = mounting_rotation(replace(XC90, imu_roll_rad=roll, imu_pitch_rad=pitch, imu_yaw_rad=yaw))
    # Its forward axis does not feel the last of the three turns, which is about it.
    assert turn[:, 0] == pytest.approx(
        [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)], abs=1e-12
    )
    # Its left axis lies in the level before the roll, which lifts it: left side up.
    assert turn[2, 1] == pytest.approx(np.sin(roll) * np.cos(pitch), abs=1e-12)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-12)

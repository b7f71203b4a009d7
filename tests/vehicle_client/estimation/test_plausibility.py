"""Sensors against each other, on motion that is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vehicle_client.synthetic import drive_over, motion, s_turn, with_noise
from vehicle_client.estimation.plausibility import Finding, Sensor, findings
from vehicle_client.estimation.trace import Trace, mirrored
from vehicle_client.estimation.vehicle_geometry import XC90

CLEAN, STATION = drive_over(s_turn, swing_mps=2.0)
TRACE = with_noise(CLEAN, np.random.default_rng(5))
ENTRY, EXIT = (int(np.searchsorted(STATION, at)) for at in (0.0, 400.0))
MIDDLE = int(np.searchsorted(STATION, 160.0))
LATER = np.arange(TRACE.samples_count) >= MIDDLE


def of(trace: Trace):
    speed = trace.wheel_speed_mps.mean(axis=1)
    return findings(trace, speed, from_s=float(trace.time_s[ENTRY]), to_s=float(trace.time_s[EXIT - 1]), vehicle=XC90)


def blamed(trace: Trace) -> set[Sensor]:
    return {finding.sensor for finding in of(trace) if finding.grave}


def doubted(trace: Trace) -> set[Sensor]:
    return {finding.sensor for finding in of(trace) if finding.doubtful}


@pytest.mark.parametrize("trace", [CLEAN, TRACE], ids=["exact", "noisy"])
def test_good_sensors_are_not_doubted(trace):
    assert doubted(trace) == set()
    assert doubted(mirrored(trace)) == set()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), offset=st.floats(-1.0, 1.0), speed_mps=st.floats(8.0, 25.0))
def test_offsets_and_noise_of_ordinary_sensors_are_not_doubted(seed, offset, speed_mps):
    trace, _ = drive_over(s_turn, speed_mps=speed_mps)
    trace = with_noise(trace, np.random.default_rng(seed))
    trace = replace(
        trace,
        yaw_rate_radps=trace.yaw_rate_radps * (1.0 + 0.02 * offset) + 0.004 * offset,
        accel_y_mps2=trace.accel_y_mps2 + 0.4 * offset,
        steer_rad=trace.steer_rad + 0.01 * offset,
        wheel_speed_mps=trace.wheel_speed_mps * (1.0 + 0.005 * offset * np.array([1.0, -1.0, 1.0, 1.0])),
    )
    found = findings(trace, trace.wheel_speed_mps.mean(axis=1), from_s=3.0, to_s=float(trace.time_s[-1]), vehicle=XC90)
    assert not [str(finding) for finding in found if finding.doubtful]


@pytest.mark.parametrize("gain", [0.0, -1.0])
def test_a_dead_or_reversed_gyro_is_blamed_alone(gain):
    assert blamed(replace(TRACE, yaw_rate_radps=gain * TRACE.yaw_rate_radps)) == {Sensor.GYRO}


def test_a_gyro_that_freezes_in_a_bend_is_blamed():
    held = TRACE.yaw_rate_radps[ENTRY + 700]
    rate = np.where(np.arange(TRACE.samples_count) >= ENTRY + 700, held, TRACE.yaw_rate_radps)
    assert blamed(replace(TRACE, yaw_rate_radps=rate)) >= {Sensor.GYRO}


@pytest.mark.parametrize("gain", [0.4, 2.0])
def test_a_gyro_of_a_wholly_wrong_size_is_blamed(gain):
    assert blamed(replace(TRACE, yaw_rate_radps=gain * TRACE.yaw_rate_radps)) == {Sensor.GYRO}


@pytest.mark.parametrize("gain", [0.7, 1.35])
def test_a_gyro_of_a_wrong_size_is_doubted(gain):
    assert Sensor.GYRO in doubted(replace(TRACE, yaw_rate_radps=gain * TRACE.yaw_rate_radps))


@pytest.mark.parametrize("value", [17.7, -17.7, 0.0])
def test_an_accelerometer_that_stops_is_blamed_alone(value):
    held = np.where(LATER, value, TRACE.accel_y_mps2)
    assert blamed(replace(TRACE, accel_y_mps2=held)) == {Sensor.ACCELEROMETER}
    assert blamed(replace(TRACE, accel_y_mps2=np.full(TRACE.samples_count, value))) == {Sensor.ACCELEROMETER}


def test_a_reversed_accelerometer_is_blamed():
    assert blamed(replace(TRACE, accel_y_mps2=-TRACE.accel_y_mps2)) == {Sensor.ACCELEROMETER}


@pytest.mark.parametrize("jump_rad", [0.02, -0.02, 0.05])
def test_a_steering_that_jumps_is_blamed_alone(jump_rad):
    assert blamed(replace(TRACE, steer_rad=TRACE.steer_rad + jump_rad * LATER)) == {Sensor.STEERING}


def test_a_steering_whose_zero_wanders_is_seen_on_the_exit():
    share = np.clip((np.arange(TRACE.samples_count) - MIDDLE) / 300.0, 0.0, 1.0)
    assert blamed(replace(TRACE, steer_rad=TRACE.steer_rad + 0.02 * share)) == {Sensor.STEERING}
    assert doubted(replace(TRACE, steer_rad=TRACE.steer_rad + 0.01 * share)) == {Sensor.STEERING}
    assert doubted(replace(TRACE, steer_rad=TRACE.steer_rad + 0.003 * share)) == set()


def test_a_steering_that_was_always_off_is_an_offset():
    assert doubted(replace(TRACE, steer_rad=TRACE.steer_rad + 0.02)) == set()


def test_a_steering_that_rests_in_the_bends_is_blamed_and_on_the_straight_not():
    frozen = np.where(LATER, TRACE.steer_rad[MIDDLE], TRACE.steer_rad)
    assert blamed(replace(TRACE, steer_rad=frozen)) == {Sensor.STEERING}
    coarse = np.round(CLEAN.steer_rad / 0.00175) * 0.00175
    assert doubted(replace(TRACE, steer_rad=coarse)) == set()


@pytest.mark.parametrize("wheel", range(4))
@pytest.mark.parametrize("ratio", [0.95, 1.05])
def test_one_wheel_of_another_size_is_doubted(wheel, ratio):
    wheels = TRACE.wheel_speed_mps.copy()
    wheels[:, wheel] *= ratio
    assert doubted(replace(TRACE, wheel_speed_mps=wheels)) == {Sensor.WHEELS}
    assert blamed(replace(TRACE, wheel_speed_mps=wheels)) == set()


def test_a_sender_that_repeats_itself_for_a_moment_blames_nobody():
    rows = np.arange(TRACE.samples_count)
    rows[ENTRY + 500 : ENTRY + 520] = ENTRY + 500
    names = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad", "wheel_speed_mps")
    repeated: dict[str, Any] = {name: getattr(TRACE, name)[rows] for name in names}
    assert doubted(replace(TRACE, **repeated)) == set()


@pytest.mark.parametrize("name", ["accel_y_mps2", "roll_rate_radps", "steer_rad"])
def test_a_channel_that_is_not_there_is_not_called_faulty(name):
    silent: dict[str, Any] = {name: np.zeros(TRACE.samples_count)}
    without = replace(TRACE, **silent, absent=(name,))
    assert doubted(without) == set()


def test_wheels_made_of_a_reference_speed_are_no_witnesses():
    absent = tuple(f"wheel_{place}_mps" for place in ("front_left", "front_right", "rear_left", "rear_right"))
    alike = np.repeat(TRACE.wheel_speed_mps.mean(axis=1)[:, None], 4, axis=1)
    assert doubted(replace(TRACE, wheel_speed_mps=alike, absent=absent)) == set()


def test_standing_still_says_nothing():
    names = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad", "wheel_speed_mps")
    still = replace(TRACE, **{name: np.zeros_like(getattr(TRACE, name)) for name in names})
    assert doubted(still) == set()


def test_nothing_is_read_into_a_second():
    trace = replace(TRACE, yaw_rate_radps=-TRACE.yaw_rate_radps)
    at = float(trace.time_s[MIDDLE])
    found = findings(trace, trace.wheel_speed_mps.mean(axis=1), from_s=at + 900.0, to_s=at + 901.0, vehicle=XC90)
    assert found == ()


def test_a_channel_of_a_turned_sensor_that_freezes_does_not_live_by_the_others():
    vehicle = replace(XC90, imu_yaw_rad=0.3)
    frozen = replace(TRACE, accel_x_mps2=np.where(LATER, 0.4, TRACE.accel_x_mps2))
    speed, to_s = TRACE.wheel_speed_mps.mean(axis=1), float(TRACE.time_s[EXIT - 1])
    found = findings(frozen, speed, from_s=float(TRACE.time_s[ENTRY]), to_s=to_s, vehicle=vehicle)
    assert any(finding.grave and "frozen" in finding.what for finding in found)


def told(trace: Trace, words: str) -> list[Finding]:
    return [finding for finding in of(trace) if words in finding.what]


@pytest.mark.parametrize(("force_mps2", "doubt", "fault"), [(2.1, False, False), (2.3, True, False), (4.1, True, True)])
def test_a_force_that_no_bend_explains_is_first_doubted_and_then_blamed(force_mps2, doubt, fault):
    pushed = LATER & (np.arange(TRACE.samples_count) < MIDDLE + 250)
    (found,) = told(replace(TRACE, accel_y_mps2=TRACE.accel_y_mps2 + force_mps2 * pushed), "no bend explains")
    assert (found.doubtful, found.grave) == (doubt, fault)


def test_a_gyro_that_wanders_is_doubted_and_is_then_no_witness_against_others():
    noise = np.convolve(np.random.default_rng(1).normal(0.0, 1.0, TRACE.samples_count), np.ones(100) / 10.0, "same")
    wandering = replace(TRACE, yaw_rate_radps=TRACE.yaw_rate_radps + 0.12 * noise)
    assert doubted(wandering) == {Sensor.GYRO}
    assert blamed(wandering) == set()


def test_the_wheels_of_a_tight_circle_agree_though_each_has_its_own_speed():
    n = 1000
    for yaw_rate_radps in (0.5, -0.5):
        trace = motion(np.full(n, 5.0), np.full(n, yaw_rate_radps))
        found = findings(trace, np.full(n, 5.0), from_s=0.0, to_s=10.0, vehicle=XC90)
        assert [f.found_value for f in found if f.sensor is Sensor.WHEELS] == [0.0]


def test_outer_tyres_that_are_pressed_flat_at_speed_make_no_gyro_doubtful():
    # They tell a third more of turning at 25 m/s; so does the steering of a car that slides over its front wheels.
    trace, _ = drive_over(s_turn, speed_mps=25.0)
    pressed = 0.001 * trace.accel_y_mps2 / 2.0
    wheels = trace.wheel_speed_mps * (1.0 + pressed[:, None] * [-1.0, 1.0, -1.0, 1.0])
    sliding = replace(trace, wheel_speed_mps=wheels, steer_rad=1.3 * trace.steer_rad, absent=("accel_y_mps2",))
    found = findings(sliding, np.full(trace.samples_count, 25.0), from_s=3.0, to_s=18.0, vehicle=XC90)
    assert not [str(f) for f in found if f.doubtful and f.sensor is Sensor.GYRO]
    assert any("more or less" in f.what for f in found)


def test_a_steering_that_rests_while_the_car_turns_is_a_fault_of_its_own():
    frozen = np.where(LATER, TRACE.steer_rad[MIDDLE], TRACE.steer_rad)
    (found,) = told(replace(TRACE, steer_rad=frozen), "rests")
    assert found.grave


def test_one_sample_of_the_steering_that_strays_is_no_jump():
    at = np.arange(TRACE.samples_count) == MIDDLE
    assert doubted(replace(TRACE, steer_rad=TRACE.steer_rad + 0.04 * at)) == set()


@pytest.mark.parametrize(("before_s", "seen"), [(2.5, True), (3.5, False)])
def test_three_seconds_around_the_section_are_looked_at(before_s, seen):
    at = np.arange(TRACE.samples_count) // 2 == (ENTRY - round(before_s / 0.01)) // 2
    assert (blamed(replace(TRACE, steer_rad=TRACE.steer_rad + 0.04 * at)) == {Sensor.STEERING}) is seen


def test_a_steering_that_catches_up_after_the_whole_network_rested_did_not_jump():
    turned = np.abs(TRACE.steer_rad[ENTRY + 100 : EXIT] - TRACE.steer_rad[ENTRY : EXIT - 100])
    start = ENTRY + int(np.argmax(turned))
    assert turned.max() > 0.018
    rows = np.arange(TRACE.samples_count)
    rows[start : start + 100] = start
    names = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad", "wheel_speed_mps")
    (found,) = told(replace(TRACE, **{name: getattr(TRACE, name)[rows] for name in names}), "jumps")
    assert not found.doubtful
    (found,) = told(replace(TRACE, steer_rad=TRACE.steer_rad[rows]), "jumps")
    assert found.grave

"""What the inverse looks at: means over a section, forces where the body leans, and stand-ins for absent sensors."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.units import GRAVITY_MPS2, SAMPLE_S
from tests.vehicle_client.synthetic import road, s_turn
from vehicle_client.estimation.grip.motion import (
    NORMAL_MIN_MPS2,
    SAMPLES_LIMIT_COUNT,
    SPEED_MIN_MPS,
    STEP_MIN_COUNT,
    Evidence,
    motion_over,
    silent_without,
)
from vehicle_client.estimation.handling import XC90_HANDLING
from vehicle_client.estimation.mounting import InertialSignals

COUNT = 1200
TIME_S = SAMPLE_S * np.arange(COUNT)
SECTION = road(s_turn, cross_slope_ratio=0.0)
INSIDE = (TIME_S > 4.0) & (TIME_S < 9.0)
LEANING = 1.0 + GRAVITY_MPS2 * XC90_HANDLING.roll_gradient_s2pm
NODDING = 1.0 + GRAVITY_MPS2 * XC90_HANDLING.pitch_gradient_s2pm


def sensed(*, section=SECTION, inside=INSIDE, level_gain_ratio=0.0, absent=(), **changes):
    """Return the motion of a car at 20 m/s that feels 2 m/s2 to the left, turns for them, and keeps its speed."""
    count = len(inside)
    signals = {
        "speed_mps": np.full(count, 20.0),
        "yaw_rate_radps": np.full(count, 0.1),
        "accel_y_mps2": np.full(count, 2.0 * LEANING),
        "accel_x_mps2": np.zeros(count),
        "steer_rad": np.full(count, 0.02),
        "wheel_speed_mps": np.tile([19.0, 21.0, 19.5, 20.5], (count, 1)),
        "station_m": np.linspace(0.0, section.length_m, count),
    } | changes
    measured = InertialSignals(
        accel_x_mps2=signals["accel_x_mps2"],
        accel_y_mps2=signals["accel_y_mps2"],
        roll_rate_radps=np.zeros(count),
        yaw_rate_radps=signals["yaw_rate_radps"],
    )
    return motion_over(
        section,
        measured,
        station_m=signals["station_m"],
        inside=inside,
        speed_mps=signals["speed_mps"],
        steer_rad=signals["steer_rad"],
        wheel_speed_mps=signals["wheel_speed_mps"],
        handling=XC90_HANDLING,
        level_gain_ratio=level_gain_ratio,
        absent=absent,
    )


def test_a_steady_turn_is_told_as_it_is():
    motion = sensed()
    assert motion.step_s == pytest.approx(STEP_MIN_COUNT * SAMPLE_S)
    for name, value in {
        "speed_mps": 20.0,
        "yaw_rate_radps": 0.1,
        "yaw_accel_radps2": 0.0,
        "steer_rad": 0.02,
        "force_x_mps2": 0.0,
        "force_y_mps2": 2.0,
        "force_y_rate_mps3": 0.0,
        "normal_mps2": GRAVITY_MPS2,
        "bank_rad": 0.0,
        "front_wheels_mps": 20.0,
        "rear_wheels_mps": 20.0,
    }.items():
        assert getattr(motion, name) == pytest.approx(value, abs=1e-9), name
    assert motion.silent == frozenset()


def test_weights_add_up_to_one_sample_per_mean_inside_and_none_outside():
    motion = sensed()
    assert motion.counted_weight.sum() == pytest.approx(INSIDE.sum() / 20.0, abs=1.0)
    assert (motion.counted_weight[~motion.inside] == 0.0).all()
    assert motion.inside.sum() < len(motion.inside)


@given(from_s=st.floats(0.0, 8.0), duration_s=st.floats(0.02, 4.0))
def test_wherever_the_section_lies_there_is_a_sample_of_it(from_s, duration_s):
    inside = (from_s <= TIME_S) & (from_s + duration_s > TIME_S)
    motion = sensed(inside=inside)
    for of in fields(motion):
        value = getattr(motion, of.name)
        if isinstance(value, np.ndarray):
            assert value.shape == motion.inside.shape
            assert np.isfinite(value).all()
    assert duration_s < 0.2 or motion.inside.any()


def test_a_long_passage_is_sampled_more_coarsely():
    inside = np.ones(30_000, dtype=bool)
    motion = sensed(inside=inside)
    assert 0.8 * SAMPLES_LIMIT_COUNT < len(motion.inside) <= SAMPLES_LIMIT_COUNT
    assert motion.counted_weight.max() == 1.0


def test_what_is_far_from_the_section_does_not_matter():
    rng = np.random.default_rng(2)
    noise = rng.normal(size=COUNT)
    near = np.convolve(INSIDE, np.ones(2 * 95 + 1), mode="same") > 0.0
    here, there = (
        sensed(yaw_rate_radps=0.1 + 0.01 * noise, accel_y_mps2=2.0 + 0.1 * other)
        for other in (noise, np.where(near, noise, 50.0))
    )
    for of in fields(here):
        value = getattr(here, of.name)
        if isinstance(value, np.ndarray):
            assert getattr(there, of.name) == pytest.approx(value, rel=1e-9, abs=1e-9), of.name


def test_a_body_that_leans_and_nods_feels_more_than_the_tyres_bear():
    motion = sensed(accel_x_mps2=np.full(COUNT, -3.0))
    assert motion.force_x_mps2 == pytest.approx(-3.0 / NODDING)
    assert motion.force_y_mps2 == pytest.approx(2.0)


@pytest.mark.parametrize("level_gain_ratio", [0.0, 0.7, 1.0])
def test_the_level_of_the_force_is_drawn_to_turning_and_map(level_gain_ratio):
    offset = 0.2
    swing = np.sin(TIME_S)
    accel_y = (2.0 + swing + offset) * LEANING
    motion = sensed(accel_y_mps2=accel_y, yaw_rate_radps=(2.0 + swing) / 20.0, level_gain_ratio=level_gain_ratio)
    counted = motion.inside
    mean = float((2.0 + swing)[INSIDE].mean())
    assert motion.force_y_mps2[counted].mean() - mean == pytest.approx(offset * (1.0 - level_gain_ratio), abs=0.02)
    # How it changes stays the accelerometer's.
    assert np.ptp(motion.force_y_mps2[counted]) == pytest.approx(np.ptp(swing[INSIDE]), rel=0.02)


def test_a_bank_bears_and_pulls():
    slope = 0.06
    banked = road(s_turn, cross_slope_ratio=slope)
    # Left edge up in a left turn: banked outwards, the road bears less.
    motion = sensed(section=banked)
    assert motion.bank_rad == pytest.approx(np.arctan(slope))
    assert motion.normal_mps2 == pytest.approx(GRAVITY_MPS2 * np.cos(np.arctan(slope)) - 2.0 * slope, rel=1e-6)


def test_no_car_is_lighter_than_it_can_be():
    motion = sensed(yaw_rate_radps=np.full(COUNT, 3.0), section=road(s_turn, cross_slope_ratio=0.12))
    assert motion.normal_mps2.min() >= NORMAL_MIN_MPS2


def test_at_standstill_the_speed_is_one_that_divisions_bear():
    assert sensed(speed_mps=np.zeros(COUNT)).speed_mps == pytest.approx(SPEED_MIN_MPS)


def test_without_accelerometers_turning_and_change_of_speed_stand_in():
    speed = 20.0 - 1.5 * TIME_S / TIME_S[-1] * 6.0
    blind = sensed(
        speed_mps=speed,
        accel_y_mps2=np.zeros(COUNT),
        accel_x_mps2=np.zeros(COUNT),
        absent=("accel_x_mps2", "accel_y_mps2"),
    )
    assert blind.force_y_mps2 == pytest.approx(0.1 * blind.speed_mps, rel=1e-9)
    assert blind.force_x_mps2 == pytest.approx(-9.0 / TIME_S[-1], rel=1e-6)
    assert blind.silent == set(Evidence)


@pytest.mark.parametrize(
    ("absent", "silent"),
    [
        ((), set()),
        (("roll_rate_radps",), set()),
        (("steer_rad",), {Evidence.STEERING, Evidence.WHEELS}),
        (("wheel_front_left_mps", "wheel_front_right_mps"), {Evidence.WHEELS}),
        (("accel_x_mps2",), {Evidence.WHEELS}),
        (("accel_y_mps2", "roll_rate_radps"), set(Evidence)),
        (("yaw_rate_radps",), set(Evidence)),
    ],
)
def test_what_needs_an_absent_sensor_is_silent(absent, silent):
    assert silent_without(absent) == silent

"""What a vehicle knows of itself, as a file."""

from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.errors import ConfigurationError
from vehicle_client.estimation.filters import LowPass
from vehicle_client.estimation.observer import XC90_PARAMETERS, ObserverParameters
from vehicle_client.vehicle_profile import PAPER_VEHICLE, profile_of_toml, toml_of_profile

SHORTEST = "[geometry]\nwheelbase_m = 2.6\ntrack_m = 1.5\nfront_axle_m = 1.2\n"
NUMBERS = [field.name for field in fields(ObserverParameters) if field.name != "lowpass"]


@given(
    name=st.text(st.characters(codec="utf-8"), max_size=30),
    values=st.lists(st.floats(1e-6, 1e6), min_size=len(NUMBERS), max_size=len(NUMBERS)),
    lowpass=st.sampled_from(LowPass),
)
def test_a_vehicle_comes_back_from_its_file(name, values, lowpass):
    parameters = ObserverParameters(**dict(zip(NUMBERS, values, strict=True)), lowpass=lowpass)
    profile = replace(PAPER_VEHICLE, name=name, parameters=parameters)
    assert profile_of_toml(toml_of_profile(profile), place="car.toml") == profile


def test_what_is_not_said_is_as_in_the_papers_car():
    profile = profile_of_toml(SHORTEST, place="car.toml")
    assert profile.parameters == XC90_PARAMETERS
    assert profile.geometry.imu_x_m == 0.0
    assert profile.name == "car.toml"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[geometry", "no TOML"),
        ("", "front_axle_m, track_m, wheelbase_m must be said"),
        (SHORTEST + "wheels = 4\n", "unknown wheels"),
        ("[motor]\n" + SHORTEST, "unknown motor"),
        (SHORTEST.replace("2.6", '"long"'), "not a finite number"),
        (SHORTEST.replace("2.6", "nan"), "not a finite number"),
        (SHORTEST.replace("2.6", "true"), "not a finite number"),
        (SHORTEST.replace("2.6", "1.0"), "front axle"),
        (SHORTEST.replace("1.5", "0.0"), "front axle"),
        (SHORTEST + "[observer]\nalpha = 3\n", "unknown alpha"),
        (SHORTEST + '[observer]\nlowpass = "bessel"\n', "not one of hamming_fir, butterworth"),
        (SHORTEST + "[observer]\nlowpass = [1]\n", "not one of"),
        (SHORTEST.replace("1.2", "2.6"), "front axle"),
        (SHORTEST.replace("1.2", "0.0"), "front axle"),
        ("geometry = 5", "not a table"),
        ("geometry = ['track_m']", "not a table"),
        ("name = 5\n" + SHORTEST, "not a text"),
        (SHORTEST + "imu_yaw_rad = 1.57\n", "on its side"),
        (SHORTEST + "imu_roll_rad = -1.57\n", "on its side"),
        (SHORTEST + "[observer]\nroll_crossover_hz = 0\n", "roll_crossover_hz is 0.0, but must be positive"),
        (SHORTEST + "[observer]\nsigma_steer_rad = 0\n", "must be positive"),
        (SHORTEST + "[observer]\nalpha_0_1ps = -15\n", "must be zero or positive"),
    ],
)
def test_what_is_no_vehicle_is_refused_and_says_why(text, message):
    with pytest.raises(ConfigurationError, match=message):
        profile_of_toml(text, place="car.toml")


def test_zero_is_a_constant_where_nothing_is_divided_by_it():
    profile = profile_of_toml(SHORTEST + "[observer]\ngrip_pull_ratio = 0\n", place="car.toml")
    assert profile.parameters.grip_pull_ratio == 0.0


def test_a_sensor_may_look_backwards():
    assert profile_of_toml(SHORTEST + "imu_yaw_rad = 3.14159\n", place="car.toml").geometry.imu_yaw_rad == 3.14159

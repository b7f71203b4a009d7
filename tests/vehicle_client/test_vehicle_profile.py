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
    name=st.text(st.characters(codec="utf-8", categories=("L", "N", "P", "Zs")), min_size=1, max_size=30),
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
    ],
)
def test_what_is_no_vehicle_is_refused_and_says_why(text, message):
    with pytest.raises(ConfigurationError, match=message):
        profile_of_toml(text, place="car.toml")

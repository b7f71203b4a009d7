"""What a vehicle knows of itself, as a file."""

import tomllib
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.errors import ConfigurationError
from vehicle_client.estimation.filters import LowPass
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE, GripNoise
from vehicle_client.estimation.handling import XC90_HANDLING, Handling, TyreCurve
from vehicle_client.estimation.observer import XC90_PARAMETERS, ObserverParameters
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.vehicle_profile import (
    PAPER_VEHICLE,
    profile_of_toml,
    scaled_to,
    toml_of_profile,
    vehicle_digest,
)

SHORTEST = "[geometry]\nwheelbase_m = 2.6\ntrack_m = 1.5\nfront_axle_m = 1.2\n"
NUMBERS = [field.name for field in fields(ObserverParameters) if field.name != "lowpass"]
SHARES = {"front_drive_frac", "front_brake_frac", "level_gain_ratio"}


def declared(kind):
    """Draw a record of declared constants: all positive, shares at most one."""
    drawn = {
        field.name: declared(TyreCurve)
        if field.name == "tyre"
        else st.floats(1e-6, 1.0 if field.name in SHARES else 1e6)
        for field in fields(kind)
    }
    return st.builds(kind, **drawn)


@given(
    name=st.text(st.characters(codec="utf-8"), max_size=30),
    values=st.lists(st.floats(1e-6, 1e6), min_size=len(NUMBERS), max_size=len(NUMBERS)),
    lowpass=st.sampled_from(LowPass),
    handling=declared(Handling),
    noise=declared(GripNoise),
    handling_std_ratio=st.floats(0.001, 0.5),
)
def test_a_vehicle_comes_back_from_its_file(values, lowpass, **declared):
    parameters = ObserverParameters(**dict(zip(NUMBERS, values, strict=True)), lowpass=lowpass)
    profile = replace(PAPER_VEHICLE, parameters=parameters, **declared)
    assert profile_of_toml(toml_of_profile(profile), place="car.toml") == profile


def test_a_digest_knows_everything_but_the_name():
    known = vehicle_digest(PAPER_VEHICLE)
    assert vehicle_digest(replace(PAPER_VEHICLE, name="our red one")) == known
    others = [
        replace(PAPER_VEHICLE, geometry=replace(XC90, track_m=1.6)),
        replace(PAPER_VEHICLE, parameters=replace(XC90_PARAMETERS, lowpass=LowPass.BUTTERWORTH)),
        replace(PAPER_VEHICLE, handling=scaled_to(2000.0)),
        replace(PAPER_VEHICLE, noise=replace(AUTOMOTIVE_NOISE, steer_rad=0.001)),
        replace(PAPER_VEHICLE, handling_std_ratio=0.02),
    ]
    assert len({known, *map(vehicle_digest, others)}) == 6


def test_what_is_not_said_is_as_in_the_papers_car():
    profile = profile_of_toml(SHORTEST, place="car.toml")
    assert profile.parameters == XC90_PARAMETERS
    assert profile.handling == XC90_HANDLING
    assert profile.noise == AUTOMOTIVE_NOISE
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
        (SHORTEST + "[handling]\nwings = 2\n", "unknown wings"),
        (SHORTEST + "[handling]\nmass_kg = 0\n", "mass_kg is 0.0, but must be positive"),
        (SHORTEST + '[handling]\nmass_kg = "heavy"\n', "not a finite number"),
        (SHORTEST + "[handling]\nfront_drive_frac = 1.2\n", "at most 1"),
        (SHORTEST + "[handling]\ndrag_kgpm = -1\n", "must be zero or positive"),
        (SHORTEST + "[handling]\ntyre = 5\n", "tyre is 5, not a table"),
        (SHORTEST + "[handling.tyre]\nstiffness_ratio = 0\n", "stiffness_ratio is 0.0, but must be positive"),
        (SHORTEST + "[handling.tyre]\nrubber = 1\n", "unknown rubber"),
        ("handling = 5\n" + SHORTEST, "not a table"),
        ("memory = 5\n" + SHORTEST, "not a table"),
        (SHORTEST + "[memory]\npassages = 5\n", "unknown passages"),
        (SHORTEST + "[memory]\nhandling_std_ratio = 0\n", "not from 0.0001 to 0.5"),
        (SHORTEST + '[memory]\nhandling_std_ratio = "well"\n', "not a finite number"),
        (SHORTEST + "[noise]\nsteer_rad = 0\n", "steer_rad is 0.0, but must be positive"),
        (SHORTEST + "[noise]\nlevel_gain_ratio = 1.5\n", "at most 1"),
        (SHORTEST + "[noise]\nloudness = 1\n", "unknown loudness"),
    ],
)
def test_what_is_no_vehicle_is_refused_and_says_why(text, message):
    with pytest.raises(ConfigurationError, match=message):
        profile_of_toml(text, place="car.toml")


def test_what_is_said_of_masses_tyres_and_sensors_is_taken_and_the_rest_stays():
    text = (
        SHORTEST
        + "[handling]\nfront_drive_frac = 1\n[handling.tyre]\nstiffness_ratio = 17\n[noise]\nsteer_rad = 2e-3\n"
    )
    profile = profile_of_toml(text, place="car.toml")
    tyre = replace(XC90_HANDLING.tyre, stiffness_ratio=17.0)
    assert profile.handling == replace(XC90_HANDLING, front_drive_frac=1.0, tyre=tyre)
    assert profile.noise == replace(AUTOMOTIVE_NOISE, steer_rad=2e-3)


def test_a_car_of_which_only_the_mass_is_said_slips_like_the_papers():
    light = profile_of_toml(SHORTEST + "[handling]\nmass_kg = 1400\n", place="car.toml").handling
    assert light == scaled_to(1400.0)
    assert scaled_to(XC90_HANDLING.mass_kg) == XC90_HANDLING
    ratio = 1400.0 / XC90_HANDLING.mass_kg
    assert light.tyre.nominal_load_n == pytest.approx(ratio * XC90_HANDLING.tyre.nominal_load_n)
    assert light.steer_compliance_radpn * light.mass_kg == pytest.approx(
        XC90_HANDLING.steer_compliance_radpn * XC90_HANDLING.mass_kg
    )
    said = SHORTEST + "[handling]\nmass_kg = 1400\nyaw_inertia_kgm2 = 2000\n[handling.tyre]\nnominal_load_n = 3300\n"
    heard = profile_of_toml(said, place="car.toml").handling
    assert heard.yaw_inertia_kgm2 == 2000.0
    assert heard.tyre.nominal_load_n == 3300.0


def test_zero_is_a_constant_where_nothing_is_divided_by_it():
    profile = profile_of_toml(SHORTEST + "[observer]\ngrip_pull_ratio = 0\n", place="car.toml")
    assert profile.parameters.grip_pull_ratio == 0.0


def test_a_sensor_may_look_backwards():
    assert profile_of_toml(SHORTEST + "imu_yaw_rad = 3.14159\n", place="car.toml").geometry.imu_yaw_rad == 3.14159


def test_the_page_shows_every_constant_that_may_be_declared(project_root):
    page = (project_root / "docs" / "vehicle.md").read_text(encoding="utf-8")
    section = page[page.index("## What the physical inverse is told") :]
    text = section[section.index("```toml") + len("```toml") : section.index("```", section.index("```toml") + 3)]
    shown = tomllib.loads(text)
    assert set(shown["handling"]) == {field.name for field in fields(Handling)}
    assert set(shown["handling"]["tyre"]) == {field.name for field in fields(TyreCurve)}
    profile = profile_of_toml(SHORTEST + text, place="vehicle.md")
    assert profile.handling != XC90_HANDLING

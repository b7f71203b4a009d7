"""The file signals.toml: what it says, and how it is told what is wrong with it."""

import math
from importlib.resources import files

import numpy as np
import pytest

from roadgrip.errors import ConfigurationError
from vehicle_client.recording.channels import CHANNELS
from vehicle_client.recording.signal_mapping import TABLES, checked_against, signal_mapping_of_toml

EXAMPLE = (files("vehicle_client.shell.can") / "example" / "signals.toml").read_text(encoding="utf-8")


def mapping(text=EXAMPLE):
    return signal_mapping_of_toml(text, place="car.toml")


def source(text, table):
    return next(one for one in mapping(text).sources if one.table == table)


def test_the_packaged_example_knows_every_sensor():
    assert {one.channel for one in mapping().sources} >= set(CHANNELS)
    assert mapping().missing == ()


def test_every_table_leads_to_a_channel_of_its_own():
    assert len({channel for channel, _ in TABLES.values()}) == len(TABLES)


@pytest.mark.parametrize(
    ("unit", "theirs", "ours"),
    [
        ("km/h", 72.0, 20.0),
        ("m/s", 20.0, 20.0),
        ("mph", 10.0, 4.4704),
        ("rpm", 60.0, 2.0 * math.pi * 0.35),
        ("rad/s", 2.0, 0.7),
    ],
)
def test_wheel_speeds_come_in_many_units(unit, theirs, ours):
    text = "rolling_radius_m = 0.35\n" + EXAMPLE.replace('"km/h"', f'"{unit}"')
    assert source(text, "wheel_rear_left").converted(np.array([theirs])) == pytest.approx([ours])


@pytest.mark.parametrize(("unit", "theirs", "ours"), [("g", 1.0, 9.80665), ("m/s2", 2.0, 2.0)])
def test_accelerations_come_in_two_units(unit, theirs, ours):
    text = EXAMPLE.replace('"m/s2"', f'"{unit}"')
    assert source(text, "accel_y").converted(np.array([theirs])) == pytest.approx([ours])


def test_gain_and_offset_are_in_the_unit_that_is_named():
    text = EXAMPLE.replace('signal = "YawRate"', 'signal = "YawRate"\ngain = -1.0\noffset = 90.0')
    assert source(text, "yaw_rate").converted(np.array([0.0, 90.0])) == pytest.approx([math.pi / 2.0, 0.0])


def test_the_steering_wheel_is_divided_by_its_ratio():
    assert source(EXAMPLE, "steer").converted(np.array([168.0])) == pytest.approx([np.deg2rad(10.0)])


def test_a_table_of_steering_angles_is_followed_and_undone():
    text = EXAMPLE.replace("steering_ratio = 16.8", "steering_table_deg = [[-400, -30], [0, 0], [400, 25]]")
    steer = source(text, "steer")
    assert steer.converted(np.array([-200.0, 400.0, 9e9])) == pytest.approx(np.deg2rad([-15.0, 25.0, 25.0]))
    assert steer.inverted(np.deg2rad([-15.0, 12.5])) == pytest.approx([-200.0, 200.0])


@pytest.mark.parametrize(
    ("old", "new", "needles"),
    [
        ("[yaw_rate]", "[yawrate]", ["unknown yawrate", "did you mean yaw_rate"]),
        ('unit = "km/h"', 'unit = "kmh"', ["[wheel_front_left] unit", "'kmh'", "m/s, km/h, mph", "did you mean km/h"]),
        ('unit = "km/h"', 'unit = "rpm"', ["[wheel_front_left] unit", "rolling_radius_m"]),
        ('unit = "deg/s"', "", ["[roll_rate]: unit must be said", "rad/s, deg/s"]),
        ('signal = "YawRate"', "", ["[yaw_rate]: signal must be said"]),
        (
            'signal = "YawRate"',
            'signal = "YawRate"\nGain = 2',
            ["[yaw_rate]: unknown Gain", "did you mean gain", "offset"],
        ),
        ('signal = "YawRate"', 'signal = "YawRate"\ngain = 0', ["[yaw_rate] gain", "zero"]),
        ('signal = "YawRate"', 'signal = "YawRate"\noffset = "x"', ["[yaw_rate] offset", "no finite number"]),
        ('signal = "YawRate"', 'signal = "YawRate"\nvalid_when = "yes"', ["[yaw_rate]: valid_when must be like"]),
        ("steering_ratio = 16.8", "steering_ratio = -16.8", ["[steer] steering_ratio", "gain = -1"]),
        ("steering_ratio = 16.8", "steering_table_deg = [[1, 1], [0, 2]]", ["steering_table_deg must be pairs"]),
        ("steering_ratio = 16.8", "steering_ratio = 1\nsteering_table_deg = [[0, 0], [1, 1]]", ["not both"]),
        ('dbc = "roadgrip-example.dbc"', "", ["either dbc", "time_column"]),
        ('dbc = "roadgrip-example.dbc"', "dbc = 3", ["dbc must be text"]),
        ('dbc = "roadgrip-example.dbc"', "dbc = ", ["is no TOML"]),
        ('[latitude]\nmessage = "GnssPosition"\nsignal = "Latitude"\nunit = "deg"', "", ["[latitude] and [longitude]"]),
    ],
)
def test_what_is_wrong_is_named_with_what_is_allowed(old, new, needles):
    assert old in EXAMPLE
    with pytest.raises(ConfigurationError) as refusal:
        mapping(EXAMPLE.replace(old, new, 1))
    assert all(needle in str(refusal.value) for needle in ["car.toml", *needles]), str(refusal.value)


def test_a_sensor_that_is_left_out_is_named_unless_it_is_roll():
    def without(table):
        head, _, rest = EXAMPLE.partition(f"[{table}]")
        return head + rest[rest.index("\n\n") :]

    assert mapping(without("roll_rate")).missing == ("roll_rate_radps",)
    with pytest.raises(ConfigurationError, match=r"no \[yaw_rate\]"):
        mapping(without("yaw_rate"))


SIGNALS = {
    "Inertial": ["AccelForward", "AccelLeft", "RollRate", "YawRate"],
    "Steering": ["SteeringWheelAngle"],
    "WheelSpeeds": ["WheelFrontLeft", "WheelFrontRight", "WheelRearLeft", "WheelRearRight"],
    "StabilityControl": ["Intervention"],
    "GnssPosition": ["Latitude", "Longitude"],
    "GnssQuality": ["Accuracy", "SpeedOverGround"],
}


@pytest.mark.parametrize(
    ("old", "new", "needles"),
    [
        ('signal = "YawRate"', 'signal = "yawrate"', ["[yaw_rate] signal", "'yawrate'", "did you mean YawRate"]),
        (
            'message = "Steering"',
            'message = "Steerin"',
            ["[steer] message", "did you mean Steering", "'SteeringWheelAngle'"],
        ),
        ('signal = "YawRate"', 'signal = "Latitude"', ["[yaw_rate] signal", "message GnssPosition has one"]),
    ],
)
def test_names_that_the_dbc_does_not_know_are_told_with_the_nearest(old, new, needles):
    wrong = mapping(EXAMPLE.replace(old, new, 1))
    with pytest.raises(ConfigurationError) as refusal:
        checked_against(wrong, SIGNALS, dbc="car.dbc")
    assert all(needle in str(refusal.value) for needle in ["car.dbc", *needles]), str(refusal.value)

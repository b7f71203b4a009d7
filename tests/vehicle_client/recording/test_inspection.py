"""A recording whose channels are broken one by one, and each time the right one is named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roadgrip.units import SAMPLE_S
from tests.vehicle_client.synthetic import drive_over, fixes_of, road, s_turn, surveyed, with_noise
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.recording.channels import WHEEL_COLUMNS
from vehicle_client.recording.csv_table import columns_of_csv
from vehicle_client.recording.foreign import ColumnMapping, Recording, recording_of_columns
from vehicle_client.recording.inspection import Verdict, inspect_trace
from vehicle_client.recording.public import COMMA2K19_RAV4, FERRARI_250LM, IAC_AV21

DATA = Path(__file__).parents[4] / "shared" / "data" / "vehicle"
DEG = 180.0 / np.pi
SWAPPED = [1, 0, 3, 2]


def recorded(*, with_fixes=False) -> Trace:
    """A noisy drive over a road with two curves, with a body that leans and a speed that changes."""
    trace, station = drive_over(s_turn, swing_mps=3.0)
    lean_rad = 0.01 * np.convolve(trace.accel_y_mps2, np.full(21, 1.0 / 21.0), mode="same")
    trace = with_noise(replace(trace, roll_rate_radps=np.gradient(lean_rad, SAMPLE_S)), np.random.default_rng(1))
    if not with_fixes:
        return trace
    fixes = fixes_of(surveyed(road(s_turn)), trace.time_s, station, rng=np.random.default_rng(2), noise_m=0.3)
    return replace(trace, gnss=fixes)


DRIVES = {"without positions": recorded(), "with positions": recorded(with_fixes=True)}


def off(trace: Trace) -> dict[str, str]:
    return {f.channel: f.hint for f in inspect_trace(trace, XC90) if f.verdict is Verdict.OFF}


@pytest.mark.parametrize("name", DRIVES)
def test_a_sound_recording_is_found_sound_in_every_channel(name):
    findings = {f.channel: f.verdict for f in inspect_trace(DRIVES[name], XC90)}
    assert findings.pop("positions") is (Verdict.OK if "with " in name else Verdict.ABSENT)
    assert set(findings.values()) == {Verdict.OK}


@pytest.mark.parametrize("name", DRIVES)
@pytest.mark.parametrize(
    ("channel", "gain", "needle"),
    [
        ("accel_x_mps2", -1.0, "forward axis is turned round: gain = -1"),
        ("accel_x_mps2", 1.0 / 9.81, 'unit = "g"'),
        ("accel_y_mps2", -1.0, "lateral axis is turned round: gain = -1"),
        ("accel_y_mps2", 1.0 / 9.81, 'unit = "g"'),
        ("yaw_rate_radps", -1.0, "gain = -1"),
        ("yaw_rate_radps", DEG, 'unit = "deg/s"'),
        ("roll_rate_radps", -1.0, "gain = -1"),
        ("steer_rad", -1.0, "gain = -1"),
        ("steer_rad", DEG, 'unit = "deg"'),
        ("steer_rad", 15.8, "steering_ratio = 1"),
        ("steer_rad", 15.8 * DEG, 'unit = "deg", steering_ratio = 1'),
        ("steer_rad", 3.5, "check unit and steering_ratio"),
        ("steer_rad", 0.0, "never changes"),
    ],
)
def test_a_channel_that_is_misread_is_named_alone(name, channel, gain, needle):
    trace = DRIVES[name]
    found = off(replace(trace, **{channel: gain * getattr(trace, channel)}))
    assert set(found) == {channel}
    assert needle in found[channel]


def test_a_steering_ratio_is_guessed_to_a_quarter():
    trace = DRIVES["without positions"]
    hint = off(replace(trace, steer_rad=15.8 * trace.steer_rad))["steer_rad"]
    assert float(hint.split("steering_ratio = ")[1].split(",")[0]) == pytest.approx(15.8, rel=0.25)


@pytest.mark.parametrize("name", DRIVES)
@pytest.mark.parametrize(("unit", "gain"), [("km/h", 3.6), ("mph", 2.237), ("rpm", 60.0 / (2.0 * np.pi * 0.33))])
def test_wheel_speeds_in_another_unit_are_named(name, unit, gain):
    trace = DRIVES[name]
    found = off(replace(trace, wheel_speed_mps=gain * trace.wheel_speed_mps))
    assert set(found) == set(WHEEL_COLUMNS)
    assert all(f'unit = "{unit}"' in hint for hint in found.values())


@pytest.mark.parametrize("name", DRIVES)
@pytest.mark.parametrize(
    ("order", "axles"), [([1, 0, 2, 3], ["front"]), ([0, 1, 3, 2], ["rear"]), (SWAPPED, ["front", "rear"])]
)
def test_wheels_that_are_exchanged_are_named(name, order, axles):
    trace = DRIVES[name]
    found = off(replace(trace, wheel_speed_mps=trace.wheel_speed_mps[:, order]))
    assert set(found) == {column for column in WHEEL_COLUMNS if any(axle in column for axle in axles)}
    assert all("left and right are exchanged" in hint for hint in found.values())


def test_one_wheel_in_a_unit_of_its_own_is_named():
    trace = DRIVES["without positions"]
    wheels = trace.wheel_speed_mps * np.array([1.0, 1.0, 1.0, 3.6])
    assert "3.60 times the other wheels" in off(replace(trace, wheel_speed_mps=wheels))["wheel_rear_right_mps"]


def test_accelerations_that_are_exchanged_are_named_together():
    trace = DRIVES["with positions"]
    found = off(replace(trace, accel_x_mps2=trace.accel_y_mps2, accel_y_mps2=trace.accel_x_mps2))
    assert set(found) == {"accel_x_mps2", "accel_y_mps2"}
    assert all("look exchanged" in hint for hint in found.values())


def test_a_channel_that_is_another_signal_is_named():
    trace = DRIVES["without positions"]
    found = off(replace(trace, yaw_rate_radps=trace.roll_rate_radps))
    assert "another axis" in found["yaw_rate_radps"]


@pytest.mark.parametrize(("channel", "code"), [("steer_rad", 57.2), ("yaw_rate_radps", 5.7), ("accel_y_mps2", -65.0)])
def test_a_number_that_means_not_available_is_named_before_anything_else(channel, code):
    trace = DRIVES["with positions"]
    values = getattr(trace, channel).copy()
    values[500:502] = code
    found = off(replace(trace, **{channel: values}))
    assert set(found) == {channel}
    assert "invalid" in found[channel]


@pytest.mark.parametrize("name", DRIVES)
@pytest.mark.parametrize("channel", ["yaw_rate_radps", "steer_rad", "accel_y_mps2"])
def test_a_channel_without_its_sign_is_named(name, channel):
    trace = DRIVES[name]
    found = off(replace(trace, **{channel: np.abs(getattr(trace, channel))}))
    assert set(found) == {channel}
    assert "negative_when" in found[channel]


def test_two_misreadings_at_once_are_both_named():
    trace = DRIVES["without positions"]
    found = off(replace(trace, yaw_rate_radps=-DEG * trace.yaw_rate_radps, wheel_speed_mps=3.6 * trace.wheel_speed_mps))
    assert set(found) == {"yaw_rate_radps", *WHEEL_COLUMNS}
    assert "gain = -1" in found["yaw_rate_radps"]
    assert 'unit = "deg/s"' in found["yaw_rate_radps"]


def test_a_car_seen_in_a_mirror_is_told_by_its_positions_alone():
    def mirrored(trace):
        return replace(
            trace,
            accel_y_mps2=-trace.accel_y_mps2,
            yaw_rate_radps=-trace.yaw_rate_radps,
            roll_rate_radps=-trace.roll_rate_radps,
            steer_rad=-trace.steer_rad,
            wheel_speed_mps=trace.wheel_speed_mps[:, SWAPPED],
        )

    assert off(mirrored(DRIVES["without positions"])) == {}
    assert {"yaw_rate_radps", "accel_y_mps2", "steer_rad"} <= set(off(mirrored(DRIVES["with positions"])))


def test_a_straight_drive_shows_little_and_accuses_nobody():
    trace, _ = drive_over(lambda station_m: 0.0 * station_m)
    findings = inspect_trace(with_noise(trace, np.random.default_rng(3)), XC90)
    assert {f.verdict for f in findings} <= {Verdict.NOT_JUDGED, Verdict.ABSENT}


def test_a_car_that_stands_accuses_nobody():
    trace, _ = drive_over(lambda station_m: 0.0 * station_m)
    standing = with_noise(replace(trace, wheel_speed_mps=0.01 * trace.wheel_speed_mps), np.random.default_rng(3))
    assert off(standing) == {}


def test_what_is_mostly_missing_is_named():
    trace = DRIVES["without positions"]
    valid = np.arange(trace.samples_count) % 100 > 10
    assert all("is not there" in hint for hint in off(replace(trace, valid=valid)).values())
    assert len(off(replace(trace, valid=valid))) == 9


RECORDED = {
    "revs_ferrari250lm_20140222_01_01_03": FERRARI_250LM,
    "iac_av21_putnam_2023_run4_2": IAC_AV21,
    "comma2k19_rav4_example1_seg40": COMMA2K19_RAV4,
}


@pytest.fixture(scope="module", params=RECORDED)
def others(request) -> tuple[Recording, ColumnMapping]:
    path, mapping = DATA / f"{request.param}.csv.gz", RECORDED[request.param]
    if not path.exists():
        pytest.skip(f"no recording {path.name} beside the checkout")
    return recording_of_columns(columns_of_csv(path.read_bytes(), place=path.name), mapping, place=path.name), mapping


def test_cars_that_others_recorded_are_read_rightly(others):
    recording, mapping = others
    findings = {f.channel: f for f in inspect_trace(recording.trace, mapping.vehicle)}
    assert {f.channel: f.hint for f in findings.values() if f.verdict is Verdict.OFF} == {}
    assert findings["yaw_rate_radps"].verdict is Verdict.OK
    assert {name for name, f in findings.items() if f.verdict is Verdict.ABSENT} - {"positions"} == set(
        recording.missing
    )


@pytest.mark.parametrize(
    ("channel", "gain"),
    [
        ("yaw_rate_radps", -1.0),
        ("yaw_rate_radps", DEG),
        ("accel_y_mps2", -1.0),
        ("accel_x_mps2", -1.0),
        ("accel_x_mps2", 1.0 / 9.81),
        ("steer_rad", -1.0),
        ("steer_rad", 16.0 * DEG),
        ("roll_rate_radps", -1.0),
    ],
)
def test_a_channel_of_theirs_that_is_misread_is_named_alone(others, channel, gain):
    recording, mapping = others
    if channel in recording.missing:
        pytest.skip(f"the car has no {channel}")
    broken = replace(recording.trace, **{channel: gain * getattr(recording.trace, channel)})
    assert {f.channel for f in inspect_trace(broken, mapping.vehicle) if f.verdict is Verdict.OFF} == {channel}

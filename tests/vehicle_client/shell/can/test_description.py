"""A DBC and a mapping together: which frames are read, and how."""

import math

import pytest

from roadgrip.errors import ConfigurationError
from tests.vehicle_client.shell.can.cars import mapping
from vehicle_client.recording.frames import values_of_frame
from vehicle_client.shell.can.description import read_can_mapping


def values(car, frame_id, data, *, extended=False, bus=""):
    return {
        source.channel: value
        for layout in car.layouts_of(frame_id, extended=extended, bus=bus)
        for source, value in values_of_frame(layout, data)
    }


def test_a_frame_that_is_not_mapped_has_nothing(tmp_path):
    car = mapping(tmp_path)
    assert car.layouts_of(0x101, extended=True, bus="") == ()
    assert car.layouts_of(0x7FF, extended=False, bus="") == ()
    assert set(car.frame_ids) == {(i, False) for i in (0x101, 0x102, 0x120, 0x130, 0x140, 0x141)}


def test_names_of_values_are_taken_from_the_dbc(tmp_path):
    car = mapping(tmp_path)
    assert values(car, 0x130, b"\x01\x00") == {"stability_active": 1.0}
    assert math.isnan(values(car, 0x130, b"\x03\x00")["stability_active"])
    with pytest.raises(ConfigurationError, match=r"\[stability\] active.*'Activ'.*did you mean Active"):
        mapping(tmp_path, ('active = "Active"', 'active = "Activ"'))


def test_all_bits_set_means_nothing_in_a_signal_without_sign_only(tmp_path):
    assert math.isnan(values(mapping(tmp_path), 0x102, b"\xff\xff\x00\x00")["steer_rad"])
    with pytest.raises(ConfigurationError, match=r"\[steer\] invalid.*has a sign"):
        mapping(tmp_path, dbc_changes=(("7|16@0+", "7|16@0-"),))


def test_a_signal_beside_it_may_say_whether_a_value_holds(tmp_path):
    car = mapping(
        tmp_path,
        (
            'signal = "SteeringWheelAngle"',
            'signal = "SteeringWheelAngle"\nvalid_when = { signal = "AngleState", is = ["Good"] }',
        ),
        dbc_changes=(
            (" SG_ SteeringWheelAngle", ' SG_ AngleState : 16|2@1+ (1,0) [0|3] "" Recorder\n SG_ SteeringWheelAngle'),
            ("VAL_ 304", 'VAL_ 258 AngleState 2 "Good" 0 "Starting" ;\nVAL_ 304'),
        ),
    )
    assert values(car, 0x102, b"\x80\x10\x02\x00") == pytest.approx({"steer_rad": math.radians(1.0 / 16.8)})
    assert math.isnan(values(car, 0x102, b"\x80\x10\x00\x00")["steer_rad"])


def test_a_multiplexed_signal_is_read_where_it_is(tmp_path):
    car = mapping(
        tmp_path,
        dbc_changes=(
            (" SG_ Accuracy : 0|16@1+", ' SG_ Page M : 0|8@1+ (1,0) [0|255] "" Recorder\n SG_ Accuracy m1 : 8|16@1+'),
            ("SpeedOverGround : 16|16@1+", "SpeedOverGround m2 : 8|16@1+"),
        ),
    )
    assert values(car, 0x141, b"\x01\x64\x00\x00") == pytest.approx({"gnss_accuracy_m": 1.0})
    assert values(car, 0x141, b"\x02\x64\x00\x00") == pytest.approx({"gnss_speed_mps": 1.0})


def test_a_lorry_is_read_by_its_parameter_groups_whoever_sends_them(tmp_path):
    # 0x98F02921: priority 6, group 0xF029, from 0x21; the highest bit says that the identifier is an extended one.
    car = mapping(tmp_path, ('dbc = "', 'j1939 = true\ndbc = "'), dbc_changes=(("BO_ 258 ", f"BO_ {0x98F02921} "),))
    assert set(values(car, 0x0CF0290B, b"\x80\x10\x00\x00", extended=True)) == {"steer_rad"}
    assert values(car, 0x0CF02A0B, b"\x80\x10\x00\x00", extended=True) == {}
    assert car.frame_ids == ()


@pytest.mark.parametrize(
    ("changes", "needle"),
    [
        ((('dbc = "roadgrip-example.dbc"', 'dbc = "gone.dbc"'),), "cannot read .*gone.dbc"),
        ((('dbc = "roadgrip-example.dbc"', 'dbc = "signals.toml"'),), "cannot be understood"),
        ((('signal = "YawRate"', 'signal = "YawRat"'),), "did you mean YawRate"),
    ],
)
def test_a_dbc_that_does_not_fit_is_said(tmp_path, changes, needle):
    with pytest.raises(ConfigurationError, match=needle):
        mapping(tmp_path, *changes)


def test_a_mapping_that_is_not_there_is_said(tmp_path):
    with pytest.raises(ConfigurationError, match=r"cannot read .*none\.toml"):
        read_can_mapping(tmp_path / "none.toml")

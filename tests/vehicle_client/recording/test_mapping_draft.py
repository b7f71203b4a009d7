"""Drafts of `signals.toml` from the names and units of other people's DBCs."""

import pytest

from vehicle_client.recording.mapping_draft import DescribedSignal, candidates, mapping_draft, unit_of
from vehicle_client.recording.signal_mapping import signal_mapping_of_toml

GERMAN = (
    DescribedSignal("ESP_02", "ESP_Laengsbeschl", "m/s^2", 10),
    DescribedSignal("ESP_02", "ESP_Querbeschleunigung", "Unit_MeterPerSeconSquar", 8),
    DescribedSignal("ESP_02", "ESP_Gierrate", "Unit_DegreOfArcPerSecon", 14),
    DescribedSignal("ESP_02", "ESP_VZ_Gierrate", "", 1, choices=("positiv", "negativ")),
    DescribedSignal("LWI_01", "LWI_Lenkradwinkel", "Unit_DegreOfArc", 13),
    DescribedSignal("LWI_01", "LWI_Lenkradw_Geschw", "Unit_DegreOfArcPerSecon", 9),
    *(DescribedSignal("ESP_19", f"ESP_{at}_Radgeschw_02", "Unit_KiloMeterPerHour") for at in ("HL", "HR", "VL", "VR")),
)
AMERICAN = (
    DescribedSignal("KINEMATICS", "YAW_RATE", "deg/sec", 10),
    DescribedSignal("KINEMATICS", "STEERING_TORQUE", "Nm", 16),
    DescribedSignal("KINEMATICS", "ACCEL_Y", "m/s^2", 10),
    DescribedSignal("KINEMATICS", "ACCEL_X", "m/s^2", 10),
    DescribedSignal("STEER_ANGLE_SENSOR", "STEER_RATE", "deg/s", 12),
    DescribedSignal("STEER_ANGLE_SENSOR", "STEER_ANGLE", "deg", 12),
    *(DescribedSignal("WHEEL_SPEEDS", f"WHEEL_SPEED_{at}", "km/h") for at in ("FR", "FL", "RR", "RL")),
    DescribedSignal("GPS_POS", "GPSLatitude", "deg", 32),
    DescribedSignal("GPS_POS", "GPSLongitude", "deg", 32),
    DescribedSignal("BRAKES", "ABS_ACTIVE", "", 1),
)


def chosen(signals):
    text, missing = mapping_draft(signals, dbc="car.dbc")
    assert missing == ()
    mapping = signal_mapping_of_toml(text, place="signals.toml")
    return {source.table: source.signal for source in mapping.sources}


def test_a_draft_can_be_read_and_has_the_right_signals():
    got = chosen(AMERICAN)
    assert got == {
        "accel_x": "ACCEL_X",
        "accel_y": "ACCEL_Y",
        "yaw_rate": "YAW_RATE",
        "steer": "STEER_ANGLE",
        "wheel_front_left": "WHEEL_SPEED_FL",
        "wheel_front_right": "WHEEL_SPEED_FR",
        "wheel_rear_left": "WHEEL_SPEED_RL",
        "wheel_rear_right": "WHEEL_SPEED_RR",
        "abs": "ABS_ACTIVE",
        "latitude": "GPSLatitude",
        "longitude": "GPSLongitude",
    }


def test_another_language_is_understood_and_a_sign_is_shown_beside_its_signal():
    got = chosen(GERMAN)
    assert got["accel_y"] == "ESP_Querbeschleunigung"
    assert got["yaw_rate"] == "ESP_Gierrate"
    assert got["steer"] == "LWI_Lenkradwinkel"
    assert got["wheel_rear_left"] == "ESP_HL_Radgeschw_02"
    assert "# beside it: ESP_VZ_Gierrate (positiv, negativ)" in mapping_draft(GERMAN, dbc="car.dbc")[0]


def test_what_nothing_looks_like_is_said():
    text, missing = mapping_draft(AMERICAN[1:], dbc="car.dbc")
    assert missing == ("yaw_rate",)
    assert "#[yaw_rate]" in text


def test_the_next_likely_ones_are_comments():
    more = (*AMERICAN, DescribedSignal("CLUSTER", "YawRateFiltered", "deg/s", 12))
    assert [one.name for one in candidates(more, "yaw_rate")] == ["YAW_RATE", "YawRateFiltered"]
    assert "# or CLUSTER.YawRateFiltered (deg/s)" in mapping_draft(more, dbc="car.dbc")[0]


@pytest.mark.parametrize(
    ("said", "ours"),
    [("km/h", "km/h"), ("KPH", "km/h"), ("m/s²", "m/s2"), ("°/s", "deg/s"), ("Grad", "deg"), ("[g]", "g"), ("bar", "")],
)
def test_units_are_known_however_they_are_written(said, ours):
    assert unit_of(said) == ours

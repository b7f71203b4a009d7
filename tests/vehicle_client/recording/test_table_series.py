"""Tables with names and units of their own."""

import numpy as np
import pytest

from roadgrip.errors import ConfigurationError, TraceError
from vehicle_client.recording.series import trace_of_series
from vehicle_client.recording.signal_mapping import TABLES, SignalMapping, signal_mapping_of_toml
from vehicle_client.recording.table_series import series_of_columns

UNITS = {"accel_x": "g", "accel_y": "m/s2", "roll_rate": "deg/s", "yaw_rate": "deg/s", "steer": "deg"}
COUNT = 300


def mapping(**more: str) -> SignalMapping:
    lines = ['time_column = "t"']
    for table in list(TABLES)[:9]:
        lines += [f"[{table}]", f'column = "{table}"', f'unit = "{UNITS.get(table, "km/h")}"', more.get(table, "")]
    lines += ["[esc]", 'column = "esc"', more.get("esc", "")]
    return signal_mapping_of_toml("\n".join(lines), place="car.toml")


def columns():
    time_s = np.arange(COUNT) / 50.0
    return {"t": time_s, "esc": (time_s > 3.0) * 2.0} | {
        table: np.sin(time_s + i) for i, table in enumerate(list(TABLES)[:9])
    }


def test_columns_become_a_trace_in_our_units():
    table = columns()
    trace = trace_of_series(series_of_columns(table, mapping(), place="x.csv")).trace
    assert trace.accel_x_mps2[::2] == pytest.approx(9.80665 * table["accel_x"])
    assert trace.wheel_speed_mps[::2, 3] == pytest.approx(table["wheel_rear_right"] / 3.6)
    assert trace.stability_active is not None
    assert np.array_equal(trace.stability_active[::2], table["t"] > 3.0)


def test_an_empty_cell_is_no_value_and_an_invalid_one_is_not_known():
    table = columns()
    table["yaw_rate"][10] = np.nan
    table["steer"][20] = 999.0
    series = series_of_columns(table, mapping(steer="invalid = 999"), place="x.csv")
    assert len(series["yaw_rate_radps"].time_s) == COUNT - 1
    assert np.isnan(series["steer_rad"].values[20])


def test_a_column_beside_it_may_say_whether_a_value_holds():
    table = columns() | {"state": np.where(np.arange(COUNT) < 50, 0.0, 1.0)}
    series = series_of_columns(table, mapping(yaw_rate='valid_when = { signal = "state", is = [1] }'), place="x.csv")
    assert np.isnan(series["yaw_rate_radps"].values).sum() == 50


def test_a_column_beside_it_may_be_its_sign():
    table = columns()
    signed, right = table["steer"], np.where(table["steer"] < 0.0, 1.0, 0.0)
    table = table | {"steer": np.abs(signed), "right": right}
    more = 'negative_when = { signal = "right", is = [1] }'
    series = series_of_columns(table, mapping(steer=more), place="x.csv")
    assert series["steer_rad"].values == pytest.approx(np.radians(signed))


def test_a_flag_may_have_values_of_its_own():
    series = series_of_columns(columns(), mapping(esc="active = [1]"), place="x.csv")
    assert not series["esc_active"].values.any()


@pytest.mark.parametrize(
    ("more", "drop", "needle"),
    [
        ({}, "yaw_rate", r"\[yaw_rate\] column: x.csv has no column 'yaw_rate'; did you mean roll_rate"),
        ({}, "t", "time_column: x.csv has no column 't'"),
        ({"steer": 'invalid = "SNA"'}, "", "only a DBC knows"),
        ({"yaw_rate": 'valid_when = { signal = "state", is = [1] }'}, "", "valid_when: x.csv has no column 'state'"),
    ],
)
def test_what_a_table_does_not_have_is_named(more, drop, needle):
    table = columns()
    table.pop(drop, None)
    with pytest.raises(ConfigurationError, match=needle):
        series_of_columns(table, mapping(**more), place="x.csv")


def test_a_clock_that_jumps_back_is_an_error():
    table = columns()
    table["t"][100:] -= 1.5
    with pytest.raises(TraceError, match="time runs backwards"):
        series_of_columns(table, mapping(), place="x.csv")

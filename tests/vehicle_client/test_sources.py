"""Recorded drives in and out."""

import gzip
from dataclasses import fields, replace

import numpy as np
import pytest

from roadgrip.errors import TraceError
from roadgrip.records import QualityFlag
from tests.vehicle_client.synthetic import clock_s, drive_over, fixes_of, road, s_turn, surveyed
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry
from vehicle_client.estimation.wheel_speed import speed_at_wheels_mps
from vehicle_client.recording.channels import CHANNELS
from vehicle_client.recording.csv_table import columns_of_csv
from vehicle_client.recording.foreign import Channel, ColumnMapping, recording_of_columns
from vehicle_client.recording.own_columns import GNSS_ACCURACY_M, trace_of_columns
from vehicle_client.recording.resampling import repeated_count, trace_of_samples
from vehicle_client.shell.sources import read_recording, read_trace_csv, write_trace_csv

TRACE, STATION = drive_over(s_turn)
ARRAYS = [f.name for f in fields(Trace) if f.name not in {"gnss", "quality", "stability_active", "absent"}]


def rows(count=400, *, rate_hz=100.0):
    time = np.arange(count, dtype=np.float64) / rate_hz
    return time, np.column_stack([np.sin(time + i) for i in range(len(CHANNELS))])


@pytest.mark.parametrize("name", ["drive.csv", "drive.csv.gz"])
def test_a_trace_comes_back_to_the_last_bit(tmp_path, name):
    valid = TRACE.valid.copy()
    valid[500:520] = False
    section = surveyed(road(s_turn))
    fixes = fixes_of(section, TRACE.time_s + 0.0013, STATION, rng=np.random.default_rng(1))
    trace = replace(
        TRACE,
        valid=valid,
        stability_active=STATION > 300.0,
        gnss=replace(fixes, speed_mps=15.0 + 0.1 * np.sin(fixes.time_s)),
    )
    write_trace_csv(tmp_path / name, trace)
    back = read_trace_csv(tmp_path / name)
    for array in ARRAYS:
        assert np.array_equal(getattr(back, array)[valid], getattr(trace, array)[valid]), array
    assert np.array_equal(back.valid, valid)
    assert back.stability_active is not None
    assert np.array_equal(back.stability_active, STATION > 300.0)
    for array in ("time_s", "lat_deg", "lon_deg", "accuracy_m", "speed_mps"):
        assert np.array_equal(getattr(back.gnss, array), getattr(trace.gnss, array)), array


def test_the_same_trace_gives_the_same_file(tmp_path):
    for name in ("a.csv.gz", "b.csv.gz"):
        write_trace_csv(tmp_path / name, TRACE)
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()


def test_columns_in_any_order_and_strangers_are_fine(tmp_path):
    time, values = rows(200)
    names = ["note", *reversed(CHANNELS), "time_s"]
    lines = [",".join(names)]
    lines += [
        ",".join(["7", *map(repr, v[::-1].tolist()), repr(t)]) for t, v in zip(time.tolist(), values, strict=True)
    ]
    (tmp_path / "x.csv").write_text("\n".join(lines) + "\n")
    assert np.array_equal(read_trace_csv(tmp_path / "x.csv").wheel_speed_mps, values[:, 5:])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s\n0\n", "no column accel_x_mps2"),
        ("time_s,a\n0\n", "line 2: 1 cells under 2 columns"),
        ("time_s,a\n0,fast\n", "line 2"),
        ("", "no column time_s"),
        ("time_s,a\n0,1,2\n", "line 2: 3 cells under 2 columns"),
        ("time_s,a,a\n0,1,2\n", "more than one column a"),
        ("time_s,a\n0,1\n0," + 200_000 * "9" + "\n", "line 3: field larger"),
        (",".join(["time_s", *CHANNELS]) + "\n", "at least two samples"),
    ],
)
def test_what_is_no_trace_is_refused_with_the_place(tmp_path, text, message):
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(TraceError, match=message):
        read_trace_csv(tmp_path / "x.csv")


def test_what_spreadsheets_add_is_passed_over():
    # A mark before the first name, line ends of any make, empty lines.
    for text in ("\ufefftime_s,a\r\n0,1\r\n\r\n", "time_s,a\n0,1\n\n\n", "time_s,a\r0,1\r"):
        columns = columns_of_csv(text.encode(), place="x.csv")
        assert {name: values.tolist() for name, values in columns.items()} == {"time_s": [0.0], "a": [1.0]}


def test_a_fix_may_lack_its_time_and_its_accuracy():
    time, values = rows(20)
    columns = {"time_s": time, **dict(zip(CHANNELS, values.T, strict=True))}
    nothing = np.full(20, np.nan)
    columns |= {name: nothing.copy() for name in ("lat_deg", "lon_deg", "gnss_time_s", "gnss_accuracy_m")}
    columns["lat_deg"][[3, 8, 12]] = 60.0
    columns["lon_deg"][[3, 8]] = 10.0
    columns["gnss_time_s"][3], columns["gnss_accuracy_m"][3] = 0.028, 1.0
    gnss = trace_of_columns(columns, place="x").gnss
    assert gnss is not None
    assert gnss.time_s.tolist() == [0.028, 0.08]
    assert gnss.accuracy_m.tolist() == [1.0, GNSS_ACCURACY_M]


def test_an_empty_cell_of_the_interventions_is_none():
    time, values = rows(20)
    columns = {"time_s": time, **dict(zip(CHANNELS, values.T, strict=True))}
    columns["stability_active"] = np.where(np.arange(20) < 5, 1.0, np.nan)
    active = trace_of_columns(columns, place="x").stability_active
    assert active is not None
    assert active.sum() == 5


def test_bytes_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "x.csv").write_bytes(b"\xff\xfe\x00\x80")
    (tmp_path / "x.csv.gz").write_bytes(gzip.compress(b"time_s\n1\n")[:-9])
    whole = bytearray(gzip.compress(b"time_s\n1\n" * 100))
    whole[10] ^= 0xFF
    (tmp_path / "y.csv.gz").write_bytes(bytes(whole))
    for name in ("x.csv", "x.csv.gz", "y.csv.gz"):
        with pytest.raises(TraceError, match="no CSV"):
            read_trace_csv(tmp_path / name)


# Resampling ----------------------------------------------------------------------------------------------------------


def test_samples_on_the_grid_are_kept_as_they_are():
    time, values = rows()
    trace = trace_of_samples(time, values)
    assert np.array_equal(trace.accel_x_mps2, values[:, 0])
    assert trace.valid.all()


def test_a_silent_sensor_makes_missing_samples():
    time, values = rows()
    values[100:110, 3] = np.nan
    trace = trace_of_samples(time, values)
    assert np.flatnonzero(~trace.valid).tolist() == list(range(100, 110))


@pytest.mark.parametrize("rate_hz", [25.0, 50.0, 96.5, 99.5, 100.5, 104.0, 200.0])
def test_other_rates_are_resampled(rate_hz):
    time, values = rows(int(5 * rate_hz), rate_hz=rate_hz)
    trace = trace_of_samples(time, values)
    assert trace.valid.all()
    assert trace.time_s == pytest.approx(clock_s(trace.samples_count), abs=1e-9)
    assert trace.time_s[-1] == pytest.approx(time[-1], abs=0.011)
    assert np.abs(trace.steer_rad - np.sin(trace.time_s + 4)).max() < 1e-3


def test_a_recorder_whose_clock_drifts_a_little_is_taken_at_its_word():
    time, values = rows(6000)
    trace = trace_of_samples(time * (1.0 + 2e-4), values)
    assert np.array_equal(trace.accel_x_mps2, values[:, 0])
    assert trace.time_s[-1] == time[-1] * (1.0 + 2e-4)


def test_an_intervention_is_set_at_the_samples_nearest_to_its_row():
    time, values = rows(40, rate_hz=10.0)
    trace = trace_of_samples(time, values, stability_active=np.arange(40) == 7)
    assert trace.stability_active is not None
    assert np.abs(trace.time_s[trace.stability_active] - 0.7).max() < 0.0501
    assert 9 <= trace.stability_active.sum() <= 11


def test_a_sample_beside_a_gap_is_there_and_the_next_is_not():
    # 20 rows a second: neighbours may lie 125 ms apart, and a lone row stands for its own time.
    time, values = rows(100, rate_hz=20.0)
    gap = (time > 1.9) & (time < 2.04)
    trace = trace_of_samples(time[~gap], values[~gap])
    missing = trace.time_s[~trace.valid]
    assert (missing.min(), missing.max()) == pytest.approx((1.91, 2.04), abs=1e-6)
    nearer = (time > 1.9) & (time < 1.99)
    assert trace_of_samples(time[~nearer], values[~nearer]).valid.all()


def test_before_the_first_whole_row_and_after_the_last_nothing_is_known():
    time, values = rows(100, rate_hz=50.0)
    values[:5] = values[-5:] = np.nan
    trace = trace_of_samples(time, values)
    known = trace.time_s[trace.valid]
    assert (known.min(), known.max()) == pytest.approx((0.1, 1.88), abs=1e-6)


@pytest.mark.parametrize(("late_s", "kept"), [(0.0004, True), (0.0007, False)])
def test_a_sample_half_a_millisecond_off_the_grid_is_on_it(late_s, kept):
    time, values = rows()
    time[200] += late_s
    trace = trace_of_samples(time, values)
    assert (trace.accel_x_mps2[200] == values[200, 0]) is np.bool_(kept)


def test_jitter_is_no_gap():
    time, values = rows()
    time = time + np.random.default_rng(1).uniform(-0.003, 0.003, len(time))
    values = np.column_stack([np.sin(time + i) for i in range(len(CHANNELS))])
    trace = trace_of_samples(time, values)
    assert trace.valid.all()
    assert np.abs(trace.accel_x_mps2 - np.sin(trace.time_s)).max() < 1e-3


def test_a_hole_in_the_recording_is_masked():
    time, values = rows()
    keep = (time < 1.0) | (time > 1.5)
    trace = trace_of_samples(time[keep], values[keep])
    missing = trace.time_s[~trace.valid]
    assert (missing.min(), missing.max()) == pytest.approx((1.0, 1.5), abs=0.011)
    assert trace.samples_count == 400


def test_a_clock_that_jumps_ahead_leaves_a_gap():
    time, values = rows()
    trace = trace_of_samples(np.where(time < 2.0, time, time + 3.0), values)
    assert trace.samples_count == 700
    assert (~trace.valid).sum() == pytest.approx(300, abs=2)


def test_of_rows_with_one_time_the_last_holds_and_they_are_counted():
    time, values = rows()
    twice = np.repeat(time, 2)
    doubled = np.repeat(values, 2, axis=0)
    doubled[::2] += 7.0
    trace = trace_of_samples(twice, doubled, stability_active=np.arange(len(twice)) % 2 == 1)
    plain = trace_of_samples(time, values)
    assert all(np.array_equal(getattr(trace, name), getattr(plain, name)) for name in ARRAYS)
    assert trace.stability_active is not None
    assert trace.stability_active.all()
    assert (repeated_count(twice), repeated_count(time)) == (len(time), 0)


def test_a_clock_that_stands_still_is_refused():
    with pytest.raises(TraceError, match="stands still"):
        trace_of_samples(np.full(10, 3.0), np.zeros((10, len(CHANNELS))))


@pytest.mark.parametrize("jump_s", [-1.0, 4.1 * 3600.0, 1e6])
def test_a_clock_that_cannot_be_is_refused(jump_s):
    time, values = rows()
    with pytest.raises(TraceError, match=r"time runs backwards|cut it first"):
        trace_of_samples(np.where(time < 2.0, time, time + jump_s), values)


# Recordings of others ------------------------------------------------------------------------------------------------


def foreign(tmp_path):
    time = clock_s(100)
    table = np.column_stack([time, np.full(100, 0.1), np.full(100, 14.0)])
    path = tmp_path / "foreign.csv"
    np.savetxt(path, table, delimiter=",", header="t,gyro_down,v_ref", comments="")
    return path


def test_axes_are_turned_and_what_is_missing_is_said(tmp_path):
    mapping = ColumnMapping(
        time_column="t",
        channels={"yaw_rate_radps": Channel("gyro_down", gain=-1.0)},
        reference={"velocity_x_mps": Channel("v_ref")},
        reference_speed="velocity_x_mps",
        vehicle=VehicleGeometry(wheelbase_m=2.7, track_m=1.5, front_axle_m=1.3),
    )
    drive = read_recording(foreign(tmp_path), mapping)
    assert np.allclose(drive.trace.yaw_rate_radps, -0.1)
    assert drive.trace.quality is QualityFlag.REFERENCE_SPEED
    assert "roll_rate_radps" in drive.missing
    assert "wheel_front_left_mps" in drive.missing
    assert (drive.trace.roll_rate_radps == 0.0).all()
    # A right turn: the left wheels are the outer, faster ones.
    assert np.allclose(drive.trace.wheel_speed_mps[:, 2:], [14.075, 13.925])
    assert np.allclose(drive.reference["velocity_x_mps"], 14.0)


def test_wheels_of_a_reference_speed_tell_it_again():
    time = clock_s(300)
    speed, yaw, steer = 14.0 + np.sin(time), 0.3 * np.sin(0.7 * time), 0.1 * np.sin(0.7 * time)
    mapping = ColumnMapping(
        time_column="t",
        channels={"yaw_rate_radps": Channel("yaw"), "steer_rad": Channel("steer")},
        reference={"velocity_x_mps": Channel("v")},
        reference_speed="velocity_x_mps",
    )
    trace = recording_of_columns({"t": time, "v": speed, "yaw": yaw, "steer": steer}, mapping, place="x").trace
    told = speed_at_wheels_mps(trace.wheel_speed_mps, yaw, steer, np.zeros(300), vehicle=XC90)
    assert np.allclose(told, speed[:, None], atol=1e-12)


def test_without_wheels_and_reference_there_is_no_speed(tmp_path):
    mapping = ColumnMapping(time_column="t", channels={"yaw_rate_radps": Channel("gyro_down")})
    with pytest.raises(TraceError, match="wheel speeds"):
        read_recording(foreign(tmp_path), mapping)


def test_a_mapping_that_does_not_fit_the_file_is_refused(tmp_path):
    with pytest.raises(TraceError, match="no column speed"):
        read_recording(foreign(tmp_path), ColumnMapping(time_column="t", channels={"steer_rad": Channel("speed")}))

"""CAN logs: a drive comes back from every kind of file, and what cannot be read says why."""

from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest

from roadgrip.errors import ConfigurationError, TraceError
from tests.vehicle_client.shell.can.cars import SECTION, drive, mapping
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.recording.channels import CHANNELS
from vehicle_client.shell.can.description import path_of_signals, read_can_mapping
from vehicle_client.shell.can.log_names import LOG_SUFFIXES, is_log
from vehicle_client.shell.can.logs import read_log
from vehicle_client.shell.can.written import frames_of_trace, message_of, write_log
from vehicle_client.shell.sources import TRACE_SUFFIXES, read_mapped, read_trace_csv, write_trace

EXAMPLE = read_can_mapping(path_of_signals("example"))
DRIVE = drive()
FRAMES = frames_of_trace(DRIVE, EXAMPLE)

# Half a step of each signal of the example's DBC, in our units.
HALF_STEPS = {
    "accel_x_mps2": 0.001,
    "accel_y_mps2": 0.001,
    "roll_rate_radps": np.deg2rad(0.0025),
    "yaw_rate_radps": np.deg2rad(0.0025),
    "steer_rad": np.deg2rad(0.03125) / 16.8,
}
HALF_WHEEL_STEP_MPS = 0.005 / 3.6
TIME_STEP_S = 1e-6
"""Text logs keep microseconds."""


def needs(suffix: str) -> None:
    library = {".mf4": "asammdf", ".parquet": "pyarrow"}.get(suffix)
    if library:
        pytest.importorskip(library)


def messages():
    return [message_of(FRAMES, i, time_s=t) for i, t in enumerate(FRAMES.time_s.tolist())]


def written(path: Path, frames) -> Path:
    with can.Logger(path) as log:
        for frame in frames:
            log.on_message_received(frame)
    return path


@pytest.mark.parametrize("suffix", LOG_SUFFIXES)
def test_a_drive_comes_back_from_a_log_to_half_a_step_of_each_signal(tmp_path, suffix):
    needs(suffix)
    write_trace(tmp_path / f"drive{suffix}", DRIVE)
    back = read_mapped(tmp_path / f"drive{suffix}", "example").aligned.trace
    assert back.samples_count == DRIVE.samples_count
    assert np.array_equal(back.valid, DRIVE.valid)
    for name, half_step in HALF_STEPS.items():
        error = np.abs(getattr(back, name) - getattr(DRIVE, name))[DRIVE.valid]
        assert error.max() <= half_step * 1.01, name
    assert np.abs(back.wheel_speed_mps - DRIVE.wheel_speed_mps)[DRIVE.valid].max() <= HALF_WHEEL_STEP_MPS * 1.01
    assert back.gnss is not None
    assert DRIVE.gnss is not None
    assert back.gnss.lat_deg == pytest.approx(DRIVE.gnss.lat_deg, abs=6e-8)
    assert back.gnss.speed_mps == pytest.approx(DRIVE.gnss.speed_mps, abs=0.0051)
    assert back.gnss.time_s == pytest.approx(DRIVE.gnss.time_s, abs=2.0 * TIME_STEP_S)
    assert back.stability_active is not None
    assert DRIVE.stability_active is not None
    # Flags are sent with every other sample.
    assert (back.stability_active != DRIVE.stability_active).sum() <= 2


@pytest.mark.parametrize("suffix", TRACE_SUFFIXES)
def test_the_summary_of_any_file_is_that_of_the_drive(tmp_path, suffix):
    # Tolerances: what half a step of each signal (a thousandth of a m/s2, 0.0025 degrees a second, 0.002 degrees of
    # steering, 0.0014 m/s) makes of means and extremes; higher moments divide by a spread, hence their hundredths.
    needs(suffix)
    path = tmp_path / f"drive{suffix}"
    write_trace(path, DRIVE)
    back = read_mapped(path, "example").aligned.trace if is_log(path) else read_trace_csv(path)
    expected, made = (summarise_passage(trace, SECTION) for trace in (DRIVE, back))
    assert isinstance(expected, Summarised)
    assert isinstance(made, Summarised)
    assert made.summary.values == pytest.approx(expected.summary.values, rel=0.02, abs=0.02)
    assert made.summary.quality == expected.summary.quality
    assert made.match.exit_s == pytest.approx(expected.match.exit_s, abs=0.01)


@pytest.mark.parametrize("suffix", [".log", ".asc"])
def test_a_text_log_may_be_packed(tmp_path, suffix):
    path = written(tmp_path / f"drive{suffix}.gz", messages()[:2000])
    assert is_log(path)
    assert set(read_log(path, EXAMPLE)) >= set(CHANNELS)


def test_frames_that_nobody_asked_for_change_nothing(tmp_path):
    asked = messages()[:3000]
    strangers = [
        can.Message(timestamp=-5.0, arbitration_id=0x7FF, data=b"\x01", is_extended_id=False),
        can.Message(timestamp=1.0, arbitration_id=FRAMES.frame_id[0], data=b"\xff" * 8, is_extended_id=True),
        can.Message(timestamp=1.0, arbitration_id=FRAMES.frame_id[0], is_remote_frame=True, is_extended_id=False),
        can.Message(timestamp=1.0, is_error_frame=True),
    ]
    alone = read_log(written(tmp_path / "alone.blf", asked), EXAMPLE)
    among = read_log(written(tmp_path / "among.blf", [*strangers, *asked, *strangers[1:]]), EXAMPLE)
    assert alone.keys() == among.keys()
    for name, series in alone.items():
        assert np.array_equal(series.values, among[name].values, equal_nan=True)
        assert among[name].time_s == pytest.approx(series.time_s, abs=1e-6)


def test_frames_of_another_bus_are_passed_over_when_the_mapping_names_one(tmp_path):
    here = messages()[:3000]
    there = [
        can.Message(
            timestamp=m.timestamp,
            arbitration_id=m.arbitration_id,
            data=b"\x01" * len(m.data),
            is_extended_id=False,
            channel=2,
        )
        for m in here
    ]
    path = written(tmp_path / "two.blf", [frame for pair in zip(here, there, strict=True) for frame in pair])
    one = read_log(path, mapping(tmp_path, ('dbc = "', 'bus = "0"\ndbc = "')))
    assert np.array_equal(
        one["accel_x_mps2"].values,
        read_log(written(tmp_path / "one.blf", here), EXAMPLE)["accel_x_mps2"].values,
        equal_nan=True,
    )
    with pytest.raises(TraceError, match="right bus"):
        read_log(path, mapping(tmp_path, ('dbc = "', 'bus = 7\ndbc = "')))


def test_a_known_delay_of_a_sensor_is_taken_back(tmp_path):
    path = written(tmp_path / "drive.blf", messages()[:3000])
    late = read_log(path, mapping(tmp_path, ('signal = "YawRate"', 'signal = "YawRate"\ndelay_s = 0.05')))
    assert late["steer_rad"].time_s[0] - late["yaw_rate_radps"].time_s[0] == pytest.approx(0.05)


def test_a_clock_that_was_set_back_is_an_error_and_a_little_disorder_is_none(tmp_path):
    frames = messages()[:4000]
    mixed = [frame for i in range(0, 4000, 40) for frame in reversed(frames[i : i + 40])]
    assert set(read_log(written(tmp_path / "mixed.log", mixed), EXAMPLE)) >= set(CHANNELS)
    again = [*frames, *frames]
    with pytest.raises(TraceError, match="time runs backwards"):
        read_log(written(tmp_path / "again.log", again), EXAMPLE)


def test_a_message_that_does_not_come_is_named(tmp_path):
    frames = [frame for frame in messages()[:3000] if frame.arbitration_id != 0x102]
    with pytest.raises(TraceError, match=r"SteeringWheelAngle of Steering \(identifier 0x102\).*\[steer\]"):
        read_log(written(tmp_path / "mute.blf", frames), EXAMPLE)


def test_a_log_of_another_car_is_told(tmp_path):
    frames = [can.Message(timestamp=0.01 * i, arbitration_id=5, data=b"1", is_extended_id=False) for i in range(50)]
    with pytest.raises(TraceError, match="is it this car's log"):
        read_log(written(tmp_path / "other.asc", frames), EXAMPLE)


@pytest.mark.parametrize("suffix", LOG_SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"garbage\n", b"\x00\xff" * 300])
def test_what_is_no_log_is_said_in_one_line(tmp_path, suffix, content):
    needs(suffix)
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(content)
    with pytest.raises(TraceError, match=f"broken{suffix}"):
        read_log(path, EXAMPLE)


@pytest.mark.parametrize("suffix", LOG_SUFFIXES)
def test_a_file_that_is_not_there_is_said(tmp_path, suffix):
    needs(suffix)
    with pytest.raises(ConfigurationError, match="No such file"):
        read_log(tmp_path / f"none{suffix}", EXAMPLE)


def test_reading_a_long_log_tells_how_far_it_is(tmp_path):
    news = []
    path = written(tmp_path / "drive.log", messages())
    read_log(path, EXAMPLE, watch=lambda count, _: news.append(count))
    assert news[-1] == len(FRAMES.time_s)


def test_what_a_trace_does_not_have_is_not_sent(tmp_path):
    bare_drive = replace(DRIVE, gnss=None, stability_active=None)
    bare = frames_of_trace(bare_drive, EXAMPLE)
    assert set(bare.frame_id.tolist()) == {0x101, 0x102, 0x120}
    write_log(tmp_path / "bare.log", bare_drive, EXAMPLE)
    assert set(read_log(tmp_path / "bare.log", EXAMPLE)) == set(CHANNELS)


def test_a_trace_is_written_only_as_what_we_can_read(tmp_path):
    with pytest.raises(ConfigurationError, match=r"\.parquet"):
        write_trace(tmp_path / "drive.xlsx", DRIVE)

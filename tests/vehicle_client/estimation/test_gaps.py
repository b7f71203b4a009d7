"""Missing and unbelievable samples."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.errors import TraceError
from tests.vehicle_client.synthetic import motion
from vehicle_client.estimation.gaps import believable, bridged, longest_gap_s, missing_frac

N = 300


def drive():
    time = np.arange(N) * 0.01
    return motion(np.full(N, 15.0), 0.3 * np.sin(time))


def test_an_ordinary_drive_is_believed_whole():
    assert believable(drive()).all()


@pytest.mark.parametrize(("name", "size"), [("yaw_rate_radps", 3.0), ("accel_y_mps2", -40.0), ("steer_rad", 0.5)])
def test_a_spike_of_one_sample_is_not_believed(name, size):
    trace = drive()
    values = getattr(trace, name).copy()
    values[150] += size
    valid = believable(replace(trace, **{name: values}))
    assert np.flatnonzero(~valid).tolist() == [150]


def test_a_step_is_no_spike():
    trace = drive()
    accel = trace.accel_x_mps2.copy()
    accel[150:] -= 40.0
    assert believable(replace(trace, accel_x_mps2=accel)).all()


LIMITS = {
    "accel_x_mps2": 25.0,
    "accel_y_mps2": 25.0,
    "roll_rate_radps": 1.0,
    "yaw_rate_radps": 0.5,
    "steer_rad": 0.05,
}
REACH = {
    "accel_x_mps2": 500.0,
    "accel_y_mps2": 500.0,
    "roll_rate_radps": 35.0,
    "yaw_rate_radps": 35.0,
    "steer_rad": 1.5,
}


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_spike_begins_where_the_docstring_says(name, sign):
    for ratio, believed in ((0.95, True), (1.05, False)):
        values = np.zeros(N)
        values[150] = sign * ratio * LIMITS[name]
        assert believable(replace(drive(), **{name: values}))[150] == believed


@pytest.mark.parametrize("name", REACH)
def test_what_no_sensor_reads_is_not_believed_however_long_it_lasts(name):
    for ratio, believed in ((0.95, True), (-1.05, False), (1.05, False)):
        values = np.where(np.arange(N) < 150, 0.0, ratio * REACH[name])
        assert believable(replace(drive(), **{name: values}))[150:].all() == believed


@pytest.mark.parametrize("wheel", range(4))
def test_one_wheel_that_cannot_be_spoils_the_sample(wheel):
    wheels = np.full((N, 4), 15.0)
    wheels[100:, wheel], wheels[200:, wheel] = 145.0, 155.0
    assert np.array_equal(believable(replace(drive(), wheel_speed_mps=wheels)), np.arange(N) < 200)


def test_a_sample_between_two_error_codes_is_no_spike():
    rate = np.zeros(N)
    rate[[149, 151]] = 1e6
    assert np.flatnonzero(~believable(replace(drive(), yaw_rate_radps=rate))).tolist() == [149, 151]


def test_gaps_are_bridged_with_straight_lines_and_stay_marked():
    trace = drive()
    valid = np.ones(N, dtype=bool)
    valid[100:120] = False
    broken = replace(trace, yaw_rate_radps=np.where(valid, trace.yaw_rate_radps, np.nan), valid=valid)
    mended = bridged(broken, believable(broken))
    assert not mended.valid[100:120].any()
    expected = np.interp(110, [99, 120], trace.yaw_rate_radps[[99, 120]])
    assert mended.yaw_rate_radps[110] == pytest.approx(expected)
    assert np.array_equal(mended.yaw_rate_radps[valid], trace.yaw_rate_radps[valid])


def test_gaps_are_measured():
    valid = np.ones(200, dtype=bool)
    assert (longest_gap_s(valid), missing_frac(valid)) == (0.0, 0.0)
    valid[:5] = valid[50:80] = False
    assert longest_gap_s(valid) == pytest.approx(0.3)
    assert missing_frac(valid) == pytest.approx(0.175)
    assert missing_frac(np.zeros(0, dtype=bool)) == 1.0
    assert longest_gap_s(np.zeros(7, dtype=bool)) == pytest.approx(0.07)


def test_a_trace_that_contradicts_itself_is_an_error():
    for time_s in (np.arange(N) * 0.02, np.arange(N) * 0.0115, np.where(np.arange(N) == 5, np.nan, drive().time_s)):
        with pytest.raises(TraceError, match="10 ms"):
            believable(replace(drive(), time_s=time_s))
    for name in ("valid", "stability_active", "wheel_speed_mps", "steer_rad"):
        ones = np.ones((N, 3)) if name == "wheel_speed_mps" else np.ones(N - 1, dtype=bool)
        with pytest.raises(TraceError, match=name):
            believable(replace(drive(), **{name: ones}))

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
    assert longest_gap_s(np.zeros(7, dtype=bool)) == pytest.approx(0.07)


def test_a_trace_that_contradicts_itself_is_an_error():
    with pytest.raises(TraceError, match="10 ms"):
        believable(replace(drive(), time_s=np.arange(N) * 0.02))

"""The record of a drive: parts of it, and its mirror image."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.errors import TraceError
from tests.vehicle_client.synthetic import clock_s, motion
from vehicle_client.estimation.trace import GnssTrack, Trace, mirrored, part_of

N = 1000


def drive(*, start_s: float = 0.0) -> Trace:
    time_s = start_s + clock_s(N)
    fixes_s = time_s[::100]
    gnss = GnssTrack(fixes_s, 60.0 + 0.0 * fixes_s, 10.0 + 0.0 * fixes_s, 1.0 + 0.0 * fixes_s, speed_mps=fixes_s)
    trace = motion(np.full(N, 15.0), 0.2 * np.sin(time_s))
    return replace(trace, time_s=time_s, gnss=gnss, stability_active=np.arange(N) == 450, absent=("roll_rate_radps",))


@pytest.mark.parametrize("start_s", [0.0, 1e9])
def test_a_part_holds_both_its_ends_and_the_fixes_between(start_s):
    whole = drive(start_s=start_s)
    part = part_of(whole, from_s=3.0, to_s=7.0)
    assert np.array_equal(part.time_s, whole.time_s[300:701])
    for name in ("accel_y_mps2", "yaw_rate_radps", "steer_rad", "wheel_speed_mps", "valid", "stability_active"):
        assert np.array_equal(getattr(part, name), getattr(whole, name)[300:701]), name
    assert part.gnss is not None
    assert part.gnss.speed_mps is not None
    assert np.array_equal(part.gnss.time_s, whole.time_s[300:701:100])
    assert np.array_equal(part.gnss.speed_mps, part.gnss.time_s)
    assert part.absent == whole.absent


def test_of_nothing_there_is_no_part():
    with pytest.raises(TraceError, match="nothing lies between"):
        part_of(drive(), from_s=11.0, to_s=12.0)


def test_the_mirror_of_the_mirror_is_the_drive_without_its_fixes():
    whole = drive()
    twice = mirrored(mirrored(whole))
    for name in ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad", "wheel_speed_mps"):
        assert np.array_equal(getattr(twice, name), getattr(whole, name)), name
    assert (twice.gnss, twice.absent, mirrored(whole).absent) == (None, whole.absent, whole.absent)
    # The left wheels of a left turn are the slower ones, the right wheels of its mirror image.
    assert np.array_equal(mirrored(whole).wheel_speed_mps[:, 0], whole.wheel_speed_mps[:, 1])
    assert np.array_equal(mirrored(whole).wheel_speed_mps[:, 3], whole.wheel_speed_mps[:, 2])

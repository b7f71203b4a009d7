"""Channels with their own clocks on one grid: laws, and what gaps and flags become."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.errors import TraceError
from vehicle_client.recording.channels import CHANNELS
from vehicle_client.recording.own_columns import GNSS_ACCURACY_M
from vehicle_client.recording.series import Series, count_of, trace_of_series

SLOPES = {name: 0.5 + 0.1 * i for i, name in enumerate(CHANNELS)}


def line(name, time_s):
    return 1.0 + SLOPES[name] * time_s


def drive(seed=1, *, duration_s=2.0, jitter_s=0.002):
    """Every channel at a rate of its own, with jitter, on a straight line over time."""
    rng = np.random.default_rng(seed)
    series = {}
    for i, name in enumerate(CHANNELS):
        step_s = (0.01, 0.02, 0.04)[i % 3]
        time_s = np.arange(0.0, duration_s + step_s / 2.0, step_s)
        time_s[1:-1] += rng.uniform(-jitter_s, jitter_s, len(time_s) - 2)
        series[name] = Series(time_s, line(name, time_s))
    return series


def column(trace, name):
    wheels = CHANNELS[5:]
    return trace.wheel_speed_mps[:, wheels.index(name)] if name in wheels else getattr(trace, name)


@given(st.integers(0, 1000), st.floats(0.0, 0.004))
@settings(max_examples=20)
def test_a_straight_line_is_met_exactly_whatever_the_rates_and_the_jitter(seed, jitter_s):
    trace = trace_of_series(drive(seed, jitter_s=jitter_s)).trace
    assert trace.samples_count == 201
    assert trace.valid.all()
    for name in CHANNELS:
        assert column(trace, name) == pytest.approx(line(name, trace.time_s), abs=1e-9)


@given(st.randoms(use_true_random=False))
@settings(max_examples=20)
def test_the_order_in_which_values_come_does_not_matter(random):
    ordered = drive()
    shuffled = {}
    for name, of in random.sample(sorted(ordered.items()), len(ordered)):
        order = random.sample(range(len(of.time_s)), len(of.time_s))
        shuffled[name] = Series(of.time_s[order], of.values[order])
    a, b = trace_of_series(ordered).trace, trace_of_series(shuffled).trace
    assert all(np.array_equal(column(a, name), column(b, name)) for name in CHANNELS)


def test_a_channel_that_no_trace_has_changes_nothing():
    stranger = {"engine_speed": Series(np.array([-50.0, 90.0]), np.array([1.0, 2.0]))}
    a, b = trace_of_series(drive()).trace, trace_of_series(drive() | stranger).trace
    assert np.array_equal(a.time_s, b.time_s)
    assert all(np.array_equal(column(a, name), column(b, name)) for name in CHANNELS)


def test_only_what_lies_around_a_sample_says_it():
    # The lag that the live client lives with: nothing later than the next value of the channel plays a part.
    series = drive()
    later = {
        name: Series(of.time_s, np.where(of.time_s > 1.1, of.values + 99.0, of.values)) for name, of in series.items()
    }
    a, b = trace_of_series(series).trace, trace_of_series(later).trace
    early = a.time_s < 1.05
    assert all(np.array_equal(column(a, name)[early], column(b, name)[early]) for name in CHANNELS)


def test_a_gap_of_one_channel_is_marked_for_it_and_makes_the_sample_missing():
    series = drive(jitter_s=0.0)
    yaw = series["yaw_rate_radps"]
    keep = (yaw.time_s < 0.5) | (yaw.time_s > 1.0)
    aligned = trace_of_series(series | {"yaw_rate_radps": Series(yaw.time_s[keep], yaw.values[keep])})
    missing_s = aligned.trace.time_s[~aligned.covered["yaw_rate_radps"]]
    assert (missing_s.min(), missing_s.max()) == pytest.approx((0.5, 1.0), abs=0.03)
    assert np.array_equal(aligned.trace.valid, aligned.covered["yaw_rate_radps"])
    assert aligned.covered["steer_rad"].all()


def test_a_value_that_the_car_did_not_know_is_missing():
    series = drive(jitter_s=0.0)
    steer = series["accel_x_mps2"]
    values = steer.values.copy()
    values[100] = np.nan
    aligned = trace_of_series(series | {"accel_x_mps2": Series(steer.time_s, values)})
    assert np.flatnonzero(~aligned.trace.valid).tolist() == [100]
    assert aligned.counts["accel_x_mps2"].invalid_count == 1


def test_of_equal_time_stamps_the_last_holds_and_is_counted():
    series = drive(jitter_s=0.0)
    of = series["accel_x_mps2"]
    doubled = Series(np.repeat(of.time_s, 2), np.column_stack([of.values + 50.0, of.values]).ravel())
    aligned = trace_of_series(series | {"accel_x_mps2": doubled})
    assert aligned.trace.accel_x_mps2 == pytest.approx(of.values)
    assert aligned.counts["accel_x_mps2"].repeated_count == len(of.time_s)


@given(st.sampled_from([0.001, 0.005, 0.01, 0.016]))
def test_coarse_time_stamps_cost_no_more_than_their_step(step_s):
    series = {
        name: Series(np.floor(of.time_s / step_s + 1e-9) * step_s, of.values)
        for name, of in drive(jitter_s=0.0).items()
    }
    trace = trace_of_series(series).trace
    for name in CHANNELS:
        error = np.abs(column(trace, name) - line(name, trace.time_s))[trace.valid]
        assert error.max() <= SLOPES[name] * step_s + 1e-9
    assert trace.valid.mean() > 0.9


def test_a_sensor_that_the_car_lacks_reads_zero_and_is_said():
    series = drive()
    del series["roll_rate_radps"]
    with pytest.raises(TraceError, match="roll_rate_radps"):
        trace_of_series(series)
    aligned = trace_of_series(series, missing=("roll_rate_radps",))
    assert not aligned.trace.roll_rate_radps.any()
    assert aligned.trace.absent == aligned.missing == ("roll_rate_radps",)


def test_any_flag_sets_the_sample_until_it_says_no_or_falls_silent():
    flags = {
        "abs_active": Series(np.array([0.0, 0.5, 0.7]), np.array([0.0, 1.0, 0.0])),
        "esc_active": Series(np.array([0.0, 0.9]), np.array([0.0, 1.0])),
    }
    trace = trace_of_series(drive(duration_s=3.0) | flags).trace
    assert trace.stability_active is not None
    active_s = trace.time_s[trace.stability_active]
    assert active_s == pytest.approx(np.concatenate([np.arange(0.5, 0.695, 0.01), np.arange(0.9, 1.905, 0.01)]))
    assert trace_of_series(drive()).trace.stability_active is None


def test_fixes_are_put_together_and_repeated_ones_left_out():
    at_s = np.arange(0.0, 2.0, 0.1)
    lat = 60.0 + 1e-5 * np.floor(at_s / 0.2 + 1e-9)  # a receiver that is asked twice as often as it knows
    fixes = {
        "lat_deg": Series(at_s, lat),
        "lon_deg": Series(at_s + 0.01, np.full(len(at_s), 10.0)),
        "gnss_accuracy_m": Series(at_s, np.where(at_s < 1.0, 1.5, np.nan)),
        "gnss_speed_mps": Series(np.array([0.0, 1.9]), np.array([11.0, 12.0])),
    }
    gnss = trace_of_series(drive() | fixes).trace.gnss
    assert gnss is not None
    assert gnss.time_s == pytest.approx(np.arange(0.0, 2.0, 0.2))
    assert gnss.accuracy_m[[0, -1]].tolist() == [1.5, 1.5]
    assert gnss.speed_mps is not None
    assert (gnss.speed_mps[0], gnss.speed_mps[-1]) == (11.0, 12.0)


def test_no_fix_is_made_up():
    at_s = np.array([0.0, 1.0])
    far = {"lat_deg": Series(at_s, np.array([60.0, np.nan])), "lon_deg": Series(at_s + 0.5, np.array([10.0, 11.0]))}
    assert trace_of_series(drive() | far).trace.gnss is None


@pytest.mark.parametrize(("at_s", "needle"), [(1e6, "cut it first"), (np.nan, "no time")])
def test_a_clock_that_cannot_be_is_refused(at_s, needle):
    series = drive()
    of = series["steer_rad"]
    broken = Series(np.append(of.time_s, at_s), np.append(of.values, 0.0))
    with pytest.raises(TraceError, match=needle):
        trace_of_series(series | {"steer_rad": broken})


def test_a_channel_is_counted():
    count = count_of(Series(np.array([0.0, 0.01, 0.02, 0.5]), np.array([1.0, np.nan, 3.0, 2.0])))
    assert (count.values_count, count.invalid_count, count.repeated_count) == (4, 1, 0)
    assert (count.lower, count.upper) == (1.0, 3.0)
    assert (count.step_s, count.longest_gap_s) == pytest.approx((0.01, 0.48))


def with_channel(name, time_s):
    return drive(duration_s=4.0, jitter_s=0.0) | {name: Series(np.asarray(time_s), line(name, np.asarray(time_s)))}


@pytest.mark.parametrize(("step_s", "gap_s", "bridged"), [(0.12, 0.24, True), (0.12, 0.27, False), (0.02, 0.06, False)])
def test_a_gap_is_bridged_up_to_two_and_a_half_steps_and_a_quarter_of_a_second(step_s, gap_s, bridged):
    time_s = np.arange(0.0, 4.0, step_s)
    time_s = np.concatenate([time_s[time_s < 2.0], time_s[time_s < 2.0][-1] + gap_s + np.arange(0.0, 1.9, step_s)])
    aligned = trace_of_series(with_channel("steer_rad", time_s))
    between = (aligned.trace.time_s < time_s[-1]) & ~aligned.covered["steer_rad"]
    assert (not between.any()) is bridged


def test_before_its_first_value_and_after_its_last_a_channel_is_not_known():
    aligned = trace_of_series(with_channel("steer_rad", np.arange(0.5, 3.0, 0.01)))
    assert aligned.trace.time_s[0] == 0.0
    covered_s = aligned.trace.time_s[aligned.covered["steer_rad"]]
    assert (covered_s[0], covered_s[-1]) == pytest.approx((0.5, 2.99))


def test_a_flag_stamped_a_little_after_a_sample_is_that_samples():
    for late_s, first in ((0.0004, 50), (0.0006, 51)):
        flag = {"abs_active": Series(np.array([0.5 + late_s]), np.array([1.0]))}
        active = trace_of_series(drive(jitter_s=0.0) | flag).trace.stability_active
        assert active is not None
        assert np.flatnonzero(active)[0] == first


@pytest.mark.parametrize(("late_s", "fix"), [(0.045, True), (0.055, False)])
def test_latitude_and_longitude_are_one_fix_within_fifty_milliseconds(late_s, fix):
    fixes = {
        "lat_deg": Series(np.array([1.0]), np.array([60.0])),
        "lon_deg": Series(np.array([1.0 + late_s]), np.ones(1)),
    }
    assert (trace_of_series(drive() | fixes).trace.gnss is not None) is fix


@pytest.mark.parametrize(("lat_deg", "lon_deg"), [(90.5, 10.0), (-91.0, 10.0), (60.0, 181.0), (60.0, -655.35)])
def test_a_place_that_is_not_on_earth_is_no_fix(lat_deg, lon_deg):
    fixes = {"lat_deg": Series(np.ones(1), np.array([lat_deg])), "lon_deg": Series(np.ones(1), np.array([lon_deg]))}
    assert trace_of_series(drive() | fixes).trace.gnss is None


@pytest.mark.parametrize(("step_s", "kept_count"), [(0.9, 1), (1.1, 4)])
def test_a_place_told_again_after_a_second_is_a_fix_again(step_s, kept_count):
    at_s = step_s * np.arange(4)
    fixes = {"lat_deg": Series(at_s, np.full(4, 60.0)), "lon_deg": Series(at_s, np.full(4, 10.0))}
    gnss = trace_of_series(drive(duration_s=4.0) | fixes).trace.gnss
    assert gnss is not None
    assert len(gnss.time_s) == kept_count


@pytest.mark.parametrize(("late_s", "told"), [(1.4, True), (1.6, False)])
def test_what_is_said_of_a_fix_may_be_a_second_and_a_half_away(late_s, told):
    fixes = {name: Series(np.ones(1), np.array([value])) for name, value in (("lat_deg", 60.0), ("lon_deg", 10.0))}
    fixes["gnss_accuracy_m"] = Series(np.array([1.0 + late_s]), np.array([1.25]))
    gnss = trace_of_series(drive() | fixes).trace.gnss
    assert gnss is not None
    assert gnss.accuracy_m[0] == (1.25 if told else GNSS_ACCURACY_M)

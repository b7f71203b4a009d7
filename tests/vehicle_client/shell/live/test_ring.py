import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vehicle_client.shell.cars import a_trace
from vehicle_client.estimation.trace import GnssTrack, Trace
from vehicle_client.recording.channels import CHANNELS, WHEEL_COLUMNS
from vehicle_client.recording.series import Series
from vehicle_client.shell.live.ring import Readings, SampleRing
from vehicle_client.shell.live.source import PlayedTrace, SourceState


def wavy_trace(samples_count: int = 3000) -> Trace:
    time_s = 50.0 + np.arange(samples_count) / 100.0
    wave = np.sin(time_s)
    return Trace(
        time_s=time_s,
        accel_x_mps2=wave,
        accel_y_mps2=2.0 * wave,
        roll_rate_radps=0.1 * wave,
        yaw_rate_radps=0.2 * wave,
        steer_rad=0.05 * wave,
        wheel_speed_mps=np.column_stack([20.0 + wave + i for i in range(4)]),
        valid=np.ones(samples_count, dtype=np.bool_),
        stability_active=time_s > 60.0,
        gnss=GnssTrack(time_s[::10], 60.0 + time_s[::10] / 1e4, 10.0 + time_s[::10] / 1e4, np.full(300, 2.0)),
    )


def fill(ring: SampleRing, trace: Trace, *, step_s: float = 0.1) -> None:
    source = PlayedTrace(trace)
    at = float(trace.time_s[0])
    while source.state is not SourceState.ENDED:
        ring.put(source.take(until_s=at))
        at += step_s


def one_value(at_s: float, value: float = 1.0) -> Readings:
    return {name: Series(np.array([at_s]), np.array([value])) for name in CHANNELS}


def test_what_was_played_comes_back_as_it_was():
    trace, ring = wavy_trace(), SampleRing()
    fill(ring, trace)
    again = ring.trace(since_s=-np.inf)
    assert again is not None
    assert again.samples_count == trace.samples_count
    assert np.allclose(again.accel_y_mps2, trace.accel_y_mps2, atol=1e-9)
    assert np.allclose(again.wheel_speed_mps, trace.wheel_speed_mps, atol=1e-9)
    assert again.valid.all()
    assert again.stability_active is not None
    assert trace.stability_active is not None
    assert np.array_equal(again.stability_active, trace.stability_active)
    assert again.gnss is not None
    assert trace.gnss is not None
    assert np.array_equal(again.gnss.lat_deg, trace.gnss.lat_deg)


def test_a_part_is_cut_by_time():
    trace, ring = wavy_trace(), SampleRing()
    fill(ring, trace)
    part = ring.trace(since_s=60.0)
    assert part is not None
    assert part.time_s[0] == pytest.approx(60.0)
    assert part.gnss is not None
    assert part.gnss.time_s[0] >= 60.0


def test_the_oldest_makes_room_and_memory_never_grows():
    ring = SampleRing(duration_s=10.0)
    fill(ring, wavy_trace(10))
    before_bytes = ring.size_bytes
    fill(ring, wavy_trace())
    again = ring.trace(since_s=-np.inf)
    assert again is not None
    assert again.samples_count == 1000
    assert again.time_s[-1] == pytest.approx(79.99)
    assert ring.size_bytes == before_bytes <= ring.limit_bytes


def test_ten_minutes_take_less_than_twelve_megabytes():
    assert SampleRing().limit_bytes < 12_000_000


def test_a_gap_is_not_filled():
    trace = wavy_trace()
    trace.valid[1000:1040] = False
    ring = SampleRing()
    fill(ring, trace)
    again = ring.trace(since_s=-np.inf)
    assert again is not None
    assert not again.valid[1005:1035].any()
    assert again.valid[:1000].all()
    assert again.valid[1040:].all()


def test_a_silent_channel_gives_no_trace():
    ring = SampleRing()
    for i in range(100):
        readings = one_value(i / 100.0)
        ring.put({name: series for name, series in readings.items() if name != "roll_rate_radps"})
    assert ring.trace(since_s=-np.inf) is None
    assert ring.trace(since_s=-np.inf, missing=("roll_rate_radps",)) is not None


def test_channels_at_their_own_rates_meet_on_one_grid():
    ring = SampleRing()
    fast, slow = np.arange(0.0, 10.0, 0.01), np.arange(0.003, 10.0, 0.02)
    times = {name: slow if name == "steer_rad" else fast for name in CHANNELS}
    ring.put({name: Series(time_s, np.sin(time_s)) for name, time_s in times.items()})
    trace = ring.trace(since_s=0.5)
    assert trace is not None
    assert trace.valid[5:-5].all()
    assert np.allclose(trace.steer_rad[5:-5], np.sin(trace.time_s)[5:-5], atol=1e-3)


def test_values_that_come_late_are_dropped_and_counted():
    ring = SampleRing()
    ring.put(one_value(1.0))
    ring.put(one_value(0.9))
    ring.put(one_value(1.0))
    assert ring.counts.late_count == 2 * len(CHANNELS)


def test_a_sender_that_begins_anew_leaves_nothing_old_behind():
    ring = SampleRing()
    fill(ring, wavy_trace())
    for i in range(200):
        ring.put(one_value(i / 100.0))
    again = ring.trace(since_s=-np.inf)
    assert again is not None
    assert again.time_s[-1] == pytest.approx(1.99)
    assert ring.counts.reset_count == len(CHANNELS)


def test_a_clock_that_leaps_forward_costs_no_memory():
    ring = SampleRing(duration_s=10.0)
    fill(ring, wavy_trace(500))
    for i in range(200):
        ring.put(one_value(1e9 + i / 100.0))
    again = ring.trace(since_s=-np.inf)
    assert again is not None
    assert again.samples_count <= 1001


def test_channels_that_nobody_asked_for_are_counted():
    ring = SampleRing()
    ring.put({"outside_temperature": Series(np.array([1.0]), np.array([5.0]))})
    assert ring.counts.unknown_count == 1


def test_the_odometer_follows_the_wheels_and_is_remembered():
    ring = SampleRing()
    fill(ring, a_trace(2000))  # 15 m/s for 20 s
    assert ring.driven_m == pytest.approx(300.0, abs=3.0)
    assert ring.speed_mps == 15.0
    assert ring.time_at(150.0) == pytest.approx(10.0, abs=0.3)
    assert ring.time_at(-5.0) == -np.inf


def test_one_wheel_that_spins_does_not_move_the_car():
    ring = SampleRing()
    for i in range(1000):
        at = np.array([i / 100.0])
        ring.put({name: Series(at, np.array([60.0 if name == WHEEL_COLUMNS[2] else 10.0])) for name in WHEEL_COLUMNS})
    assert ring.driven_m == pytest.approx(99.9)


@settings(max_examples=30, deadline=None)
@given(
    batches=st.lists(st.lists(st.floats(-5.0, 50.0), min_size=1, max_size=8), max_size=12),
    duration_s=st.sampled_from([0.1, 1.0]),
)
def test_whatever_the_times_a_trace_is_on_the_grid_and_bounded(batches, duration_s):
    ring = SampleRing(duration_s=duration_s)
    for batch in batches:
        times = np.array(batch)
        ring.put({name: Series(times, np.ones(len(times))) for name in CHANNELS})
    trace = ring.trace(since_s=-np.inf)
    if trace is not None:
        assert np.allclose(np.diff(trace.time_s), 0.01)
        assert np.isfinite(trace.accel_x_mps2).all()

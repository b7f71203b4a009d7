"""Whatever comes in, the onboard client answers: a summary of finite numbers, a refusal, or an error that says why."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.errors import TraceError
from roadgrip.records import Rejected
from tests.vehicle_client.synthetic import drive_over, fixes_of, road, s_turn, surveyed
from vehicle_client.estimation.trace import GnssTrack, Trace, part_of
from vehicle_client.pipeline import Summarised, summarise_passage

SECTION = surveyed(road(s_turn))
TRACE, STATION = drive_over(s_turn)
GNSS = fixes_of(SECTION, TRACE.time_s, STATION, rng=np.random.default_rng(1), noise_m=1.0)
CHANNELS = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad")

numbers = st.one_of(
    st.floats(-50.0, 50.0), st.floats(), st.sampled_from([0.0, 1e308, -1e308, 1e-308, np.inf, -np.inf, np.nan, 1e9])
)


def answer(trace: Trace) -> Summarised | Rejected | None:
    try:
        outcome = summarise_passage(trace, SECTION)
    except TraceError:
        return None
    if isinstance(outcome, Summarised):
        assert np.isfinite(outcome.summary.values).all()
        assert outcome.summary.duration_s > 0.0
    else:
        assert outcome.detail
    return outcome


@settings(max_examples=150, deadline=None)
@given(count=st.integers(0, 400), values=st.lists(numbers, min_size=1, max_size=12), seed=st.integers(0, 2**32 - 1))
def test_any_numbers_of_any_length_have_an_answer(count, values, seed):
    rng = np.random.default_rng(seed)
    pool = np.array(values)
    answer(
        Trace(
            time_s=0.01 * np.arange(count),
            **{name: rng.choice(pool, count) for name in CHANNELS},
            wheel_speed_mps=rng.choice(pool, (count, 4)),
            valid=rng.random(count) < rng.random(),
            stability_active=rng.random(count) < 0.5,
        )
    )


@settings(max_examples=100, deadline=None)
@given(
    name=st.sampled_from([*CHANNELS, "wheel_speed_mps"]),
    value=numbers,
    start=st.integers(0, 3600),
    count=st.integers(1, 3600),
    adds=st.booleans(),
    masked=st.booleans(),
    with_gnss=st.booleans(),
)
def test_a_drive_with_a_stretch_of_garbage_has_an_answer(  # noqa: PLR0917 - hypothesis names them
    name, value, start, count, adds, masked, with_gnss
):
    values = getattr(TRACE, name).copy()
    stretch = slice(start, start + count)
    with np.errstate(over="ignore"):
        values[stretch] = values[stretch] + value if adds else value
    valid = TRACE.valid.copy()
    valid[stretch] &= not masked
    answer(replace(TRACE, **{name: values}, valid=valid, gnss=GNSS if with_gnss else None))


@settings(max_examples=100, deadline=None)
@given(
    field=st.sampled_from(["time_s", "lat_deg", "lon_deg", "accuracy_m", "speed_mps"]),
    value=numbers,
    start=st.integers(0, 400),
    every=st.integers(1, 60),
    adds=st.booleans(),
)
def test_positions_of_garbage_have_an_answer(field, value, start, every, adds):
    track = replace(GNSS, speed_mps=np.full(len(GNSS.time_s), 15.0))
    values = getattr(track, field).copy()
    with np.errstate(over="ignore"):
        values[start::every] = values[start::every] + value if adds else value
    answer(replace(TRACE, gnss=replace(track, **{field: values})))


@settings(max_examples=40, deadline=None)
@given(values=st.lists(st.tuples(numbers, numbers, numbers, numbers, numbers), max_size=30))
def test_a_receiver_of_nothing_but_garbage_has_an_answer(values):
    columns = np.array(values, dtype=np.float64).reshape(-1, 5).T
    answer(replace(TRACE, gnss=GnssTrack(*columns)))


@settings(max_examples=60, deadline=None)
@given(from_s=st.floats(0.0, 36.0), length_s=st.floats(0.0, 36.0), missing=st.floats(0.0, 1.0), seed=st.integers(0, 99))
def test_any_part_of_a_drive_with_any_mask_has_an_answer(from_s, length_s, missing, seed):
    try:
        part = part_of(TRACE, from_s=from_s, to_s=from_s + length_s)
    except TraceError:
        return
    kept = np.random.default_rng(seed).random(part.samples_count) >= missing
    noise = np.where(kept, part.yaw_rate_radps, np.nan)
    answer(replace(part, valid=kept, yaw_rate_radps=noise))

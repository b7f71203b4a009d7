"""Laws of the onboard client as a whole: what must not matter, does not."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from roadgrip.features import PAPER_TABLE, STATISTICS, summary_for
from roadgrip.units import FloatArray
from tests.vehicle_client.synthetic import drive_over, fixes_of, negative, road, s_turn, surveyed, with_noise
from vehicle_client.estimation.trace import Trace, mirrored, part_of
from vehicle_client.mapmatch.match import MatchMethod
from vehicle_client.pipeline import Summarised, summarise_passage

SECTION = surveyed(road(s_turn))
CLEAN, STATION = drive_over(s_turn, swing_mps=1.0, approach_m=300.0, exit_m=120.0)
TRACE = with_noise(CLEAN, np.random.default_rng(2))
ENTRY, EXIT = (int(np.searchsorted(STATION, at)) for at in (0.0, 400.0))
SENSORS = ("accel_x_mps2", "accel_y_mps2", "roll_rate_radps", "yaw_rate_radps", "steer_rad")
HAS_UNIT = np.array([bool(feature.unit) for feature in PAPER_TABLE.kinematic]).reshape(5, -1)
"""Skewness and kurtosis of a sideslip that is next to nothing are those of the noise."""


def made(trace: Trace, section=SECTION) -> Summarised:
    outcome = summarise_passage(trace, section)
    assert isinstance(outcome, Summarised), outcome
    return outcome


def table(trace: Trace, section=SECTION) -> FloatArray:
    """Return the summary, one signal a row: steering, sideslip, its rate, excess yaw rate, speed. (5, 11)"""
    return np.array(summary_for(made(trace, section).summary, PAPER_TABLE).values).reshape(5, -1)


def moved(trace: Trace, *, reference: FloatArray) -> FloatArray:
    """Return by how much the worst statistic of each signal moved, in its standard deviations. (5,)"""
    change = np.abs(table(trace) - reference) / reference[:, [STATISTICS.index("std")]]
    return np.asarray(np.where(HAS_UNIT, change, 0.0).max(axis=1))


@pytest.mark.parametrize("offset_s", [-50.0, 1e6, 1e9])
@pytest.mark.parametrize("with_gnss", [False, True])
def test_where_the_clock_began_does_not_matter(offset_s, with_gnss):
    gnss = fixes_of(SECTION, TRACE.time_s, STATION, rng=np.random.default_rng(1), noise_m=0.5) if with_gnss else None
    here = made(replace(TRACE, gnss=gnss))
    late = None if gnss is None else replace(gnss, time_s=gnss.time_s + offset_s)
    there = made(replace(TRACE, time_s=TRACE.time_s + offset_s, gnss=late))
    assert there.summary.values == pytest.approx(here.summary.values, rel=1e-9, abs=1e-12)
    assert there.summary.quality == here.summary.quality
    assert there.match.entry_s - offset_s == pytest.approx(here.match.entry_s, abs=1e-6)
    assert there.left_at_s - offset_s == pytest.approx(here.left_at_s, abs=1e-6)


def test_the_mirrored_drive_with_fixes_on_the_mirrored_road_has_the_mirrored_summary():
    # A metre beside the centre line, so that fixes and map have a left and a right as well.
    rng, beyond = np.random.default_rng(1), surveyed(road(negative(s_turn)))
    fixes = fixes_of(SECTION, TRACE.time_s, STATION, rng=rng, lateral_m=1.0)
    there_fixes = fixes_of(beyond, TRACE.time_s, STATION, rng=rng, lateral_m=-1.0)
    here, there = made(replace(TRACE, gnss=fixes)), made(replace(mirrored(TRACE), gnss=there_fixes), beyond)
    assert here.match.method is there.match.method is MatchMethod.GNSS
    partner = {"q20": "q80", "q40": "q60", "min": "max"}
    partner |= {other: one for one, other in partner.items()}
    swapped = [STATISTICS.index(partner.get(name, name)) for name in STATISTICS]
    sign = np.where(np.isin(STATISTICS, ["std", "kurtosis"]), 1.0, -1.0)
    seen, mirror = (np.array(summary_for(one.summary, PAPER_TABLE).values).reshape(5, -1) for one in (here, there))
    assert np.allclose(mirror[:4], sign * seen[:4, swapped], rtol=0.0, atol=1e-9)
    assert np.allclose(mirror[4], seen[4], rtol=0.0, atol=1e-9)
    assert there.summary.quality == here.summary.quality


def test_a_trace_is_only_read_and_says_the_same_twice():
    trace = replace(TRACE, valid=np.arange(TRACE.samples_count) != ENTRY + 300)
    before: dict[str, Any] = {field.name: getattr(trace, field.name) for field in fields(Trace)}
    for values in before.values():
        if isinstance(values, np.ndarray):
            values.flags.writeable = False
    try:
        assert made(trace).summary == made(trace).summary
    finally:
        for values in before.values():
            if isinstance(values, np.ndarray):
                values.flags.writeable = True


@pytest.mark.parametrize(("from_s", "before_end_s"), [(2.0, 0.0), (6.0, 5.0), (12.0, 5.0)])
def test_where_the_trace_was_cut_does_not_matter(from_s, before_end_s):
    # Eight seconds of approach instead of twenty: how well the offsets are known differs, and the excess yaw rate of
    # a car that does not slide is hardly more than they are. Measured: 0.0002, 0.003, 0.012, 0.04, 6e-6.
    cut = part_of(TRACE, from_s=from_s, to_s=float(TRACE.time_s[-1]) - before_end_s)
    assert (moved(cut, reference=table(TRACE)) < [0.001, 0.02, 0.03, 0.1, 1e-4]).all()


@pytest.mark.parametrize("seed", range(4))
def test_samples_that_are_taken_two_milliseconds_off_change_little(seed):
    # Measured: 0.0006, 0.0005, 0.009, 0.05, 0.0005 of a standard deviation.
    at_s = TRACE.time_s + np.random.default_rng(seed).uniform(-0.002, 0.002, TRACE.samples_count)
    channels: dict[str, Any] = {name: np.interp(at_s, TRACE.time_s, getattr(CLEAN, name)) for name in SENSORS}
    wheels = np.column_stack([np.interp(at_s, TRACE.time_s, CLEAN.wheel_speed_mps[:, i]) for i in range(4)])
    jittered = with_noise(replace(CLEAN, **channels, wheel_speed_mps=wheels), np.random.default_rng(2))
    assert (moved(jittered, reference=table(TRACE)) < [0.005, 0.01, 0.05, 0.15, 0.005]).all()


@pytest.mark.parametrize("share", np.linspace(0.03, 0.95, 12))
def test_a_missing_fifth_of_a_second_changes_little_wherever_it_is(share):
    # Measured: 0.05, 0.17, 0.43, 0.02, 0.02. The rate of the sideslip moves most: its extremes are single samples.
    valid = TRACE.valid.copy()
    start = ENTRY + round(share * (EXIT - ENTRY - 20))
    valid[start : start + 20] = False
    assert (moved(replace(TRACE, valid=valid), reference=table(TRACE)) < [0.15, 0.4, 0.8, 0.1, 0.1]).all()

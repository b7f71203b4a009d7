"""A drive and a map in, a summary or a refusal out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.errors import TraceError
from roadgrip.features import NEWEST_TABLE, STATISTICS, TABLES
from roadgrip.records import QualityFlag, Reason, Rejected
from roadgrip.units import GRAVITY_MPS2
from tests.vehicle_client.synthetic import (
    clock_s,
    drive_over,
    fixes_of,
    motion,
    negative,
    road,
    s_turn,
    surveyed,
    with_noise,
)
from vehicle_client.estimation.mounting import mounting_rotation
from vehicle_client.estimation.observer import PAPER_PARAMETERS
from vehicle_client.estimation.offsets import NO_OFFSETS
from vehicle_client.estimation.signals import kinematic_signals
from vehicle_client.estimation.trace import Trace, mirrored, part_of
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.mapmatch.match import MatchMethod
from vehicle_client.pipeline import Summarised, summarise_passage

SECTION = road(s_turn)
TRACE, STATION = drive_over(s_turn)
ENTRY = int(np.searchsorted(STATION, 0.0))
"""The synthetic car has no sideslip at its centre of gravity, as the paper expects; one that rolls has some."""


def made(outcome) -> Summarised:
    assert isinstance(outcome, Summarised), outcome
    return outcome


def refused(outcome) -> Reason:
    assert isinstance(outcome, Rejected), outcome
    return outcome.reason


def table(summary) -> dict[str, float]:
    return dict(zip((f.name for f in TABLES[summary.table_digest].kinematic), summary.values, strict=True))


def quantities(summary) -> list[float]:
    """Return the features that have a unit; the shape of a signal that is almost zero means nothing."""
    return [v for v, f in zip(summary.values, TABLES[summary.table_digest].kinematic, strict=True) if f.unit]


def statistics_in(summary):
    """Return the statistics of a summary, a signal a row. (5, 11)"""
    return np.array(summary.values)[TABLES[summary.table_digest].statistics_columns]


def signals_of(trace: Trace, section=SECTION, station_m=None, parameters=PAPER_PARAMETERS):
    return kinematic_signals(
        trace,
        section,
        station_m=np.zeros(trace.samples_count) if station_m is None else station_m,
        vehicle=XC90,
        parameters=parameters,
        offsets=NO_OFFSETS,
    )


# Known answers -------------------------------------------------------------------------------------------------------


def test_a_drive_without_sideslip_is_summarised_as_one():
    result = made(summarise_passage(TRACE, SECTION, parameters=PAPER_PARAMETERS))
    values = table(result.summary)
    assert result.summary.table_digest == NEWEST_TABLE.digest
    assert result.summary.duration_s == pytest.approx(400.0 / 15.0, abs=0.02)
    assert values["speed_mean_mps"] == pytest.approx(15.0, abs=1e-3)
    assert values["speed_std_mps"] < 1e-3
    for name in ("sideslip_max_rad", "sideslip_min_rad", "sideslip_rate_max_radps", "yaw_rate_excess_max_radps"):
        assert abs(values[name]) < 1e-3, name
    inside = result.match.inside(TRACE.time_s)
    assert values["steer_max_rad"] == pytest.approx(TRACE.steer_rad[inside].max(), rel=1e-2)
    assert values["steer_min_rad"] == pytest.approx(TRACE.steer_rad[inside].min(), rel=1e-2)


def test_signals_of_a_steady_circle_are_constant():
    trace = motion(np.full(1000, 12.0), np.full(1000, 0.2))
    signals = signals_of(trace)
    assert np.allclose(signals.speed_mps, 12.0, atol=1e-9)
    assert np.allclose(signals.sideslip_rad, 0.0, atol=1e-9)
    assert np.allclose(signals.yaw_rate_excess_radps, 0.0, atol=1e-9)
    assert np.allclose(signals.chassis_roll_rad, 0.0, atol=1e-9)


def test_steering_more_than_the_car_yaws_is_understeer():
    trace = motion(np.full(1000, 12.0), np.full(1000, 0.2))
    signals = signals_of(replace(trace, steer_rad=trace.steer_rad + 0.02))
    expected = 0.2 - 2.0 * 12.0 * np.tan(trace.steer_rad[0] + 0.02) / (
        2.0 * XC90.wheelbase_m + XC90.track_m * np.tan(trace.steer_rad[0] + 0.02)
    )
    # The wheels point elsewhere than the car rolls, so the speed they tell is a little off.
    assert np.allclose(signals.yaw_rate_excess_radps, expected, atol=2e-3)
    assert expected < -0.05


def test_quick_sideslip_is_seen_in_time_and_sign():
    # 0.5 Hz of sideslip at 20 m/s on a straight; the pull to zero takes a part of it, never its sign.
    time = clock_s(2000)
    vy = 0.8 * np.sin(2.0 * np.pi * 0.5 * time)
    trace = motion(np.full(2000, 20.0), np.zeros(2000), velocity_y_mps=vy)
    found = signals_of(trace).sideslip_rad[300:-300]
    truth = np.arctan(vy / 20.0)[300:-300]
    assert np.corrcoef(found, truth)[0, 1] > 0.98
    assert 0.5 < (found @ truth) / (truth @ truth) < 1.0


@pytest.mark.parametrize("slope", [-0.06, 0.04])
def test_the_bank_of_the_map_is_not_taken_for_sliding(slope):
    section = road(s_turn, cross_slope_ratio=slope)
    trace, station = drive_over(s_turn, tilt_rad=float(np.arctan(slope)))
    signals = signals_of(trace, section, station)
    assert np.abs(signals.sideslip_rad).max() < 2e-3
    assert np.abs(signals.chassis_roll_rad).max() < 1e-3
    assert (
        np.abs(made(summarise_passage(trace, section, parameters=PAPER_PARAMETERS)).signals.sideslip_rad).max() < 2e-3
    )


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_mirrored_drive_on_the_mirrored_road_has_the_mirrored_summary(seed):
    trace = with_noise(TRACE, np.random.default_rng(seed))
    here = statistics_in(made(summarise_passage(trace, SECTION)).summary)
    there = statistics_in(made(summarise_passage(mirrored(trace), road(negative(s_turn)))).summary)
    column = {name: i for i, name in enumerate(STATISTICS)}
    swapped = {"mean": "mean", "q20": "q80", "q40": "q60", "q60": "q40", "q80": "q20", "min": "max", "max": "min"}
    swapped |= {"median": "median", "skewness": "skewness"}
    for name, partner in swapped.items():
        assert np.allclose(there[:4, column[name]], -here[:4, column[partner]], atol=1e-6), name
    for name in ("std", "kurtosis"):
        assert np.allclose(there[:4, column[name]], here[:4, column[name]], atol=1e-6), name
    assert np.allclose(there[4], here[4], atol=1e-6)


def test_approach_and_exit_do_not_leak_into_the_summary():
    # Another approach, another exit, the same section: what remains is the memory of filters and observer.
    short = made(summarise_passage(TRACE, SECTION)).summary
    trace, _ = drive_over(s_turn, approach_m=200.0, exit_m=150.0)
    assert np.allclose(quantities(made(summarise_passage(trace, SECTION)).summary), quantities(short), atol=1e-3)


@pytest.mark.parametrize(
    ("roll_rad", "pitch_rad", "yaw_rad"),
    [(0.05, 0.0, 0.0), (0.6, 0.0, 0.0), (0.0, -0.5, 0.0), (0.0, 0.0, np.pi), (0.3, 0.2, -0.4)],
)
def test_however_the_sensor_is_mounted_the_summary_is_the_same(roll_rad, pitch_rad, yaw_rad):
    # From the first step on: gravity's share in a tilted sensor is no climb, no slide, no offset and no fault.
    vehicle = replace(XC90, imu_roll_rad=roll_rad, imu_pitch_rad=pitch_rad, imu_yaw_rad=yaw_rad)
    trace = with_noise(drive_over(s_turn, swing_mps=1.0)[0], np.random.default_rng(6))
    n, back = trace.samples_count, mounting_rotation(vehicle).T
    force = back @ np.vstack([trace.accel_x_mps2, trace.accel_y_mps2, np.full(n, GRAVITY_MPS2)])
    rate = back @ np.vstack([trace.roll_rate_radps, np.zeros(n), trace.yaw_rate_radps])
    turned = replace(
        trace, accel_x_mps2=force[0], accel_y_mps2=force[1], roll_rate_radps=rate[0], yaw_rate_radps=rate[2]
    )
    here, there = made(summarise_passage(trace, SECTION)), made(summarise_passage(turned, SECTION, vehicle=vehicle))
    assert np.allclose(there.summary.values, here.summary.values, rtol=0.0, atol=1e-9)
    assert there.summary.quality == here.summary.quality


@pytest.mark.parametrize("slope", [-0.08, 0.0, 0.05])
def test_the_bank_of_the_map_places_the_roll_and_changes_nothing_else(slope):
    # The accelerometer feels body and road as one tilt; what the map calls bank is only no roll of the body.
    trace = with_noise(TRACE, np.random.default_rng(4))
    level, banked = signals_of(trace), signals_of(trace, road(s_turn, cross_slope_ratio=slope))
    assert np.allclose(banked.sideslip_rad, level.sideslip_rad, atol=1e-12)
    assert np.allclose(banked.sideslip_rate_radps, level.sideslip_rate_radps, atol=1e-12)
    assert np.allclose(level.chassis_roll_rad - banked.chassis_roll_rad, np.arctan(slope), atol=1e-12)


# Positions -----------------------------------------------------------------------------------------------------------


def test_with_positions_the_match_rests_on_them():
    section = surveyed(SECTION)
    gnss = fixes_of(section, TRACE.time_s, STATION, rng=np.random.default_rng(1), noise_m=1.0)
    result = made(summarise_passage(replace(TRACE, gnss=gnss), section))
    assert result.match.method is MatchMethod.GNSS
    assert QualityFlag.NO_GNSS not in result.summary.quality
    assert result.left_at_s == pytest.approx(np.interp(400.0, STATION, TRACE.time_s), abs=0.2)


def test_without_positions_the_summary_says_so():
    result = made(summarise_passage(TRACE, SECTION))
    assert result.match.method is MatchMethod.DEAD_RECKONING
    assert QualityFlag.NO_GNSS in result.summary.quality


def test_with_and_without_positions_the_summary_is_nearly_the_same():
    section = surveyed(SECTION)
    gnss = fixes_of(section, TRACE.time_s, STATION, rng=np.random.default_rng(1), noise_m=1.0)
    seen = made(summarise_passage(replace(TRACE, gnss=gnss), section)).summary
    blind = made(summarise_passage(TRACE, section)).summary
    with_unit = [feature.name for feature in TABLES[seen.table_digest].kinematic if feature.unit]
    # Of these one is a log-likelihood, summed over the drive, the other tells of the part that knows little.
    rough = np.isin(with_unit, ["grip_parts_gain_ratio", "grip_firm_below_1sd_ratio"])
    there, blindly = np.array(quantities(seen)), np.array(quantities(blind))
    assert np.allclose(there[~rough], blindly[~rough], atol=2e-3)
    assert np.allclose(there[rough], blindly[rough], rtol=0.02)


# Quality -------------------------------------------------------------------------------------------------------------


def test_an_approach_that_says_nothing_about_offsets_is_flagged():
    trace, _ = drive_over(s_turn, approach_m=5.0)
    assert QualityFlag.OFFSETS_UNCERTAIN in made(summarise_passage(trace, SECTION)).summary.quality
    assert QualityFlag.OFFSETS_UNCERTAIN not in made(summarise_passage(TRACE, SECTION)).summary.quality


def test_stability_control_at_work_is_flagged_where_it_worked_inside():
    active = np.zeros(TRACE.samples_count, dtype=bool)
    active[ENTRY - 100 : ENTRY - 50] = True
    before = made(summarise_passage(replace(TRACE, stability_active=active), SECTION))
    assert QualityFlag.STABILITY_ACTIVE not in before.summary.quality
    active = active.copy()
    active[ENTRY + 300] = True
    inside = made(summarise_passage(replace(TRACE, stability_active=active), SECTION))
    assert QualityFlag.STABILITY_ACTIVE in inside.summary.quality


def test_what_is_known_of_a_recording_is_passed_on():
    result = made(summarise_passage(replace(TRACE, quality=QualityFlag.REFERENCE_SPEED), SECTION))
    assert QualityFlag.REFERENCE_SPEED in result.summary.quality


# Refusals ------------------------------------------------------------------------------------------------------------


def without(trace: Trace, start: int, count: int) -> Trace:
    valid = trace.valid.copy()
    valid[start : start + count] = False
    return replace(trace, yaw_rate_radps=np.where(valid, trace.yaw_rate_radps, np.nan), valid=valid)


def test_a_short_gap_is_bridged_and_flagged():
    result = made(summarise_passage(without(TRACE, ENTRY + 500, 20), SECTION))
    assert QualityFlag.SAMPLES_MISSING in result.summary.quality
    whole = made(summarise_passage(TRACE, SECTION))
    assert np.allclose(quantities(result.summary), quantities(whole.summary), atol=2e-3)


def test_a_long_gap_inside_is_refused():
    assert refused(summarise_passage(without(TRACE, ENTRY + 500, 35), SECTION)) is Reason.TOO_MANY_GAPS


def test_a_long_gap_on_the_approach_does_no_harm():
    result = made(summarise_passage(without(TRACE, 50, 60), SECTION))
    assert QualityFlag.SAMPLES_MISSING not in result.summary.quality


def test_many_short_gaps_are_refused():
    trace = TRACE
    for start in range(ENTRY, ENTRY + 2000, 100):
        trace = without(trace, start, 10)
    assert refused(summarise_passage(trace, SECTION)) is Reason.TOO_MANY_GAPS


def test_a_gap_that_hides_a_bend_is_called_a_gap():
    assert refused(summarise_passage(without(TRACE, ENTRY + 400, 800), SECTION)) is Reason.TOO_MANY_GAPS


def test_a_silent_recording_is_too_short():
    assert refused(summarise_passage(without(TRACE, 0, TRACE.samples_count), SECTION)) is Reason.TOO_SHORT


def test_a_recording_of_half_a_second_is_too_short():
    assert refused(summarise_passage(motion(np.full(50, 15.0), np.zeros(50)), SECTION)) is Reason.TOO_SHORT


def test_standing_still_inside_is_refused():
    middle = ENTRY + 1000
    stand = motion(np.full(300, 0.0), np.zeros(300), steer_rad=np.zeros(300))
    parts = [(TRACE, slice(0, middle)), (stand, slice(None)), (TRACE, slice(middle, None))]

    def joined(name):
        return np.concatenate([getattr(trace, name)[part] for trace, part in parts])

    names = (
        "accel_x_mps2",
        "accel_y_mps2",
        "roll_rate_radps",
        "yaw_rate_radps",
        "steer_rad",
        "wheel_speed_mps",
        "valid",
    )
    trace = Trace(time_s=clock_s(TRACE.samples_count + 300), **{name: joined(name) for name in names})
    assert refused(summarise_passage(trace, SECTION)) is Reason.TOO_SLOW


def test_the_mirrored_road_is_the_wrong_one():
    assert refused(summarise_passage(TRACE, road(negative(s_turn)))) is Reason.WRONG_ROAD


def test_a_drive_that_ends_on_the_way_is_aborted():
    driven_s = TRACE.time_s[STATION < 300.0] - TRACE.time_s[0]
    trace = part_of(TRACE, from_s=0.0, to_s=float(driven_s[-1]))
    assert refused(summarise_passage(trace, SECTION)) is Reason.PASSAGE_ABORTED


def test_arrays_that_do_not_fit_are_an_error():
    with pytest.raises(TraceError):
        summarise_passage(replace(TRACE, steer_rad=TRACE.steer_rad[:-1]), SECTION)


def test_a_sensor_that_wakes_late_is_not_blamed_for_a_wrong_road():
    trace = without(TRACE, 0, 40)
    assert refused(summarise_passage(trace, road(negative(s_turn)))) is Reason.WRONG_ROAD

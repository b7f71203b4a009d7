"""Each flag of a summary is set exactly when it should be, and a fault is named."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.records import QualityFlag, Reason, Rejected
from tests.vehicle_client.synthetic import drive_over, fixes_of, road, s_turn, surveyed, with_noise
from vehicle_client.estimation.trace import Trace
from vehicle_client.pipeline import Summarised, summarise_passage

SECTION = surveyed(road(s_turn))
CLEAN, STATION = drive_over(s_turn, swing_mps=1.0)
TRACE = with_noise(CLEAN, np.random.default_rng(2))
ENTRY, EXIT = (int(np.searchsorted(STATION, at)) for at in (0.0, 400.0))
GNSS = fixes_of(SECTION, TRACE.time_s, STATION, rng=np.random.default_rng(1), noise_m=0.5)


def quality(trace: Trace) -> QualityFlag:
    outcome = summarise_passage(trace, SECTION)
    assert isinstance(outcome, Summarised), outcome
    return outcome.summary.quality


def refusal(trace: Trace) -> Rejected:
    outcome = summarise_passage(trace, SECTION)
    assert isinstance(outcome, Rejected)
    return outcome


def lost(trace: Trace, start: int, count: int) -> Trace:
    valid = trace.valid.copy()
    valid[start : start + count] = False
    return replace(trace, valid=valid)


def test_a_good_drive_with_fixes_has_no_flag():
    assert quality(replace(TRACE, gnss=GNSS)) == QualityFlag.NONE


def test_a_good_drive_without_fixes_says_just_that():
    assert quality(TRACE) == QualityFlag.NO_GNSS


def test_fixes_that_motion_replaces_are_named_poor_and_not_used():
    late = replace(GNSS, time_s=GNSS.time_s + 1.0)
    assert quality(replace(TRACE, gnss=late)) == QualityFlag.NO_GNSS | QualityFlag.GNSS_POOR


def test_fixes_that_are_sparse_and_yet_used_are_named_poor_alone():
    sparse = GNSS.where(np.arange(len(GNSS.time_s)) % 30 == 0)
    assert quality(replace(TRACE, gnss=sparse)) == QualityFlag.GNSS_POOR


@pytest.mark.parametrize(
    ("start", "flagged"),
    [(ENTRY - 30, False), (ENTRY - 5, True), (ENTRY + 800, True), (EXIT - 5, True), (EXIT + 20, False)],
)
def test_samples_are_missing_where_they_are_missing_inside(start, flagged):
    assert (QualityFlag.SAMPLES_MISSING in quality(lost(replace(TRACE, gnss=GNSS), start, 10))) is flagged


@pytest.mark.parametrize(
    ("at", "flagged"), [(ENTRY - 20, False), (ENTRY + 20, True), (EXIT - 20, True), (EXIT + 20, False)]
)
def test_stability_control_counts_where_it_works_inside(at, flagged):
    active = np.zeros(TRACE.samples_count, dtype=bool)
    active[at] = True
    assert (QualityFlag.STABILITY_ACTIVE in quality(replace(TRACE, gnss=GNSS, stability_active=active))) is flagged


def test_a_car_that_does_not_report_interventions_is_not_flagged():
    assert QualityFlag.STABILITY_ACTIVE not in quality(replace(TRACE, stability_active=None))


def test_offsets_are_uncertain_without_a_straight_before():
    assert QualityFlag.OFFSETS_UNCERTAIN not in quality(TRACE)
    short, _ = drive_over(s_turn, approach_m=5.0)
    assert QualityFlag.OFFSETS_UNCERTAIN in quality(short)


def test_a_small_contradiction_is_a_flag_and_a_large_one_a_refusal_that_names_the_sensor():
    share = np.clip((np.arange(TRACE.samples_count) - ENTRY - 600) / 200.0, 0.0, 1.0)
    wandering = replace(TRACE, steer_rad=TRACE.steer_rad + 0.01 * share)
    assert quality(wandering) == QualityFlag.NO_GNSS | QualityFlag.SENSORS_DOUBTFUL
    outcome = refusal(replace(TRACE, steer_rad=TRACE.steer_rad + 0.03 * share))
    assert outcome.reason is Reason.SENSOR_FAULT
    assert "steering angle" in outcome.detail


@pytest.mark.parametrize("with_gnss", [False, True])
@pytest.mark.parametrize("gain", [0.0, -1.0])
def test_a_gyro_that_lies_is_named_with_fixes_and_without(gain, with_gnss):
    lying = replace(TRACE, yaw_rate_radps=gain * TRACE.yaw_rate_radps, gnss=GNSS if with_gnss else None)
    outcome = refusal(lying)
    assert outcome.reason is Reason.SENSOR_FAULT
    assert "gyro" in outcome.detail


def test_with_fixes_the_map_tells_of_a_gyro_that_is_off_by_a_tenth():
    off = replace(TRACE, yaw_rate_radps=1.13 * TRACE.yaw_rate_radps, gnss=GNSS)
    assert QualityFlag.SENSORS_DOUBTFUL in quality(off)


def test_a_drive_elsewhere_blames_no_sensor():
    elsewhere, _ = drive_over(lambda s: -s_turn(s))
    outcome = refusal(with_noise(elsewhere, np.random.default_rng(3)))
    assert outcome.reason is Reason.WRONG_ROAD

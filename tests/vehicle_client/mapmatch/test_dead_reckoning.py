"""Finding the section without satellites."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.records import Reason, Rejected
from tests.vehicle_client.synthetic import bump, clock_s, drive_over, negative, road, s_turn
from vehicle_client.mapmatch.dead_reckoning import driven_line, match_by_dead_reckoning
from vehicle_client.mapmatch.match import MatchMethod, SectionMatch


def hairpin(station_m):
    return bump(station_m, start_m=80.0, length_m=200.0, peak_1pm=1 / 40.0)


def speed_of(trace):
    return trace.wheel_speed_mps[:, 2:].mean(axis=1)


def matched(trace, section, *, drift_radps=0.0, scale_ratio=1.0):
    line = driven_line(scale_ratio * speed_of(trace), trace.yaw_rate_radps + drift_radps)
    return match_by_dead_reckoning(line, trace.time_s, section)


def found(outcome) -> SectionMatch:
    assert isinstance(outcome, SectionMatch), outcome
    return outcome


def refused(outcome) -> Reason:
    assert isinstance(outcome, Rejected), outcome
    return outcome.reason


def test_a_circle_closes():
    line = driven_line(np.full(1001, 2.0 * np.pi), np.full(1001, 2.0 * np.pi / 10.0))
    assert line.distance_m[-1] == pytest.approx(20.0 * np.pi)
    assert line.heading_rad[-1] == pytest.approx(2.0 * np.pi)
    assert np.hypot(line.x_m[-1], line.y_m[-1]) < 1e-9
    assert line.y_m.max() == pytest.approx(20.0, abs=1e-3)


def test_sliding_sideways_moves_the_line():
    line = driven_line(np.zeros(101), np.zeros(101), np.full(101, 2.0))
    assert (line.x_m[-1], line.y_m[-1]) == pytest.approx((0.0, 2.0))
    assert line.distance_m[-1] == pytest.approx(2.0)


def test_a_perfect_drive_is_found_to_the_decimetre():
    section = road(s_turn)
    trace, station = drive_over(s_turn, swing_mps=2.0)
    match = found(matched(trace, section))
    assert np.abs(match.station_m - station).max() < 0.1
    assert match.entry_s == pytest.approx(np.interp(0.0, station, trace.time_s), abs=0.01)
    assert match.exit_s == pytest.approx(np.interp(400.0, station, trace.time_s), abs=0.01)
    assert match.confidence_frac > 0.999
    assert match.method is MatchMethod.DEAD_RECKONING


@settings(max_examples=25, deadline=None)
@given(
    approach_m=st.floats(0.0, 300.0),
    exit_m=st.floats(0.0, 300.0),
    scale_ratio=st.floats(0.99, 1.01),
    drift_radps=st.floats(-0.004, 0.004),
    speed_mps=st.floats(8.0, 25.0),
)
def test_wrong_tyres_and_a_drifting_gyro_cost_metres_at_most(approach_m, exit_m, scale_ratio, drift_radps, speed_mps):
    section = road(s_turn)
    trace, station = drive_over(s_turn, approach_m=approach_m, exit_m=exit_m, speed_mps=speed_mps)
    outcome = matched(trace, section, drift_radps=drift_radps, scale_ratio=scale_ratio)
    if isinstance(outcome, Rejected):
        # Half a metre of odometer makes a drive without approach and exit look shorter than the section.
        assert approach_m + exit_m < 10.0
        return
    inside = outcome.inside(trace.time_s)
    assert np.abs(outcome.station_m - station)[inside].max() < 8.0


@pytest.mark.parametrize(
    ("driven", "mapped"),
    [(s_turn, negative(s_turn)), (s_turn, hairpin), (hairpin, s_turn), (hairpin, negative(hairpin))],
)
def test_another_road_is_refused(driven, mapped):
    trace, _ = drive_over(driven)
    outcome = matched(trace, road(mapped))
    assert isinstance(outcome, Rejected)
    assert outcome.reason in {Reason.WRONG_ROAD, Reason.PASSAGE_ABORTED}


def test_the_mirrored_road_is_the_wrong_one():
    trace, _ = drive_over(s_turn)
    assert refused(matched(trace, road(negative(s_turn)))) is Reason.WRONG_ROAD


def test_the_other_direction_is_the_wrong_road():
    trace, _ = drive_over(lambda station_m: -s_turn(400.0 - station_m))
    assert refused(matched(trace, road(s_turn))) is Reason.WRONG_ROAD


def test_a_straight_drive_is_on_no_curve():
    trace, _ = drive_over(np.zeros_like)
    assert refused(matched(trace, road(s_turn))) is Reason.WRONG_ROAD


def test_a_straight_map_recognises_nothing():
    def straight(station_m):
        return np.zeros_like(station_m)

    trace, _ = drive_over(straight)
    assert isinstance(matched(trace, road(straight)), Rejected)


@pytest.mark.parametrize("share", [0.6, 0.8, 0.95])
def test_a_drive_that_ends_on_the_way_is_an_aborted_passage(share):
    trace, station = drive_over(s_turn)
    keep = station < share * 400.0
    line = driven_line(speed_of(trace)[keep], trace.yaw_rate_radps[keep])
    assert refused(match_by_dead_reckoning(line, trace.time_s[keep], road(s_turn))) is Reason.PASSAGE_ABORTED


def test_a_drive_of_a_few_metres_is_an_aborted_passage():
    line = driven_line(np.full(500, 10.0), np.zeros(500))
    assert refused(match_by_dead_reckoning(line, clock_s(500), road(s_turn))) is Reason.PASSAGE_ABORTED


def test_waiting_on_the_approach_does_not_hide_the_section():
    trace, station = drive_over(s_turn)
    stand = 1000
    speed = np.concatenate([speed_of(trace)[:100], np.zeros(stand), speed_of(trace)[100:]])
    yaw_rate = np.concatenate([trace.yaw_rate_radps[:100], np.zeros(stand), trace.yaw_rate_radps[100:]])
    match = found(match_by_dead_reckoning(driven_line(speed, yaw_rate), clock_s(len(speed)), road(s_turn)))
    assert match.entry_s == pytest.approx(np.interp(0.0, station, trace.time_s) + stand * 0.01, abs=0.05)

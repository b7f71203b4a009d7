"""Finding the section without satellites."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.records import Reason, Rejected
from roadgrip.section import build_section
from tests.vehicle_client.synthetic import bump, clock_s, drive_over, negative, road, s_turn
from vehicle_client.mapmatch.dead_reckoning import match_by_dead_reckoning
from vehicle_client.mapmatch.driven_line import driven_line, with_course
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


def hilly(curvature, *, rise_m, length_m=400.0):
    """Return the section of a curvature that climbs and falls again by so much in its middle."""
    flat = road(curvature, length_m=length_m)
    nodes = flat.nodes_m.copy()
    share = np.linspace(0.0, 1.0, len(nodes))
    nodes[:, 2] = rise_m * np.sin(np.pi * share) ** 2
    return build_section(section_id="hilly", name="Hilly", nodes_m=nodes, speed_limit_mps=22.0)


def over_hill(*, rise_m):
    trace, station = drive_over(s_turn)
    climb = np.gradient(rise_m * np.sin(np.pi * np.clip(station / 400.0, 0.0, 1.0)) ** 2, 0.01)
    return driven_line(speed_of(trace), trace.yaw_rate_radps, None, climb), trace.time_s


def test_the_height_profile_tells_two_roads_of_the_same_bends_apart():
    line, time_s = over_hill(rise_m=6.0)
    right = found(match_by_dead_reckoning(line, time_s, hilly(s_turn, rise_m=6.0)))
    other = match_by_dead_reckoning(line, time_s, hilly(s_turn, rise_m=-6.0))
    assert isinstance(other, Rejected) or other.confidence_frac < right.confidence_frac


def test_an_offset_of_the_accelerometer_does_not_matter():
    line, time_s = over_hill(rise_m=6.0)
    drifting = replace(line, height_m=line.height_m + 0.03 * line.distance_m + 500.0)
    section = hilly(s_turn, rise_m=6.0)
    plain = found(match_by_dead_reckoning(line, time_s, section))
    assert found(match_by_dead_reckoning(drifting, time_s, section)).confidence_frac == pytest.approx(
        plain.confidence_frac, abs=1e-6
    )


@settings(max_examples=15, deadline=None)
@given(drift_radps=st.floats(-0.002, 0.002), scale_ratio=st.floats(0.995, 1.005), cut=st.floats(0.9, 1.1))
def test_a_mirrored_drive_matches_a_mirrored_map_identically(drift_radps, scale_ratio, cut):
    trace, _ = drive_over(s_turn)
    speed, yaw_rate = scale_ratio * speed_of(trace), cut * trace.yaw_rate_radps + drift_radps
    here = match_by_dead_reckoning(driven_line(speed, yaw_rate), trace.time_s, road(s_turn))
    there = match_by_dead_reckoning(driven_line(speed, -yaw_rate), trace.time_s, road(negative(s_turn)))
    assert type(here) is type(there)
    if isinstance(here, SectionMatch) and isinstance(there, SectionMatch):
        assert there.station_m == pytest.approx(here.station_m, abs=1e-3)
        assert there.confidence_frac == pytest.approx(here.confidence_frac, abs=1e-4)


@settings(max_examples=15, deadline=None)
@given(turned_rad=st.floats(-20.0, 20.0), x_m=st.floats(-1e4, 1e4), y_m=st.floats(-1e4, 1e4))
def test_where_and_which_way_the_drive_set_out_does_not_matter(turned_rad, x_m, y_m):
    trace, _ = drive_over(s_turn)
    line = driven_line(speed_of(trace), trace.yaw_rate_radps)
    moved = replace(line, heading_rad=line.heading_rad + turned_rad, x_m=line.x_m + x_m, y_m=line.y_m + y_m)
    here, there = (found(match_by_dead_reckoning(one, trace.time_s, road(s_turn))) for one in (line, moved))
    assert there.station_m == pytest.approx(here.station_m, abs=1e-6)


@settings(max_examples=15, deadline=None)
@given(more_m=st.floats(0.0, 800.0))
def test_a_longer_approach_changes_no_station(more_m):
    short, _ = drive_over(s_turn, approach_m=80.0)
    long, _ = drive_over(s_turn, approach_m=80.0 + more_m)
    here, there = found(matched(short, road(s_turn))), found(matched(long, road(s_turn)))
    # The first sample of either drive lies on the approach; counted from the exit they are the same drive.
    offset = there.exit_s - here.exit_s
    times = here.exit_s - np.arange(0.0, 20.0, 0.5)
    before = np.interp(times, short.time_s, here.station_m)
    after = np.interp(times + offset, long.time_s, there.station_m)
    assert after == pytest.approx(before, abs=0.3)


def test_the_order_of_the_sections_that_are_asked_about_is_irrelevant():
    trace, _ = drive_over(s_turn)
    sections = [road(s_turn), road(hairpin), road(negative(s_turn))]

    def answers(order):
        return {order[k]: str(matched(trace, sections[order[k]])) for k in range(3)}

    assert answers([0, 1, 2]) == answers([2, 0, 1])


def test_of_two_passages_in_one_drive_the_later_one_counts():
    trace, station = drive_over(s_turn)
    line = driven_line(np.tile(speed_of(trace), 2), np.tile(trace.yaw_rate_radps, 2))
    match = found(match_by_dead_reckoning(line, clock_s(2 * len(station)), road(s_turn)))
    once = len(station) * 0.01
    assert match.entry_s == pytest.approx(once + np.interp(0.0, station, trace.time_s), abs=0.05)


def test_a_drive_that_turns_off_in_the_middle_is_no_passage():
    trace, station = drive_over(s_turn)
    on_it = station < 200.0
    away = np.full(400, 0.4)
    speed = np.concatenate([speed_of(trace)[on_it], np.full(2400, 10.0)])
    yaw_rate = np.concatenate([trace.yaw_rate_radps[on_it], away, np.zeros(2000)])
    line = driven_line(speed, yaw_rate)
    assert isinstance(match_by_dead_reckoning(line, clock_s(len(speed)), road(s_turn)), Rejected)


@settings(max_examples=60, deadline=None)
@given(
    speeds=st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=1, max_size=60),
    rates=st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=1, max_size=60),
    climbs=st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=1, max_size=60),
)
def test_garbage_is_refused_without_an_exception(speeds, rates, climbs):
    with np.errstate(all="ignore"):
        speed, rate, climb = (np.resize(np.array(v, dtype=np.float64), 1200) for v in (speeds, rates, climbs))
        line = driven_line(speed, rate, None, climb)
        outcome = match_by_dead_reckoning(line, clock_s(1200), road(s_turn))
    assert isinstance(outcome, Rejected)


def test_an_unknown_lateral_velocity_leaves_the_line_as_it_is():
    line = driven_line(np.full(200, 10.0), np.full(200, 0.1))
    assert with_course(line, speed_mps=np.full(200, 10.0), velocity_y_mps=None) is line


def test_a_course_is_the_heading_and_the_sideslip_and_moves_no_point():
    speed, left = np.full(200, 10.0), np.full(200, -1.0)
    line = driven_line(speed, np.full(200, 0.1))
    slid = with_course(line, speed_mps=speed, velocity_y_mps=left)
    assert slid.course_rad == pytest.approx(line.heading_rad - np.arctan(0.1))
    assert (slid.x_m == line.x_m).all()
    assert (slid.distance_m == line.distance_m).all()


def test_a_standing_car_has_no_course_of_its_own():
    still = np.zeros(200)
    slid = with_course(driven_line(still, still), speed_mps=still, velocity_y_mps=np.full(200, 0.02))
    assert slid.course_rad is not None
    assert np.abs(slid.course_rad).max() < 0.011


@pytest.mark.parametrize("lie", [lambda n: np.full(n, np.nan), lambda n: 8.0 * np.sin(np.arange(n) * 0.05)])
def test_a_lateral_velocity_that_lies_hides_no_road(lie):
    trace, _ = drive_over(s_turn)
    speed = speed_of(trace)
    line = driven_line(speed, trace.yaw_rate_radps)
    lied_to = with_course(line, speed_mps=speed, velocity_y_mps=lie(len(speed)))
    honest, match = (found(match_by_dead_reckoning(one, trace.time_s, road(s_turn))) for one in (line, lied_to))
    assert (match.entry_s, match.exit_s) == (honest.entry_s, honest.exit_s)
    foreign = match_by_dead_reckoning(lied_to, trace.time_s, road(negative(s_turn)))
    assert refused(foreign) is Reason.WRONG_ROAD

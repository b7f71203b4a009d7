"""Finding the section with satellites."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.records import Reason, Rejected
from tests.vehicle_client.synthetic import clock_s, drive_over, fixes_of, negative, road, s_turn, surveyed
from vehicle_client.estimation.trace import GnssTrack
from vehicle_client.mapmatch.driven_line import driven_line
from vehicle_client.mapmatch.gnss import match_by_gnss, positions_usable, readable_fixes
from vehicle_client.mapmatch.match import MatchMethod, SectionMatch

SECTION = surveyed(road(s_turn))
TRACE, STATION = drive_over(s_turn)
LINE = driven_line(TRACE.wheel_speed_mps[:, 2:].mean(axis=1), TRACE.yaw_rate_radps)


def fixes(section=SECTION, *, keep=None, **more) -> GnssTrack:
    track = fixes_of(section, TRACE.time_s, STATION, rng=np.random.default_rng(1), **more)
    return track if keep is None else chosen(track, keep(np.interp(track.time_s, TRACE.time_s, STATION)))


def chosen(track: GnssTrack, mask) -> GnssTrack:
    return GnssTrack(track.time_s[mask], track.lat_deg[mask], track.lon_deg[mask], track.accuracy_m[mask])


def matched(track, section=SECTION):
    return match_by_gnss(track, LINE, TRACE.time_s, section)


def found(outcome) -> SectionMatch:
    assert isinstance(outcome, SectionMatch), outcome
    return outcome


def refused(outcome) -> Reason:
    assert isinstance(outcome, Rejected), outcome
    return outcome.reason


def test_perfect_fixes_give_the_very_stations():
    match = found(matched(fixes()))
    assert np.abs(match.station_m - STATION).max() < 0.3
    assert match.entry_s == pytest.approx(np.interp(0.0, STATION, TRACE.time_s), abs=0.03)
    assert match.exit_s == pytest.approx(np.interp(400.0, STATION, TRACE.time_s), abs=0.03)
    assert match.method is MatchMethod.GNSS
    assert match.confidence_frac == 1.0


def test_noise_averages_out():
    match = found(matched(fixes(noise_m=2.0)))
    assert np.abs(match.station_m - STATION).max() < 1.5


def test_a_tunnel_is_bridged():
    match = found(matched(fixes(noise_m=1.0, keep=lambda s: (s < 120.0) | (s > 320.0))))
    assert np.abs(match.station_m - STATION).max() < 2.0


def test_a_few_wild_fixes_do_no_harm():
    track = fixes(noise_m=1.0)
    lat = track.lat_deg.copy()
    lat[::9] += 2e-4
    match = found(matched(replace(track, lat_deg=lat)))
    assert np.abs(match.station_m - STATION).max() < 0.5


def test_the_neighbouring_lane_is_still_the_section():
    assert isinstance(matched(fixes(lateral_m=4.0)), SectionMatch)


@pytest.mark.parametrize("lateral_m", [25.0, -30.0, 200.0])
def test_a_parallel_road_is_another_one(lateral_m):
    assert refused(matched(fixes(lateral_m=lateral_m))) is Reason.WRONG_ROAD


def test_the_other_direction_is_refused():
    backwards = fixes_of(SECTION, TRACE.time_s, 400.0 - STATION, rng=np.random.default_rng(1))
    outcome = matched(backwards)
    assert isinstance(outcome, Rejected)
    assert outcome.reason is Reason.WRONG_ROAD
    assert "direction" in outcome.detail


def test_a_mirrored_map_lies_elsewhere():
    assert refused(matched(fixes(), surveyed(road(negative(s_turn))))) is Reason.WRONG_ROAD


def test_turning_round_aborts_the_passage():
    # Drives 250 m into the section and back.
    there_and_back = np.where(STATION < 250.0, STATION, 500.0 - STATION)
    track = fixes_of(SECTION, TRACE.time_s, there_and_back, rng=np.random.default_rng(1))
    assert refused(matched(track)) is Reason.PASSAGE_ABORTED


@pytest.mark.parametrize("keep", [STATION > 50.0, STATION < 350.0])
def test_a_trace_without_start_or_end_is_no_passage(keep):
    line = driven_line(TRACE.wheel_speed_mps[keep, 2], TRACE.yaw_rate_radps[keep])
    outcome = match_by_gnss(fixes(), line, TRACE.time_s[keep], SECTION)
    assert isinstance(outcome, Rejected)
    assert outcome.reason is Reason.PASSAGE_ABORTED


def test_too_few_fixes_along_the_section_say_nothing():
    assert matched(fixes(keep=lambda s: (s > 100.0) & (s < 160.0))) is None


def test_what_is_needed_for_positions():
    assert positions_usable(fixes(), SECTION)
    assert not positions_usable(None, SECTION)
    assert not positions_usable(fixes(), road(s_turn))
    blurred = replace(fixes(), accuracy_m=np.full(len(fixes().time_s), 80.0))
    assert not positions_usable(blurred, SECTION)


def test_a_car_that_cuts_bends_is_placed_less_surely_than_the_receiver_says():
    exact = fixes()
    sharp = replace(exact, accuracy_m=np.full(len(exact.time_s), 0.01))
    # An odometer that runs 3 % long in the first half and 3 % short in the second is no straight line.
    speed = TRACE.wheel_speed_mps[:, 2:].mean(axis=1)
    bent = driven_line(speed * np.where(STATION < 200.0, 1.03, 0.97), TRACE.yaw_rate_radps)
    straight, cut = (found(match_by_gnss(sharp, line, TRACE.time_s, SECTION)) for line in (LINE, bent))
    ends = np.interp([cut.entry_s, cut.exit_s], TRACE.time_s, STATION) - [0.0, 400.0]
    assert straight.position_std_m < 0.5
    assert 1.0 < np.abs(ends).max() < cut.position_std_m


def test_of_two_passages_one_is_matched():
    again = len(TRACE.time_s)
    time_s = clock_s(2 * again)
    track = fixes_of(SECTION, time_s, np.tile(STATION, 2), rng=np.random.default_rng(1))
    line = driven_line(np.tile(TRACE.wheel_speed_mps[:, 2], 2), np.tile(TRACE.yaw_rate_radps, 2))
    match = found(match_by_gnss(track, line, time_s, SECTION))
    inside = match.inside(time_s)
    assert np.abs(match.station_m - np.tile(STATION, 2))[inside].max() < 1.0


def test_few_noisy_fixes_do_not_bend_the_odometer():
    track = fixes(noise_m=4.0, keep=lambda s: (s > 130.0) & (s < 270.0))
    assert np.abs(found(matched(track)).station_m - STATION).max() < 2.0


def test_fixes_that_go_back_in_time_are_left_out():
    track = fixes()
    time_s = track.time_s.copy()
    time_s[5] = time_s[4]
    time_s[9] = time_s[6]
    kept = readable_fixes(replace(track, time_s=time_s))
    assert (np.diff(kept.time_s) > 0.0).all()
    assert len(kept.time_s) == len(time_s) - 2

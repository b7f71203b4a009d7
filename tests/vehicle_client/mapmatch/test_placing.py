"""Whom to believe where fixes and motion differ."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.geodesy import frame_of
from roadgrip.records import Reason, Rejected
from tests.vehicle_client.synthetic import drive_over, fixes_of, negative, road, s_turn, surveyed
from vehicle_client.estimation.trace import GnssTrack
from vehicle_client.mapmatch.driven_line import driven_line
from vehicle_client.mapmatch.match import MatchMethod, SectionMatch
from vehicle_client.mapmatch.placing import Placing, placed

SECTION = surveyed(road(s_turn))
TRACE, STATION = drive_over(s_turn)
LINE = driven_line(TRACE.wheel_speed_mps[:, 2:].mean(axis=1), TRACE.yaw_rate_radps)
MIDDLE_S = float(np.interp(160.0, STATION, TRACE.time_s))
"""Between the two bends."""


def fixes(*, noise_m=0.5, **more) -> GnssTrack:
    track = fixes_of(SECTION, TRACE.time_s, STATION, rng=np.random.default_rng(1), noise_m=noise_m, **more)
    return replace(track, speed_mps=np.full(len(track.time_s), 15.0))


def every_so_many(track: GnssTrack, count: int) -> GnssTrack:
    return track.where(np.arange(len(track.time_s)) % count == 0)


def moved(track: GnssTrack, *, east_m=0.0, north_m=0.0) -> GnssTrack:
    """Return fixes that lie elsewhere by so much; numbers or one number per fix."""
    frame = frame_of(SECTION)
    x, y = frame.to_local(track.lat_deg, track.lon_deg)
    lat, lon = frame.to_lat_lon(x + east_m, y + north_m)
    return replace(track, lat_deg=lat, lon_deg=lon)


def placing(track: GnssTrack | None, section=SECTION, line=LINE) -> Placing:
    return placed(track, line, TRACE.time_s, section)


def found(outcome) -> SectionMatch:
    assert isinstance(outcome, SectionMatch), outcome
    return outcome


def error_m(where: Placing) -> float:
    return float(np.abs(found(where.outcome).station_m - STATION).max())


def after(track: GnssTrack, at_s: float = MIDDLE_S):
    return track.time_s >= at_s


# Fixes that are good --------------------------------------------------------------------------------------------------


def test_good_fixes_place_the_drive_and_nothing_is_poor():
    where = placing(fixes())
    assert found(where.outcome).method is MatchMethod.GNSS
    assert not where.gnss_poor
    assert not any(finding.doubtful for finding in where.findings)


def test_without_fixes_motion_does_and_nobody_calls_that_poor():
    for track, section in ((None, SECTION), (fixes(), road(s_turn)), (fixes().where(np.zeros(0, dtype=int)), SECTION)):
        where = placing(track, section)
        assert found(where.outcome).method is MatchMethod.DEAD_RECKONING
        assert not where.gnss_poor


# Receivers that lie ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step_m", [25.0, -30.0, 60.0])
def test_fixes_that_jump_are_outvoted_by_motion(step_m):
    track = fixes()
    where = placing(moved(track, north_m=np.where(after(track), step_m, 0.0)))
    assert where.gnss_poor
    assert error_m(where) < 3.0


@pytest.mark.parametrize("vector_m", [(40.0, 0.0), (0.0, -40.0), (30.0, 30.0)])
def test_a_receiver_that_is_off_by_one_vector_is_outvoted_on_a_road_that_turns(vector_m):
    where = placing(moved(fixes(), east_m=vector_m[0], north_m=vector_m[1]))
    assert where.gnss_poor
    assert error_m(where) < 3.0


def test_fixes_that_wander_off_are_outvoted():
    track = fixes()
    off_m = np.maximum(0.0, track.time_s - MIDDLE_S) * 4.0
    where = placing(moved(track, east_m=off_m))
    assert where.gnss_poor
    assert error_m(where) < 3.0


@pytest.mark.parametrize("late_s", [-1.0, 1.0, 2.0])
def test_fixes_that_come_late_lag_behind_the_bends(late_s):
    track = fixes()
    where = placing(replace(track, time_s=track.time_s + late_s))
    assert where.gnss_poor
    assert found(where.outcome).method is MatchMethod.DEAD_RECKONING
    assert error_m(where) < 3.0


@pytest.mark.parametrize("at_station_m", [-40.0, 160.0])
def test_a_receiver_that_repeats_itself_is_not_believed(at_station_m):
    track = fixes()
    last = np.minimum(
        np.arange(len(track.time_s)), int(np.argmax(np.interp(track.time_s, TRACE.time_s, STATION) > at_station_m))
    )
    where = placing(replace(track, lat_deg=track.lat_deg[last], lon_deg=track.lon_deg[last]))
    assert where.gnss_poor
    assert error_m(where) < 3.0


@pytest.mark.parametrize("every", [30, 50, 90])
def test_few_fixes_are_helped_by_motion(every):
    where = placing(fixes().where(np.arange(0, len(fixes().time_s), every)))
    assert where.gnss_poor
    assert error_m(where) < 3.0


# Cars elsewhere -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lateral_m", [-60.0, -30.0, -20.0, 20.0, 30.0, 60.0])
def test_a_parallel_road_is_refused_whatever_motion_says(lateral_m):
    where = placing(fixes(lateral_m=lateral_m))
    assert isinstance(where.outcome, Rejected)
    assert where.outcome.reason is Reason.WRONG_ROAD


@pytest.mark.parametrize("lateral_m", [-30.0, 30.0])
def test_a_parallel_road_is_refused_with_few_fixes_too(lateral_m):
    track = fixes(lateral_m=lateral_m)
    for every in (30, 90):
        where = placing(every_so_many(track, every))
        assert isinstance(where.outcome, Rejected), every


def test_a_road_of_the_same_shape_far_away_is_refused():
    where = placing(moved(fixes(), east_m=3000.0))
    assert isinstance(where.outcome, Rejected)
    assert where.outcome.reason is Reason.WRONG_ROAD


def test_a_car_that_leaves_by_a_ramp_is_refused():
    # It bends off by 0.15 rad after 200 m: fixes and motion tell the same.
    drive, station = drive_over(s_turn)
    off = np.where((station > 200.0) & (station < 215.0), 0.15, 0.0)
    line = driven_line(drive.wheel_speed_mps[:, 2:].mean(axis=1), drive.yaw_rate_radps + off)
    ahead = np.interp(0.0, STATION, LINE.x_m), np.interp(0.0, STATION, LINE.y_m)
    rows = np.searchsorted(drive.time_s, fixes().time_s)
    x, y = line.x_m[rows] - ahead[0], line.y_m[rows] - ahead[1]
    turn = SECTION.profile.heading_rad[0]
    lat, lon = frame_of(SECTION).to_lat_lon(
        SECTION.profile.x_m[0] + x * np.cos(turn) - y * np.sin(turn),
        SECTION.profile.y_m[0] + x * np.sin(turn) + y * np.cos(turn),
    )
    where = placing(replace(fixes(), lat_deg=lat, lon_deg=lon), line=line)
    assert isinstance(where.outcome, Rejected)


def test_the_mirrored_map_is_refused_with_fixes_that_jump():
    track = fixes()
    jumping = moved(track, north_m=np.where(after(track), 30.0, 0.0))
    assert isinstance(placing(jumping, surveyed(road(negative(s_turn)))).outcome, Rejected)


# What fixes are worth -------------------------------------------------------------------------------------------------


def test_inaccurate_fixes_are_poor():
    assert placing(replace(fixes(), accuracy_m=np.full(len(fixes().time_s), 15.0))).gnss_poor
    assert placing(replace(fixes(), accuracy_m=np.full(len(fixes().time_s), 80.0))).gnss_poor
    assert not placing(replace(fixes(), accuracy_m=np.full(len(fixes().time_s), 5.0))).gnss_poor


def test_a_tunnel_is_poor_from_two_and_a_half_seconds_on():
    track = fixes()
    assert placing(track.where((track.time_s < MIDDLE_S) | (track.time_s > MIDDLE_S + 3.0))).gnss_poor
    assert not placing(track.where((track.time_s < MIDDLE_S) | (track.time_s > MIDDLE_S + 2.0))).gnss_poor


def test_silence_outside_the_section_is_not_poor():
    track = fixes()
    inside = np.interp(track.time_s, TRACE.time_s, STATION)
    assert not placing(track.where((inside > -5.0) & (inside < 405.0))).gnss_poor


def test_one_fix_a_second_is_enough():
    assert not placing(every_so_many(fixes(), 10)).gnss_poor


def test_the_receivers_speed_alone_against_the_wheels_is_the_receivers_fault():
    track = fixes()
    where = placing(replace(track, speed_mps=np.asarray(track.speed_mps) * 1.1))
    assert where.gnss_poor
    assert not any(finding.doubtful for finding in where.findings)


@pytest.mark.parametrize(("ratio", "grave"), [(0.95, False), (1.06, False), (0.85, True)])
@pytest.mark.parametrize("with_speed", [False, True])
def test_wheels_that_the_receiver_contradicts_are_to_blame(ratio, grave, with_speed):
    track = fixes() if with_speed else replace(fixes(), speed_mps=None)
    line = driven_line(TRACE.wheel_speed_mps[:, 2:].mean(axis=1) * ratio, TRACE.yaw_rate_radps)
    where = placing(track, line=line)
    if grave and isinstance(where.outcome, Rejected):
        return
    assert any(finding.doubtful for finding in where.findings)
    assert any(finding.grave for finding in where.findings) is grave

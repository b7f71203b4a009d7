"""Laying a map over a drive."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vehicle_client.synthetic import bump, clock_s, drive_over, road, s_turn
from vehicle_client.mapmatch.alignment import (
    CANDIDATES_COUNT,
    alignments,
    coarse_shifts_m,
    mapped_stretch,
    metred_drive,
    value_at,
)
from vehicle_client.mapmatch.driven_line import driven_line, with_course

SECTION = road(s_turn)
STRETCH = mapped_stretch(SECTION.profile, length_m=SECTION.length_m)


def metred(*, drift_radps=0.0, scale_ratio=1.0, **more):
    trace, _ = drive_over(s_turn, **more)
    speed = scale_ratio * trace.wheel_speed_mps[:, 2:].mean(axis=1)
    drive = metred_drive(driven_line(speed, trace.yaw_rate_radps + drift_radps), trace.time_s)
    assert drive is not None
    return drive


def best(drive):
    return min(alignments(drive, STRETCH), key=lambda place: place.residual_rms_rad)


@settings(max_examples=20, deadline=None)
@given(approach_m=st.floats(5.0, 400.0), scale_ratio=st.floats(0.995, 1.005), drift_radps=st.floats(-0.002, 0.002))
def test_shift_scale_and_drift_are_found(approach_m, scale_ratio, drift_radps):
    place = best(metred(approach_m=approach_m, scale_ratio=scale_ratio, drift_radps=drift_radps))
    assert place.shift_m == pytest.approx(scale_ratio * approach_m, abs=3.0)
    assert place.scale_ratio == pytest.approx(scale_ratio, abs=0.005)
    assert place.residual_rms_rad < 0.01


def test_a_car_that_points_into_its_bends_is_explained_by_one_number():
    trace, _ = drive_over(s_turn)
    accel_y = trace.yaw_rate_radps * trace.wheel_speed_mps[:, 2]
    pointing = trace.yaw_rate_radps + np.gradient(0.01 * accel_y, 0.01)
    drive = metred_drive(driven_line(trace.wheel_speed_mps[:, 2:].mean(axis=1), pointing), trace.time_s)
    assert drive is not None
    place = best(drive)
    assert place.residual_rms_rad < 0.004
    # At a constant speed it looks as if the car were two metres farther.
    assert place.shift_m == pytest.approx(80.0, abs=3.0)


def test_coarse_places_are_in_order_and_apart():
    shifts = coarse_shifts_m(metred(approach_m=900.0, exit_m=900.0), STRETCH)
    assert len(shifts) == CANDIDATES_COUNT
    assert (np.diff(shifts) > 0.25 * SECTION.length_m - 5.0).all()


def test_a_bend_says_better_than_a_straight_where_the_car_is():
    flat = road(lambda station_m: 0.02 * s_turn(station_m))
    trace, _ = drive_over(lambda station_m: 0.02 * s_turn(station_m))
    drive = metred_drive(driven_line(trace.wheel_speed_mps[:, 2], trace.yaw_rate_radps), trace.time_s)
    assert drive is not None
    gentle = alignments(drive, mapped_stretch(flat.profile, length_m=flat.length_m))
    assert min(place.position_std_m for place in gentle) > 10.0 * best(metred()).position_std_m


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_a_drive_that_is_no_number_is_none(broken):
    speed = np.full(500, 10.0)
    speed[100] = broken
    assert metred_drive(driven_line(speed, np.zeros(500)), clock_s(500)) is None


def test_a_height_that_is_no_number_is_left_out():
    climb = np.zeros(500)
    climb[100] = np.nan
    drive = metred_drive(driven_line(np.full(500, 10.0), np.zeros(500), None, climb), clock_s(500))
    assert drive is not None
    assert drive.height_m is None


def test_a_standstill_of_any_length_is_no_distance():
    moving, still = np.full(300, 10.0), np.zeros(1000)
    line = driven_line(np.concatenate([moving, still, moving]), np.zeros(1600))
    drive = metred_drive(line, clock_s(1600))
    assert drive is not None
    assert drive.length_m == pytest.approx(60.0, abs=0.2)
    assert np.isfinite(drive.speed_mps).all()


def test_between_the_metres_lie_straight_lines_and_beyond_the_ends_nothing_changes():
    assert value_at(np.array([0.0, 2.0, 6.0]), np.array([-3.0, 0.5, 1.25, 9.0])) == pytest.approx([0.0, 1.0, 3.0, 6.0])


def test_what_the_fit_leaves_makes_the_position_less_sure():
    trace, _ = drive_over(s_turn)
    speed = trace.wheel_speed_mps[:, 2:].mean(axis=1)
    straying = 0.06 * np.sin(np.arange(len(speed)) * 0.01 * 2.0 * np.pi / 2.0)
    strayed = driven_line(speed, trace.yaw_rate_radps + np.gradient(straying, 0.01))
    drive = metred_drive(strayed, trace.time_s)
    assert drive is not None
    unsure, sure = best(drive), best(metred())
    assert unsure.residual_rms_rad > 0.03
    assert unsure.position_std_m > 1.5 * sure.position_std_m


def test_a_sliding_car_lies_on_the_map_by_its_course():
    trace, _ = drive_over(s_turn)
    speed = trace.wheel_speed_mps[:, 2:].mean(axis=1)
    # The tail steps out and comes back, three times: no share of the lateral acceleration.
    sideslip = -0.1 * np.sin(np.arange(len(speed)) * 0.01 * 2.0 * np.pi / 3.0) ** 2
    nose = driven_line(speed, trace.yaw_rate_radps - np.gradient(sideslip, 0.01))
    by_course = with_course(nose, speed_mps=speed, velocity_y_mps=speed * np.tan(sideslip))
    places = [best(drive) for line in (nose, by_course) if (drive := metred_drive(line, trace.time_s)) is not None]
    assert places[0].residual_rms_rad > 0.02
    assert places[1].residual_rms_rad < 0.004
    assert places[1].shift_m == pytest.approx(80.0, abs=1.0)


def test_what_the_car_points_into_its_bends_is_told_from_a_shift_where_its_speed_changes():
    trace, _ = drive_over(s_turn, swing_mps=6.0)
    speed = trace.wheel_speed_mps[:, 2:].mean(axis=1)
    turned = 0.008 * trace.yaw_rate_radps * speed
    drive = metred_drive(driven_line(speed, trace.yaw_rate_radps + np.gradient(turned, 0.01)), trace.time_s)
    assert drive is not None
    assert best(drive).residual_rms_rad < 0.0045


def test_no_odometer_is_more_than_three_percent_off():
    scales = [best(metred(scale_ratio=ratio)).scale_ratio for ratio in (0.85, 1.15)]
    assert min(scales) == pytest.approx(0.97)
    assert max(scales) == pytest.approx(1.03)


def test_the_rough_search_finds_a_drive_whose_gyro_drifts():
    shifts = coarse_shifts_m(metred(approach_m=300.0, exit_m=600.0, drift_radps=0.01), STRETCH)
    assert np.abs(shifts - 300.0).min() < 20.0


def test_the_stated_deviation_is_that_of_the_middle():
    spots = {}
    for start_m in (20.0, 170.0):

        def one_bend(station_m, start_m=start_m):
            return bump(station_m, start_m=start_m, length_m=60.0, peak_1pm=0.02)

        trace, _ = drive_over(one_bend)
        drive = metred_drive(driven_line(trace.wheel_speed_mps[:, 2], trace.yaw_rate_radps), trace.time_s)
        section = road(one_bend)
        assert drive is not None
        places = alignments(drive, mapped_stretch(section.profile, length_m=section.length_m))
        spots[start_m] = min(places, key=lambda place: place.residual_rms_rad).position_std_m
    assert spots[170.0] < spots[20.0]

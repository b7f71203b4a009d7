"""Laws of the label: the lowest 10 m moving mean of load-weighted friction, on roads whose answer is known by hand."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.section import build_section
from vehicle_client.simulator.run import (
    DriverKind,
    FrictionProfile,
    PassagePlan,
    SensorGrade,
    draw_plan,
    simulate_passage,
    simulate_passages,
)
from vehicle_client.simulator.vehicle import XC90

pytestmark = pytest.mark.sim

LENGTH_M = 200.0
STRAIGHT = build_section(
    section_id="straight",
    name="straight",
    nodes_m=np.column_stack([np.linspace(0.0, LENGTH_M, 41), np.zeros(41), np.zeros(41)]),
    speed_limit_mps=15.0,
)
PLAN = PassagePlan(base_friction_mu=0.7, seed=5, target_speed_mps=15.0, sensor_grade=SensorGrade.IDEAL, roughness=None)
EDGE_M = 1.0
"""Friction is known every metre of the road, so the edges of a patch are ramps of that length, half of it inside."""


def profile(station_m, left_mu, right_mu=None):
    left = np.array(left_mu, dtype=float)
    return FrictionProfile(
        station_m=np.array(station_m, dtype=float),
        left_mu=left,
        right_mu=left if right_mu is None else np.array(right_mu, dtype=float),
    )


def patch(start_m, length_m, *, inside_mu=0.3, outside_mu=0.7):
    stations = [0.0, start_m - 0.5 * EDGE_M, start_m + 0.5 * EDGE_M]
    stations += [start_m + length_m - 0.5 * EDGE_M, start_m + length_m + 0.5 * EDGE_M, LENGTH_M]
    return profile(stations, [outside_mu, outside_mu, inside_mu, inside_mu, outside_mu, outside_mu])


def driven(friction, **changes):
    return simulate_passage(STRAIGHT, replace(PLAN, friction_profile=friction, **changes))


def test_even_friction_is_its_own_label():
    drive = driven(None)
    assert drive.label_mu == drive.lowest_mu == 0.7


def test_wear_and_pressure_scale_the_label():
    drive = driven(None, wear_factor=0.85, pressure_pa=220_000.0)
    factor = 0.85 * (1.0 + 0.16 * 0.3)
    assert drive.label_mu == pytest.approx(0.7 * factor, rel=1e-12)


def test_wear_scales_a_profile_too():
    assert driven(patch(100.0, 30.0), wear_factor=0.9).label_mu == pytest.approx(0.27, rel=1e-9)


def test_split_tracks_weigh_equally_on_the_straight():
    drive = driven(profile([0.0, LENGTH_M], [0.3, 0.3], [0.7, 0.7]))
    assert drive.label_mu == pytest.approx(0.5, rel=2e-3)


@pytest.mark.parametrize("length_m", [2.0, 4.0, 6.0])
def test_a_patch_shorter_than_the_window_counts_by_its_length(length_m):
    # Both axles cross it within ten metres, so every metre of it counts once, whatever the axles bear.
    drive = driven(patch(100.5, length_m))
    assert drive.label_mu == pytest.approx(0.7 - 0.4 * length_m / 10.0, abs=0.004)


@pytest.mark.parametrize("length_m", [15.0, 40.0])
def test_a_patch_longer_than_window_and_car_is_the_label(length_m):
    drive = driven(patch(100.5, length_m))
    assert drive.label_mu == pytest.approx(0.3, abs=1e-4)
    assert drive.lowest_mu == pytest.approx(0.3, rel=1e-9)


def test_under_one_axle_at_a_time_the_raw_minimum_weighs_that_axle():
    # Shorter than the wheelbase: the front axle bears 1.554/2.984 of the load, the rear one the rest.
    drive = driven(patch(100.5, 2.0))
    front = XC90.rear_axle_m / XC90.wheelbase_m
    assert drive.lowest_mu == pytest.approx(0.7 - 0.4 * front, abs=0.004)
    assert drive.label_mu > drive.lowest_mu


def test_on_a_ramp_the_label_is_the_mean_of_the_last_ten_metres():
    # Along a straight line the axles' mean is the friction under the centre of gravity.
    drive = driven(profile([0.0, LENGTH_M, LENGTH_M + 60.0], [0.9, 0.4, 0.25]))
    at_end = 0.9 - 0.5 * (LENGTH_M - 5.0) / LENGTH_M
    assert drive.label_mu == pytest.approx(at_end, abs=0.002)
    assert drive.lowest_mu == pytest.approx(0.4, abs=0.004)


def test_two_short_patches_within_the_window_add_up():
    both = profile(
        [0.0, 99.5, 100.5, 101.5, 102.5, 104.5, 105.5, 106.5, 107.5, LENGTH_M],
        [0.7, 0.7, 0.3, 0.3, 0.7, 0.7, 0.3, 0.3, 0.7, 0.7],
    )
    # Two of two metres each, all of it under both axles within ten metres.
    assert driven(both).label_mu == pytest.approx(0.7 - 0.4 * 4.0 / 10.0, abs=0.012)


@pytest.mark.parametrize("start_m", [-40.0, LENGTH_M + 15.0])
def test_ice_on_the_approach_or_the_exit_is_not_in_the_label(start_m):
    outside = profile([start_m - 0.5, start_m + 0.5, start_m + 19.5, start_m + 20.5], [0.7, 0.2, 0.2, 0.7])
    assert driven(outside).label_mu == pytest.approx(0.7, rel=1e-9)


def test_the_label_is_what_the_truth_says_it_is():
    # The same number from the samples of the truth, by a window slid sample by sample.
    drive = driven(patch(80.0, 7.0, inside_mu=0.35), target_speed_mps=11.0)
    truth = drive.truth
    inside = (truth.station_m >= 0.0) & (truth.station_m <= LENGTH_M)
    station, friction = truth.station_m[inside], truth.friction_mu[inside]
    fine = np.arange(station[0], station[-1], 0.005)
    means = np.convolve(np.interp(fine, station, friction), np.full(2000, 1.0 / 2000.0), mode="valid")
    assert drive.label_mu == pytest.approx(means.min(), abs=2e-4)
    assert drive.lowest_mu == friction.min()


def test_a_batch_is_to_the_last_bit_what_its_drives_are_one_by_one(rng):
    plans = [
        draw_plan(rng, section=STRAIGHT, base_friction_mu=mu, kind=kind)
        for mu in (0.15, 0.4, 0.9)
        for kind in DriverKind
    ]
    plans[2] = replace(plans[2], friction_profile=patch(100.0, 20.0))
    plans[3] = replace(plans[3], roughness=None)
    for one, plan in zip(simulate_passages(STRAIGHT, plans), plans, strict=True):
        alone = simulate_passage(STRAIGHT, plan)
        assert (one.outcome, one.label_mu, one.lowest_mu) == (alone.outcome, alone.label_mu, alone.lowest_mu)
        for name in one.truth.__slots__:
            assert np.array_equal(getattr(one.truth, name), getattr(alone.truth, name)), name
        assert np.array_equal(one.trace.accel_y_mps2, alone.trace.accel_y_mps2)
        assert np.array_equal(one.trace.wheel_speed_mps, alone.trace.wheel_speed_mps)

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from roadgrip.errors import SectionError
from roadgrip.geodesy import anchors_of, frame_of
from roadgrip.section import build_section
from roadgrip.units import GRAVITY_MPS2, kph_to_mps
from tests.vehicle_client.simulator.rig import curvy_road
from vehicle_client.estimation.trace import check_trace
from vehicle_client.simulator.run import (
    NO_SYSTEMS,
    DriveOutcome,
    Driver,
    DriverKind,
    FrictionProfile,
    PassagePlan,
    RoughnessClass,
    SensorGrade,
    compiled_cache_key,
    draw_plan,
    simulate_passage,
    simulate_passages,
)

pytestmark = pytest.mark.sim

ROAD = curvy_road()
CALM = PassagePlan(base_friction_mu=0.6, seed=7, target_speed_mps=15.0, sensor_grade=SensorGrade.IDEAL, roughness=None)
REAL = replace(CALM, sensor_grade=SensorGrade.AUTOMOTIVE, roughness=RoughnessClass.A)


def arrays_of(drive):
    for record in (drive.trace, drive.truth):
        for name in record.__slots__:
            value = getattr(record, name)
            if isinstance(value, np.ndarray):
                yield name, value


def same(one, other):
    return all(np.array_equal(a, b) for (_, a), (_, b) in zip(arrays_of(one), arrays_of(other), strict=True))


def test_a_drive_is_a_valid_trace_over_approach_section_and_exit():
    drive = simulate_passage(ROAD, REAL)
    check_trace(drive.trace)
    assert drive.outcome is DriveOutcome.COMPLETED
    assert drive.truth.station_m[0] == -REAL.approach_m
    assert drive.truth.station_m[-1] >= ROAD.length_m + REAL.exit_m
    assert drive.trace.gnss is None


def test_the_same_plan_gives_the_same_drive_alone_and_in_any_batch(rng):
    plans = [draw_plan(rng, section=ROAD, base_friction_mu=mu) for mu in (0.2, 0.35, 0.7)]
    batch = simulate_passages(ROAD, plans)
    backwards = simulate_passages(ROAD, plans[::-1])[::-1]
    for plan, one, two in zip(plans, batch, backwards, strict=True):
        assert same(one, two)
        assert same(one, simulate_passage(ROAD, plan))


def test_threads_change_nothing(rng):
    plans = [draw_plan(rng, section=ROAD, base_friction_mu=0.4) for _ in range(12)]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(lambda plan: simulate_passage(ROAD, plan), plans))
    assert all(same(one, two) for one, two in zip(together, simulate_passages(ROAD, plans), strict=True))


def test_another_seed_gives_another_surface_and_other_errors():
    one, two = simulate_passage(ROAD, REAL), simulate_passage(ROAD, replace(REAL, seed=8))
    assert not np.array_equal(one.truth.wheel_load_n[:100], two.truth.wheel_load_n[:100])
    assert not np.array_equal(one.trace.accel_y_mps2[:100], two.trace.accel_y_mps2[:100])


def test_the_sensors_do_not_change_the_drive():
    ideal = simulate_passage(ROAD, replace(REAL, sensor_grade=SensorGrade.IDEAL))
    real = simulate_passage(ROAD, REAL)
    assert np.array_equal(ideal.truth.x_m, real.truth.x_m)


def test_a_mirrored_road_gives_the_mirrored_drive():
    left = simulate_passage(curvy_road(bank_ratio=0.05), CALM).trace
    right = simulate_passage(curvy_road(bank_ratio=0.05, mirrored=True), CALM).trace
    for name in ("accel_y_mps2", "yaw_rate_radps", "roll_rate_radps", "steer_rad"):
        np.testing.assert_allclose(getattr(left, name), -getattr(right, name), rtol=0, atol=1e-7, err_msg=name)
    np.testing.assert_allclose(left.accel_x_mps2, right.accel_x_mps2, rtol=0, atol=1e-7)
    np.testing.assert_allclose(left.wheel_speed_mps, right.wheel_speed_mps[:, [1, 0, 3, 2]], rtol=0, atol=1e-6)


def test_half_the_step_changes_little():
    coarse = simulate_passage(ROAD, replace(REAL, sensor_grade=SensorGrade.IDEAL))
    fine = simulate_passage(ROAD, replace(REAL, sensor_grade=SensorGrade.IDEAL), step_s=0.001)
    n = min(len(coarse.trace.time_s), len(fine.trace.time_s))
    for name, scale in (("yaw_rate_radps", 0.25), ("accel_y_mps2", 4.0), ("steer_rad", 0.06)):
        difference = getattr(coarse.trace, name)[:n] - getattr(fine.trace, name)[:n]
        assert np.sqrt(np.mean(difference**2)) < 0.01 * scale, name


def test_ideal_sensors_agree_with_the_truth():
    drive = simulate_passage(curvy_road(bank_ratio=0.06), CALM)
    trace, truth = drive.trace, drive.truth
    # Yaw is the change of heading; positions are the integral of velocity.
    heading = truth.heading_rad[0] + np.concatenate([[0.0], np.cumsum(trace.yaw_rate_radps[1:] * 0.01)])
    assert np.abs(heading - truth.heading_rad).max() < 0.02
    course = truth.heading_rad + truth.sideslip_rad
    speed = np.hypot(truth.velocity_x_mps, truth.velocity_y_mps)
    x = truth.x_m[0] + np.concatenate([[0.0], np.cumsum((speed * np.cos(course))[1:] * 0.01)])
    assert np.abs(x - truth.x_m).max() < 0.5
    # The accelerometer sees the acceleration and gravity's part on bank and roll.
    lean = truth.bank_rad + truth.roll_rad
    seen = truth.accel_y_mps2 + GRAVITY_MPS2 * np.sin(lean)
    assert np.abs(trace.accel_y_mps2 - seen).max() < 0.06
    np.testing.assert_allclose(trace.wheel_speed_mps.mean(1), truth.velocity_x_mps, rtol=0.02)


def test_the_driver_keeps_to_the_lane():
    drive = simulate_passage(ROAD, REAL)
    assert np.abs(drive.truth.lateral_offset_m).max() < 0.5


def test_an_even_road_is_labelled_with_friction_times_wear():
    drive = simulate_passage(ROAD, replace(CALM, base_friction_mu=0.5, wear_factor=0.9))
    assert drive.label_mu == pytest.approx(0.45, abs=1e-15)
    assert drive.lowest_mu == drive.label_mu


def test_a_patch_is_labelled_by_its_lowest_ten_metres():
    station = np.array([0.0, 100.0, 101.0, 105.0, 106.0, 400.0])
    friction = np.array([0.6, 0.6, 0.4, 0.4, 0.6, 0.6])
    patch = FrictionProfile(station_m=station, left_mu=friction, right_mu=friction)
    drive = simulate_passage(ROAD, replace(CALM, friction_profile=patch))
    # Five metres of 0.4, seen by two axles three metres apart, within a window of ten.
    assert 0.49 < drive.label_mu < 0.51
    assert 0.4 <= drive.lowest_mu < 0.45


def test_a_slippery_track_counts_by_the_load_it_bears():
    ends = np.array([0.0, 400.0])
    split = FrictionProfile(station_m=ends, left_mu=np.full(2, 0.3), right_mu=np.full(2, 0.7))
    drive = simulate_passage(ROAD, replace(CALM, friction_profile=split, base_friction_mu=0.5))
    turning = drive.truth.accel_y_mps2 > 1.0
    assert drive.truth.friction_mu[turning].mean() > 0.51


def test_who_is_much_too_fast_leaves_the_road_and_is_recorded():
    plan = replace(CALM, base_friction_mu=0.2, target_speed_mps=25.0, driver=Driver(comfort_accel_mps2=12.0))
    drive = simulate_passage(ROAD, plan)
    assert drive.outcome is DriveOutcome.LEFT_ROAD
    assert not drive.completed
    assert drive.label_mu == pytest.approx(0.2)
    assert len(drive.trace.time_s) == len(drive.truth.time_s)
    check_trace(drive.trace)


def test_stability_control_keeps_runs_on_the_road_that_spin_without_it(rng):
    plans = [draw_plan(rng, section=ROAD, base_friction_mu=0.6, kind=DriverKind.REACTING) for _ in range(30)]
    plans = [replace(plan, target_speed_mps=18.0) for plan in plans]
    with_it = [d.outcome for d in simulate_passages(ROAD, plans)]
    without = [d.outcome for d in simulate_passages(ROAD, [replace(p, stability=NO_SYSTEMS) for p in plans])]
    assert DriveOutcome.SPUN not in with_it
    assert without.count(DriveOutcome.SPUN) > 5
    assert with_it.count(DriveOutcome.COMPLETED) > 1.5 * without.count(DriveOutcome.COMPLETED)


def test_a_prudent_driver_slows_down_where_it_looks_slippery():
    slow = simulate_passage(ROAD, replace(CALM, target_speed_mps=20.0, driver=Driver(friction_guess_mu=0.2)))
    fast = simulate_passage(ROAD, replace(CALM, target_speed_mps=20.0, driver=Driver(friction_guess_mu=0.8)))
    assert slow.truth.velocity_x_mps.min() < 0.8 * fast.truth.velocity_x_mps.min()


def test_the_guess_is_all_a_driver_knows_of_the_friction():
    # With the same guess and no slide, friction changes the speed by next to nothing.
    speeds = [
        simulate_passage(ROAD, replace(CALM, base_friction_mu=mu, driver=Driver(friction_guess_mu=0.2)))
        .truth.velocity_x_mps[500:1000]
        .mean()
        for mu in (0.5, 1.0)
    ]
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-3)


def test_a_section_cut_inside_a_curve_can_be_driven():
    angle = np.linspace(0.0, 1.5, 20)
    nodes = np.column_stack([80 * np.sin(angle), 80 * (1 - np.cos(angle)), np.zeros(20)])
    road = build_section(section_id="cut", name="cut", nodes_m=nodes, speed_limit_mps=kph_to_mps(50))
    drive = simulate_passage(road, replace(CALM, target_speed_mps=12.0))
    assert drive.completed
    assert np.abs(drive.truth.lateral_offset_m).max() < 1.0


def test_uphill_the_accelerometer_sees_gravity():
    x = np.arange(0.0, 201.0, 10.0)
    nodes = np.column_stack([x, np.zeros_like(x), 0.06 * x])
    road = build_section(section_id="hill", name="hill", nodes_m=nodes, speed_limit_mps=20.0)
    drive = simulate_passage(road, CALM)
    cruising = slice(600, 900)
    assert drive.trace.accel_x_mps2[cruising].mean() == pytest.approx(
        drive.truth.accel_x_mps2[cruising].mean() + 0.06 * GRAVITY_MPS2, rel=0.05
    )


def test_position_fixes_need_anchors():
    with pytest.raises(SectionError, match="anchors"):
        simulate_passage(ROAD, replace(CALM, with_gnss=True))


def test_position_fixes_follow_the_car():
    place: dict[str, Any] = {
        "section_id": "anchored",
        "name": "anchored",
        "nodes_m": ROAD.nodes_m,
        "speed_limit_mps": ROAD.speed_limit_mps,
        "crs": "EPSG:25833",
        "origin_m": (200_000.0, 6_800_000.0, 0.0),
    }
    anchored = build_section(**place, anchors=anchors_of(build_section(**place)))
    drive = simulate_passage(anchored, replace(REAL, with_gnss=True))
    gnss = drive.trace.gnss
    assert gnss is not None
    x, y = frame_of(anchored).to_local(gnss.lat_deg, gnss.lon_deg)
    rows = np.rint(gnss.time_s / 0.01).astype(int)
    error = np.hypot(x - drive.truth.x_m[rows], y - drive.truth.y_m[rows])
    assert 0.0 < error.max() < 8.0
    assert np.ptp(error) < 3.0
    assert np.diff(gnss.time_s) == pytest.approx(0.1)


@pytest.mark.parametrize(
    "change",
    [
        {"base_friction_mu": 0.0},
        {"base_friction_mu": float("nan")},
        {"wear_factor": -1.0},
        {"target_speed_mps": 0.0},
        {"friction_profile": FrictionProfile(np.array([5.0, 1.0]), np.full(2, 0.5), np.full(2, 0.5))},
        {"friction_profile": FrictionProfile(np.array([1.0, 5.0]), np.full(2, 0.5), np.zeros(2))},
    ],
)
def test_a_plan_that_cannot_be_is_refused(change):
    with pytest.raises(ValueError, match=r"friction|speed|profile"):
        simulate_passage(ROAD, replace(CALM, **change))


def test_the_cache_key_names_the_compiled_code():
    assert len(compiled_cache_key()) == 14
    assert int(compiled_cache_key(), 16) > 0

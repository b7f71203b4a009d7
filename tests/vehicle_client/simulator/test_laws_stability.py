"""Laws of the stability systems: near the ideal stop, no spinning wheels, the right wheel braked, quiet otherwise."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from roadgrip.section import build_section
from roadgrip.units import GRAVITY_MPS2
from tests.vehicle_client.simulator import analytic
from tests.vehicle_client.simulator.rig import curvy_road
from vehicle_client.simulator.plan import ALL_SYSTEMS, NO_SYSTEMS, Braking, StabilitySystems
from vehicle_client.simulator.proving_ground import Plane, drive_open_loop
from vehicle_client.simulator.run import (
    DriveOutcome,
    Driver,
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

ABS = StabilitySystems(abs_on=True, tcs_on=False, esc_on=False)
TCS = StabilitySystems(abs_on=False, tcs_on=True, esc_on=False)
ESC = StabilitySystems(abs_on=False, tcs_on=False, esc_on=True)
FRICTIONS = pytest.mark.parametrize("mu", [0.1, 0.2, 0.35, 0.5, 0.8, 1.0])
LOCKING = pytest.mark.parametrize("mu", [0.1, 0.2, 0.35, 0.5, 0.8])
"""Frictions on which the full pedal locks the wheels; on 1.0 the brakes are hardly strong enough."""
FULL_PEDAL_MPS2 = -11.0
FRONT_LEFT, FRONT_RIGHT, REAR_LEFT, REAR_RIGHT = range(4)


def ramp(seconds, level, *, start_s=0.0, rise_s=0.3):
    """Return zero, then a straight rise from `start_s` within `rise_s`, then the level; every 10 ms."""
    time = 0.01 * np.arange(round(100 * seconds))
    return level * np.clip((time - start_s) / rise_s, 0.0, 1.0)


@lru_cache
def full_braking(plane, systems, *, start_mps=27.0, steer_rad=0.0):
    slowest = min(plane.friction_mu, plane.right_friction_mu or plane.friction_mu)
    seconds = start_mps / (0.6 * slowest * GRAVITY_MPS2) + 2.0
    return drive_open_loop(
        plane,
        speed_mps=start_mps,
        steer_rad=ramp(seconds, steer_rad, start_s=1.0, rise_s=0.2),
        accel_mps2=ramp(seconds, FULL_PEDAL_MPS2),
        systems=systems,
    )


def way_m(motion, *, from_mps=25.0, to_mps=3.0):
    """Return the way between two speeds; the first is only reached when the brakes have long been in."""
    speed = motion.velocity_x_mps
    assert speed.min() < to_mps
    end = int(np.argmax(speed < to_mps))
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.01)])
    falling = speed[: end + 1][::-1]
    at = np.interp([from_mps, to_mps], falling, travelled[: end + 1][::-1])
    return float(at[1] - at[0])


def brake_slip_ratio(motion):
    """Return one minus wheel speed over car speed of every wheel while the car is faster than 3 m/s. (n, 4)"""
    fast = motion.velocity_x_mps > 3.0
    rolling = motion.wheel_speed_radps[fast] * XC90.tyre.rolling_radius_m
    slip: np.ndarray = 1.0 - rolling / motion.velocity_x_mps[fast, None]
    return slip


def drive_slip_ratio(motion):
    """Return wheel speed over car speed minus one of every wheel. (n, 4)"""
    return motion.wheel_speed_radps * XC90.tyre.rolling_radius_m / motion.velocity_x_mps[:, None] - 1.0


# --- anti-lock braking


@FRICTIONS
def test_anti_lock_braking_stops_nearly_as_short_as_can_be(mu):
    way = way_m(full_braking(Plane(mu), ABS))
    assert way < 1.05 * analytic.ideal_stop_m(mu, from_mps=25.0, to_mps=3.0)


@FRICTIONS
def test_nobody_stops_shorter_than_the_ideal(mu):
    # Two per cent for a carcass that still gives back what it stored, and for the time step.
    ideal = analytic.ideal_stop_m(mu, from_mps=25.0, to_mps=3.0)
    for systems in (ABS, NO_SYSTEMS):
        assert way_m(full_braking(Plane(mu), systems)) > 0.98 * ideal


@LOCKING
def test_anti_lock_braking_stops_shorter_than_locked_wheels(mu):
    assert way_m(full_braking(Plane(mu), ABS)) < way_m(full_braking(Plane(mu), NO_SYSTEMS))


@FRICTIONS
def test_anti_lock_braking_lets_no_wheel_lock(mu):
    assert brake_slip_ratio(full_braking(Plane(mu), ABS)).max() < 0.5


def test_without_anti_lock_braking_a_full_pedal_locks_the_wheels():
    assert brake_slip_ratio(full_braking(Plane(0.5), NO_SYSTEMS)).max() > 0.99


@LOCKING
def test_with_anti_lock_braking_the_car_can_be_steered_while_it_brakes(mu):
    steer = 0.05 * mu
    yaw = full_braking(Plane(mu), ABS, steer_rad=steer).yaw_rate_radps[100:250]
    locked = full_braking(Plane(mu), NO_SYSTEMS, steer_rad=steer).yaw_rate_radps[100:250]
    assert yaw.mean() > 0.02 * mu
    assert yaw.mean() > 5.0 * abs(locked.mean())


def test_a_pedal_within_the_grip_does_not_wake_anti_lock_braking():
    pedal = ramp(4.0, -0.7 * 0.6 * GRAVITY_MPS2)
    motion = drive_open_loop(Plane(0.6), speed_mps=27.0, steer_rad=np.zeros(400), accel_mps2=pedal, systems=ALL_SYSTEMS)
    assert not motion.abs_active.any()
    assert not motion.esc_active.any()


LONG_STRAIGHT = build_section(
    section_id="straight",
    name="straight",
    nodes_m=np.column_stack([np.linspace(0.0, 400.0, 81), np.zeros(81), np.zeros(81)]),
    speed_limit_mps=20.0,
)


@pytest.mark.parametrize(("left_mu", "right_mu"), [(0.2, 0.8), (0.8, 0.2), (0.5, 0.3), (0.45, 0.6), (0.1, 0.5)])
def test_on_split_friction_a_driver_brakes_to_a_crawl_within_his_lane(left_mu, right_mu):
    plan = PassagePlan(
        base_friction_mu=0.5,
        seed=1,
        target_speed_mps=20.0,
        sensor_grade=SensorGrade.IDEAL,
        friction_profile=FrictionProfile(
            station_m=np.array([0.0, 400.0]), left_mu=np.full(2, left_mu), right_mu=np.full(2, right_mu)
        ),
        braking=Braking(station_m=50.0, decel_mps2=11.0, end_speed_mps=3.0),
    )
    drive = simulate_passage(LONG_STRAIGHT, plan)
    assert drive.completed
    assert np.abs(drive.truth.lateral_offset_m).max() < 1.5
    assert drive.abs_active_frac > 0.0


def test_on_split_friction_anti_lock_braking_stops_shorter_than_both_sides_on_ice():
    stop = way_m(full_braking(Plane(0.3, right_friction_mu=0.4), ABS, start_mps=15.0), from_mps=13.0)
    assert stop < analytic.ideal_stop_m(0.3, from_mps=13.0, to_mps=3.0)


# --- traction control


@pytest.mark.parametrize("mu", [0.1, 0.2, 0.35])
@pytest.mark.parametrize("speed_mps", [3.0, 8.0])
def test_traction_control_keeps_the_wheels_from_spinning(mu, speed_mps):
    pedal = ramp(5.0, 6.0)
    motion = drive_open_loop(Plane(mu), speed_mps=speed_mps, steer_rad=np.zeros(500), accel_mps2=pedal, systems=TCS)
    slip = drive_slip_ratio(motion)
    assert slip.max() < 0.7
    assert slip[200:].max() < 0.15
    assert motion.tcs_active.any()


@pytest.mark.parametrize("mu", [0.1, 0.2, 0.35, 0.6])
def test_traction_control_accelerates_at_least_as_well_as_spinning_wheels(mu):
    pedal = ramp(5.0, 6.0)
    held, spun = (
        drive_open_loop(Plane(mu), speed_mps=5.0, steer_rad=np.zeros(500), accel_mps2=pedal, systems=systems)
        for systems in (TCS, NO_SYSTEMS)
    )
    assert held.velocity_x_mps[-1] > 0.99 * spun.velocity_x_mps[-1]


def test_traction_control_leaves_a_throttle_within_the_grip_alone():
    pedal = ramp(5.0, 1.5)
    motion = drive_open_loop(Plane(0.5), speed_mps=10.0, steer_rad=np.zeros(500), accel_mps2=pedal, systems=ALL_SYSTEMS)
    assert not motion.tcs_active.any()
    assert motion.accel_x_mps2[-1] == pytest.approx(1.5, rel=0.03)


# --- yaw control


@pytest.mark.parametrize("speed_mps", [10.0, 15.0, 20.0, 25.0, 30.0])
@pytest.mark.parametrize("swing_hz", [0.0, 0.4])
def test_yaw_control_sleeps_in_normal_driving(speed_mps, swing_hz):
    # 0.3 g on dry asphalt, as a long curve and as swift changes from side to side.
    angle = 0.3 * GRAVITY_MPS2 * (XC90.wheelbase_m / speed_mps**2 + analytic.understeer_gradient_s2pm(XC90))
    steer = ramp(6.0, angle, rise_s=1.0)
    if swing_hz > 0.0:
        steer = angle * np.sin(2.0 * np.pi * swing_hz * 0.01 * np.arange(600))
    motion = drive_open_loop(
        Plane(0.8), speed_mps=speed_mps, steer_rad=steer, accel_mps2=np.zeros(600), systems=ALL_SYSTEMS
    )
    assert not motion.esc_active.any()
    assert not motion.abs_active.any()
    assert not motion.tcs_active.any()


TAIL_HEAVY = XC90._replace(front_axle_m=1.65, rear_axle_m=XC90.wheelbase_m - 1.65)


@pytest.mark.parametrize("mu", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("left", [True, False])
def test_against_oversteer_yaw_control_brakes_the_outer_front_wheel(mu, left):
    steer = ramp(5.0, 0.1 * mu * (1.0 if left else -1.0), start_s=0.5, rise_s=0.05)
    loose, held = (
        drive_open_loop(Plane(mu), speed_mps=25.0, steer_rad=steer, vehicle=TAIL_HEAVY, systems=systems)
        for systems in (NO_SYSTEMS, ESC)
    )
    assert np.abs(loose.velocity_y_mps / loose.velocity_x_mps).max() > 0.4
    assert np.abs(held.velocity_y_mps / held.velocity_x_mps).max() < 0.2
    sliding = held.esc_active & (np.abs(held.velocity_y_mps / held.velocity_x_mps) > 0.09)
    braking = -held.wheel_force_x_n[sliding].mean(0)
    assert int(np.argmax(braking)) == (FRONT_RIGHT if left else FRONT_LEFT)


@pytest.mark.parametrize("mu", [0.3, 0.6])
@pytest.mark.parametrize("left", [True, False])
def test_against_understeer_yaw_control_brakes_the_inner_rear_wheel(mu, left):
    nose_heavy = XC90._replace(front_axle_m=1.2, rear_axle_m=XC90.wheelbase_m - 1.2)
    steer = ramp(3.0, 0.25 * (1.0 if left else -1.0), start_s=0.5, rise_s=2.0)
    motion = drive_open_loop(Plane(mu), speed_mps=25.0, steer_rad=steer, vehicle=nose_heavy, systems=ESC)
    # Before its help turns the tail out.
    first = int(np.argmax(motion.esc_active))
    assert motion.esc_active[first]
    early = slice(first + 1, first + 30)
    braking = -motion.wheel_force_x_n[early].mean(0)
    assert int(np.argmax(braking)) == (REAR_LEFT if left else REAR_RIGHT)


@pytest.mark.parametrize("mu", [0.2, 0.3, 0.6])
def test_against_heavy_understeer_yaw_control_does_not_swing_the_car(mu):
    steer = ramp(8.0, 0.3, start_s=0.5, rise_s=3.0)
    motion = drive_open_loop(Plane(mu), speed_mps=25.0, steer_rad=steer, systems=ALL_SYSTEMS)
    carried = mu * GRAVITY_MPS2 / motion.velocity_x_mps
    share = (motion.yaw_rate_radps / carried)[500:]
    assert share.min() > 0.2
    assert np.ptp(share) < 1.0


def test_yaw_control_cuts_the_drive_torque():
    steer = ramp(3.0, 0.06, start_s=0.5, rise_s=0.05)
    throttle = np.full(300, 2.0)
    motions = [
        drive_open_loop(
            Plane(0.6), speed_mps=22.0, steer_rad=steer, accel_mps2=throttle, vehicle=TAIL_HEAVY, systems=systems
        )
        for systems in (NO_SYSTEMS, ESC)
    ]
    sliding = motions[1].esc_active & (np.abs(motions[1].velocity_y_mps / motions[1].velocity_x_mps) > 0.06)
    assert sliding.any()
    force = [motion.wheel_force_x_n[sliding].sum(1).mean() for motion in motions]
    assert force[0] > 2_000.0
    assert force[1] < 0.6 * force[0]


def sine_with_dwell(amplitude_rad, *, seconds=6.0, swing_hz=0.7, dwell_s=0.5):
    """Return the steering of the test of FMVSS 126: one period of 0.7 Hz with a pause of 0.5 s in its second peak."""
    phase = 0.01 * np.arange(round(100 * seconds)) - 1.0
    peak = 0.75 / swing_hz
    phase = np.where(phase < peak, phase, np.maximum(peak, phase - dwell_s))
    return np.where(
        (phase > 0.0) & (phase < 1.0 / swing_hz), amplitude_rad * np.sin(2.0 * np.pi * swing_hz * phase), 0.0
    )


@pytest.mark.parametrize("mu", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("amplitude_rad", [0.08, 0.15])
def test_yaw_control_passes_the_sine_with_dwell(mu, amplitude_rad):
    # FMVSS 126 (49 CFR 571.126), S5.2: of the peak yaw rate 35 % a second after the end of steering, 20 % after 1.75 s.
    steer = sine_with_dwell(amplitude_rad)
    motion = drive_open_loop(Plane(mu), speed_mps=22.2, steer_rad=steer, systems=ALL_SYSTEMS)
    yaw = motion.yaw_rate_radps
    end = int(np.flatnonzero(steer)[-1]) + 1
    peak = np.abs(yaw[170:end]).max()
    assert abs(yaw[end + 100]) <= 0.35 * peak
    assert abs(yaw[end + 175]) <= 0.20 * peak


def test_the_sine_with_dwell_spins_the_car_without_yaw_control():
    motion = drive_open_loop(Plane(0.9), speed_mps=22.2, steer_rad=sine_with_dwell(0.15), systems=NO_SYSTEMS)
    assert np.abs(np.arctan2(motion.velocity_y_mps, motion.velocity_x_mps)).max() > 1.0


def test_plans_that_spin_stay_on_the_road_with_yaw_control(rng):
    road = curvy_road(radius_m=70.0, speed_mps=19.0)
    plans = [
        replace(
            draw_plan(rng, section=road, base_friction_mu=mu, kind=DriverKind.REACTING),
            target_speed_mps=19.0,
            sensor_grade=SensorGrade.IDEAL,
            stability=NO_SYSTEMS,
        )
        for mu in (0.5, 0.6, 0.7)
        for _ in range(16)
    ]
    without = simulate_passages(road, plans)
    spun = [plan for plan, drive in zip(plans, without, strict=True) if drive.outcome is DriveOutcome.SPUN]
    held = simulate_passages(road, [replace(plan, stability=ALL_SYSTEMS) for plan in spun])
    assert len(spun) >= 8
    assert not any(drive.outcome is DriveOutcome.SPUN for drive in held)
    assert sum(drive.completed for drive in held) > 0.5 * len(held)


def test_the_systems_do_nothing_to_a_drive_that_does_not_need_them():
    plan = PassagePlan(
        base_friction_mu=0.9,
        seed=4,
        target_speed_mps=12.0,
        sensor_grade=SensorGrade.IDEAL,
        driver=Driver(comfort_accel_mps2=3.0),
    )
    helped, alone = (
        simulate_passage(curvy_road(), replace(plan, stability=systems)) for systems in (ALL_SYSTEMS, NO_SYSTEMS)
    )
    assert helped.esc_active_frac == helped.abs_active_frac == helped.tcs_active_frac == 0.0
    assert np.array_equal(helped.truth.yaw_rate_radps, alone.truth.yaw_rate_radps)

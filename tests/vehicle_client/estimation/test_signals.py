"""The virtual sensor as a whole, on motion whose every signal is known."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.section import build_section
from roadgrip.units import GRAVITY_MPS2, SAMPLE_S, FloatArray
from tests.vehicle_client.synthetic import bump, clock_s, motion, negative, road, with_noise
from vehicle_client.estimation.filters import smoothed
from vehicle_client.estimation.mounting import in_car_axes, mounting_rotation
from vehicle_client.estimation.observer import PAPER_PARAMETERS, XC90_PARAMETERS, ObserverParameters
from vehicle_client.estimation.offsets import NO_OFFSETS, SensorOffsets
from vehicle_client.estimation.signals import kinematic_signals, unmapped_velocity_y_mps
from vehicle_client.estimation.summary import KinematicSignals
from vehicle_client.estimation.trace import Trace, mirrored
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry

N = 2000
TIME_S = clock_s(N)
LEVEL = road(lambda station_m: bump(station_m, start_m=0.0, length_m=1.0, peak_1pm=0.0))
SLIP_FREE = replace(XC90_PARAMETERS, rear_slip_gradient_s2pm=0.0)
SIGNED = {
    "steer_rad",
    "sideslip_rad",
    "sideslip_rate_radps",
    "yaw_rate_excess_radps",
    "velocity_y_mps",
    "yaw_rate_radps",
    "chassis_roll_rad",
}


def estimated(
    trace: Trace,
    *,
    section=LEVEL,
    vehicle: VehicleGeometry = XC90,
    parameters: ObserverParameters = XC90_PARAMETERS,
    offsets: SensorOffsets = NO_OFFSETS,
) -> KinematicSignals:
    return kinematic_signals(
        trace,
        section,
        station_m=np.zeros(trace.samples_count),
        vehicle=vehicle,
        parameters=parameters,
        offsets=offsets,
    )


def lane_changes_radps(time_s: FloatArray) -> FloatArray:
    """Return the yaw rate of a car that changes lanes, again and again."""
    return 0.15 * np.sin(2.0 * np.pi * 0.25 * time_s)


def gripping_velocity_mps(
    speed_mps: FloatArray, yaw_rate_radps: FloatArray, slip_gradient_s2pm: float, tilt_rad: float = 0.0
) -> FloatArray:
    """Return the lateral velocity of a car whose rear tyres slip in proportion to the lateral force."""
    # V_y = b_r w - D V (dV_y/dt + w V + g sin(tilt)), by the trapezoidal rule.
    force = yaw_rate_radps * speed_mps + GRAVITY_MPS2 * np.sin(tilt_rad)
    settled = XC90.rear_axle_m * yaw_rate_radps - slip_gradient_s2pm * speed_mps * force
    lag_s = slip_gradient_s2pm * speed_mps
    left = [float(settled[0])]
    for k in range(1, len(speed_mps)):
        share = SAMPLE_S / (lag_s[k] + lag_s[k - 1])
        left.append((left[-1] * (1.0 - share) + share * (settled[k] + settled[k - 1])) / (1.0 + share))
    return np.array(left)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# Motion with a known sideslip ----------------------------------------------------------------------------------------


def test_a_bicycle_that_changes_lanes_without_slip_is_seen_exactly():
    w, v = lane_changes_radps(TIME_S), np.full(N, 15.0)
    left = XC90.rear_axle_m * w
    found = estimated(motion(v, w, velocity_y_mps=left), parameters=SLIP_FREE)
    truth = np.arctan(left / v)
    assert np.abs(truth).max() > 0.015
    assert np.abs(found.sideslip_rad - truth)[100:-100].max() < 3e-4
    assert np.abs(found.speed_mps - 15.0)[100:-100].max() < 5e-3


@pytest.mark.parametrize("swing_mps", [0.0, 3.0])
def test_a_bicycle_whose_tyres_slip_in_proportion_is_seen_exactly(swing_mps):
    v = 18.0 + swing_mps * np.sin(0.4 * TIME_S)
    w = lane_changes_radps(TIME_S)
    left = gripping_velocity_mps(v, w, XC90_PARAMETERS.rear_slip_gradient_s2pm)
    found = estimated(motion(v, w, velocity_y_mps=left))
    assert np.abs(found.sideslip_rad - np.arctan(left / v))[100:-100].max() < 6e-4


@pytest.mark.parametrize("radius_m", [25.0, 60.0, 150.0])
def test_a_steady_circle_at_the_sideslip_of_a_gripping_car_is_seen_exactly(radius_m):
    speed = np.sqrt(3.0 * radius_m)
    v, w = np.full(N, speed), np.full(N, speed / radius_m)
    sideslip = XC90.rear_axle_m / radius_m - XC90_PARAMETERS.rear_slip_gradient_s2pm * speed**2 / radius_m
    found = estimated(motion(v, w, velocity_y_mps=v * sideslip))
    assert found.sideslip_rad[N // 2] == pytest.approx(np.arctan(sideslip), abs=2e-4)
    # In a steady circle the formula of the paper knows no sideslip rate, whatever the sideslip.
    assert np.abs(found.sideslip_rate_radps)[200:-200].max() < 2e-4


@pytest.mark.parametrize("frequency_hz", [0.4, 0.8])
def test_sliding_that_nobody_expects_is_seen_in_time_and_sign(frequency_hz):
    # A body with a prescribed sideslip in a bend: half of it a gripping car's, the rest sliding.
    v, w = np.full(N, 15.0), np.full(N, 0.2)
    truth = 0.03 * np.sin(2.0 * np.pi * frequency_hz * TIME_S)
    found = estimated(motion(v, w, velocity_y_mps=v * np.tan(truth))).sideslip_rad[200:-200]
    varied, truth = found - found.mean(), truth[200:-200]
    assert np.corrcoef(varied, truth)[0, 1] > 0.99
    assert 0.8 < (varied @ truth) / (truth @ truth) < 1.05


def test_the_sideslip_rate_is_the_papers_formula():
    v, w = np.full(N, 20.0), np.zeros(N)
    left = 0.4 * np.sin(3.0 * TIME_S)
    found = estimated(motion(v, w, velocity_y_mps=left), parameters=PAPER_PARAMETERS)
    assert np.abs(found.sideslip_rate_radps - 1.2 * np.cos(3.0 * TIME_S) / 20.0)[200:-200].max() < 2e-3


# Constants, mirrors, shifts ------------------------------------------------------------------------------------------


def test_a_parked_car_has_no_motion():
    found = estimated(motion(np.zeros(N), np.zeros(N), steer_rad=np.full(N, 0.1)))
    assert np.allclose(found.steer_rad, 0.1)
    for name in ("sideslip_rad", "sideslip_rate_radps", "yaw_rate_excess_radps", "speed_mps", "velocity_y_mps"):
        assert np.allclose(getattr(found, name), 0.0, atol=1e-12), name


def test_constant_signals_stay_constant():
    found = estimated(motion(np.full(N, 14.0), np.full(N, 0.18)), parameters=PAPER_PARAMETERS)
    for field in fields(KinematicSignals):
        values = getattr(found, field.name)
        assert np.abs(values - values[0]).max() < 1e-9, field.name


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_mirrored_trace_has_mirrored_signals(seed):
    curvature = lambda station_m: bump(station_m, start_m=0.0, length_m=400.0, peak_1pm=1 / 90.0)  # noqa: E731 - short
    v = 16.0 + np.sin(0.5 * TIME_S)
    trace = with_noise(
        motion(v, lane_changes_radps(TIME_S) + 0.1, velocity_y_mps=0.3 * np.sin(TIME_S)), np.random.default_rng(seed)
    )
    here = estimated(trace, section=road(curvature, cross_slope_ratio=0.05))
    there = estimated(mirrored(trace), section=road(negative(curvature), cross_slope_ratio=-0.05))
    for field in fields(KinematicSignals):
        sign = -1.0 if field.name in SIGNED else 1.0
        assert np.allclose(getattr(there, field.name), sign * getattr(here, field.name), atol=1e-9), field.name


def test_the_hour_of_the_day_does_not_matter():
    trace = with_noise(motion(np.full(N, 15.0), lane_changes_radps(TIME_S)), np.random.default_rng(1))
    here, later = estimated(trace), estimated(replace(trace, time_s=trace.time_s + 5e4))
    for field in fields(KinematicSignals):
        assert np.array_equal(getattr(here, field.name), getattr(later, field.name)), field.name


def test_a_longer_approach_only_shifts_the_signals():
    # Five seconds more of a straight before: the same signals five seconds later, once filters and observer forget.
    def drive(straight_s: float) -> Trace:
        time = clock_s(round((straight_s + 10.0) / SAMPLE_S)) - straight_s
        w = np.where(time > 0.0, lane_changes_radps(time) ** 3 * 20.0, 0.0)
        return motion(np.full(len(time), 15.0), w, velocity_y_mps=0.3 * w)

    short, long = estimated(drive(10.0)), estimated(drive(15.0))
    for name in ("sideslip_rad", "sideslip_rate_radps", "yaw_rate_excess_radps", "speed_mps"):
        there, here = getattr(long, name)[1500:], getattr(short, name)[1000:]
        assert np.abs(there - here).max() < 2e-4, name


def test_offsets_are_what_is_taken_off_the_sensors():
    trace = with_noise(motion(np.full(N, 15.0), lane_changes_radps(TIME_S)), np.random.default_rng(1))
    offsets = replace(NO_OFFSETS, yaw_rate_radps=0.003, accel_x_mps2=-0.1, accel_y_mps2=0.2, steer_rad=-0.004)
    off = replace(
        trace,
        yaw_rate_radps=trace.yaw_rate_radps + 0.003,
        accel_x_mps2=trace.accel_x_mps2 - 0.1,
        accel_y_mps2=trace.accel_y_mps2 + 0.2,
        steer_rad=trace.steer_rad - 0.004,
    )
    here, there = estimated(trace), estimated(off, offsets=offsets)
    for field in fields(KinematicSignals):
        assert np.allclose(getattr(there, field.name), getattr(here, field.name), atol=1e-12), field.name


def test_gravity_along_a_climb_is_no_acceleration():
    trace = with_noise(motion(15.0 + np.sin(TIME_S), lane_changes_radps(TIME_S)), np.random.default_rng(1))
    climb = np.arctan(0.08)
    uphill = replace(
        trace,
        accel_x_mps2=trace.accel_x_mps2 + GRAVITY_MPS2 * np.sin(climb),
        # Turning about the vertical turns a car that points up about its long axis, too.
        roll_rate_radps=trace.roll_rate_radps + trace.yaw_rate_radps * np.tan(climb),
    )
    nodes = np.linspace(0.0, 400.0, 81)[:, None] * [1.0, 0.0, 0.08]
    steep = build_section(section_id="steep", name="A climb", nodes_m=nodes, speed_limit_mps=20.0)
    here, there = estimated(trace), estimated(uphill, section=steep)
    for field in fields(KinematicSignals):
        assert np.allclose(getattr(there, field.name), getattr(here, field.name), atol=1e-9), field.name


def test_in_the_tightest_turn_the_speed_is_that_of_the_centre_of_gravity():
    # The centre moves 0.6 m/s sideways, which the front wheels, turned by 0.36 rad, see as a part of their speed.
    v, w = np.full(N, 3.3), np.full(N, 0.4)
    found = estimated(motion(v, w, velocity_y_mps=XC90.rear_axle_m * w), parameters=SLIP_FREE)
    assert np.abs(found.speed_mps - 3.3).max() < 5e-3


def test_a_car_that_rolls_backwards_has_no_forward_speed():
    found = estimated(motion(np.full(N, -2.0), np.zeros(N), steer_rad=np.zeros(N)))
    assert (found.speed_mps == 0.0).all()


def test_what_shakes_the_gyro_does_not_shake_the_velocities():
    shaking = 0.2 * np.sin(2.0 * np.pi * 40.0 * TIME_S)
    found = estimated(replace(motion(np.full(N, 20.0), np.zeros(N)), yaw_rate_radps=shaking))
    for name in ("velocity_x_mps", "velocity_y_mps"):
        values = getattr(found, name)
        assert np.abs(values - smoothed(values))[60:-60].max() < 1e-5, name


# Where the sensor sits -----------------------------------------------------------------------------------------------


def _sensed_at(trace: Trace, *, x_m: float, y_m: float) -> Trace:
    w = trace.yaw_rate_radps
    dw = np.gradient(w, SAMPLE_S)
    return replace(
        trace,
        accel_x_mps2=trace.accel_x_mps2 - dw * y_m - w**2 * x_m,
        accel_y_mps2=trace.accel_y_mps2 + dw * x_m - w**2 * y_m,
    )


@pytest.mark.parametrize(("x_m", "y_m"), [(1.2, 0.0), (-0.8, 0.5), (0.0, -0.6)])
def test_the_same_motion_sensed_elsewhere_gives_the_same_signals(x_m, y_m):
    trace = motion(np.full(N, 15.0), lane_changes_radps(TIME_S), velocity_y_mps=0.4 * np.sin(1.3 * TIME_S))
    vehicle = replace(XC90, imu_x_m=x_m, imu_y_m=y_m)
    there = _sensed_at(trace, x_m=x_m, y_m=y_m)
    here, found = estimated(trace), estimated(there, vehicle=vehicle)
    uncorrected = estimated(there)
    for name in ("sideslip_rad", "sideslip_rate_radps", "velocity_x_mps"):
        error = rms((getattr(found, name) - getattr(here, name))[40:-40])
        assert error < 2e-5, name
    assert rms((uncorrected.sideslip_rate_radps - here.sideslip_rate_radps)[40:-40]) > 2e-4


@pytest.mark.parametrize(
    ("roll_rad", "pitch_rad", "yaw_rad"), [(0.06, 0.0, 0.0), (0.0, -0.08, 0.0), (0.0, 0.0, 0.15), (0.04, 0.05, -0.1)]
)
def test_a_turned_sensor_gives_the_same_signals(roll_rad, pitch_rad, yaw_rad):
    trace = motion(15.0 + np.sin(TIME_S), lane_changes_radps(TIME_S), velocity_y_mps=0.4 * np.sin(1.3 * TIME_S))
    vehicle = replace(XC90, imu_roll_rad=roll_rad, imu_pitch_rad=pitch_rad, imu_yaw_rad=yaw_rad)
    # The sensor's axes see the car's vectors turned back; gravity is the car's vertical specific force.
    back = mounting_rotation(vehicle).T
    up, none = np.full(N, GRAVITY_MPS2), np.zeros(N)
    force = back @ np.vstack([trace.accel_x_mps2, trace.accel_y_mps2, up])
    rate = back @ np.vstack([trace.roll_rate_radps, none, trace.yaw_rate_radps])
    turned = replace(
        trace, accel_x_mps2=force[0], accel_y_mps2=force[1], roll_rate_radps=rate[0], yaw_rate_radps=rate[2]
    )
    here, found = estimated(trace), estimated(in_car_axes(turned, vehicle), vehicle=vehicle)
    for field in fields(KinematicSignals):
        assert np.allclose(getattr(found, field.name), getattr(here, field.name), atol=1e-9), field.name


# Bank and grade ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slope", [-0.06, 0.04])
def test_a_car_parked_on_a_bank_does_not_slide(slope):
    tilt = float(np.arctan(slope))
    section = road(lambda station_m: 0.0 * station_m, cross_slope_ratio=slope)
    found = estimated(motion(np.zeros(N), np.zeros(N), steer_rad=np.zeros(N), tilt_rad=tilt), section=section)
    for name in ("velocity_y_mps", "sideslip_rad", "sideslip_rate_radps", "chassis_roll_rad"):
        assert np.abs(getattr(found, name)).max() < 1e-9, name


@pytest.mark.parametrize("slope", [-0.06, 0.04])
@pytest.mark.parametrize("known", [True, False])
def test_a_car_straight_along_a_bank_crabs_as_its_tyres_hold_it_and_no_more(slope, known):
    tilt = float(np.arctan(slope))
    v, w = np.full(N, 20.0), np.zeros(N)
    left = gripping_velocity_mps(v, w, XC90_PARAMETERS.rear_slip_gradient_s2pm, tilt)
    section = road(lambda station_m: 0.0 * station_m, cross_slope_ratio=slope if known else 0.0)
    found = estimated(motion(v, w, velocity_y_mps=left, tilt_rad=tilt), section=section)
    assert np.abs(found.sideslip_rad - np.arctan(left / v)).max() < 1e-5
    assert np.abs(found.sideslip_rate_radps).max() < 1e-9


def test_a_car_without_a_roll_gyro_sees_its_sideslip_too():
    # The lean of the body, 1 degree to either side, would else be taken for 0.17 m/s^2 of sliding.
    v, w = np.full(N, 15.0), lane_changes_radps(TIME_S)
    left = gripping_velocity_mps(v, w, XC90_PARAMETERS.rear_slip_gradient_s2pm)
    lean = XC90_PARAMETERS.roll_gradient_s2pm * (np.gradient(left, SAMPLE_S) + w * v)
    trace = motion(v, w, velocity_y_mps=left, tilt_rad=lean)
    lacking = replace(trace, roll_rate_radps=np.zeros(N), absent=("roll_rate_radps",))
    truth = np.arctan(left / v)

    def error(sensed: Trace) -> float:
        return rms((estimated(sensed).sideslip_rad - truth)[200:-200])

    assert error(lacking) < 5e-4
    assert error(lacking) < error(replace(lacking, absent=())) / 4.0
    # A car that has the gyro goes by it.
    assert error(trace) < 5e-4


def test_a_bank_that_comes_and_goes_is_not_taken_for_sliding():
    tilt = 0.05 * np.sin(2.0 * np.pi * TIME_S / 10.0) ** 2
    found = estimated(motion(np.full(N, 20.0), np.zeros(N), tilt_rad=tilt), parameters=PAPER_PARAMETERS)
    assert np.abs(found.sideslip_rad).max() < 1e-4


def test_before_the_map_is_known_the_road_is_taken_for_level():
    trace = motion(np.full(N, 20.0), lane_changes_radps(TIME_S))
    seen = unmapped_velocity_y_mps(trace, vehicle=XC90, parameters=XC90_PARAMETERS)
    assert seen == pytest.approx(estimated(trace).velocity_y_mps)


def test_without_a_lateral_accelerometer_no_lateral_velocity_is_made_up():
    trace = replace(motion(np.full(N, 20.0), lane_changes_radps(TIME_S)), absent=("accel_y_mps2",))
    assert unmapped_velocity_y_mps(trace, vehicle=XC90, parameters=XC90_PARAMETERS) is None

"""Laws of the body: understeer, eigenvalues, energy and momentum, mirror symmetry, statics, rest."""

import math
from dataclasses import replace

import numpy as np
import pytest

from roadgrip.units import GRAVITY_MPS2
from tests.vehicle_client.simulator import analytic
from tests.vehicle_client.simulator.rig import curvy_road
from vehicle_client.simulator.plan import ALL_SYSTEMS, NO_SYSTEMS
from vehicle_client.simulator.proving_ground import Plane, drive_open_loop
from vehicle_client.simulator.run import Driver, PassagePlan, SensorGrade, simulate_passage
from vehicle_client.simulator.vehicle import XC90

pytestmark = pytest.mark.sim

LINEAR = Plane(4.0)
"""So much grip that the tyres answer in proportion."""
UNRESISTED = XC90._replace(
    drag_npm2ps2_ratio=0.0, steer_compliance_radpn=0.0, tyre=XC90.tyre._replace(rolling_resistance_ratio=0.0)
)
"""Without air and rolling resistance, and with a rigid steering."""
MIRRORED_WHEELS = [1, 0, 3, 2]


def steady(seconds, value):
    return np.full(round(100 * seconds), float(value))


def test_the_understeer_gradient_is_the_analytic_one():
    # Steering over curvature is L + K v^2: the slope over v^2 is K, whatever offset friction in the axles adds.
    speeds = np.array([10.0, 15.0, 20.0, 25.0, 30.0, 35.0])
    ratio = []
    for speed in speeds:
        steer = 0.4 * XC90.wheelbase_m / speed**2
        motion = drive_open_loop(LINEAR, speed_mps=speed, steer_rad=steady(4.0, steer), hold_speed=True)
        ratio.append(steer * motion.velocity_x_mps[-1] / motion.yaw_rate_radps[-1])
    gradient, wheelbase = np.polyfit(speeds**2, ratio, 1)
    assert wheelbase == pytest.approx(XC90.wheelbase_m, rel=0.005)
    assert gradient == pytest.approx(analytic.understeer_gradient_s2pm(XC90), rel=0.05)


@pytest.mark.parametrize("front_axle_m", [1.30, 1.65])
def test_the_understeer_gradient_follows_the_centre_of_gravity(front_axle_m):
    car = XC90._replace(front_axle_m=front_axle_m, rear_axle_m=XC90.wheelbase_m - front_axle_m)
    speed, steer = 25.0, 0.4 * XC90.wheelbase_m / 25.0**2
    motion = drive_open_loop(LINEAR, speed_mps=speed, steer_rad=steady(5.0, steer), hold_speed=True, vehicle=car)
    need = steer * motion.velocity_x_mps[-1] / motion.yaw_rate_radps[-1]
    assert need == pytest.approx(car.wheelbase_m + analytic.understeer_gradient_s2pm(car) * speed**2, rel=0.01)


def free_poles_radps(speed_mps):
    """Return the eigenvalues that the motion after a pulse of the steering shows, slowest first. (4,)

    Lateral velocity, yaw rate and the axles' forces are a linear transform of the state of the linear model, so the
    matrix that carries them from sample to sample has its eigenvalues. Nothing resists, so that no longitudinal slip
    takes part.
    """
    # A step of half a millisecond, since the question is what is solved and not how coarsely.
    steer = np.concatenate([steady(0.05, 0.002), steady(0.6, 0.0)])
    motion = drive_open_loop(LINEAR, speed_mps=speed_mps, steer_rad=steer, step_s=0.0005, vehicle=UNRESISTED)
    front, rear = motion.wheel_force_y_n[:, :2].sum(1), motion.wheel_force_y_n[:, 2:].sum(1)
    states = np.column_stack([motion.velocity_y_mps, motion.yaw_rate_radps, front, rear])[7:]
    states /= np.abs(states).max(0)
    carried = np.linalg.lstsq(states[:-1], states[1:], rcond=None)[0]
    poles = np.log(np.linalg.eigvals(carried).astype(complex)) / 0.01
    return poles[np.argsort(np.abs(poles))]


def frequency_and_damping(poles):
    """Return natural frequency and damping ratio of the slowest two."""
    frequency = math.sqrt((poles[0] * poles[1]).real)
    return frequency, -(poles[0] + poles[1]).real / (2.0 * frequency)


@pytest.mark.parametrize("speed_mps", [15.0, 20.0, 30.0, 40.0])
def test_natural_frequency_and_damping_are_those_of_the_linear_single_track_model(speed_mps):
    seen = frequency_and_damping(free_poles_radps(speed_mps))
    expected = frequency_and_damping(analytic.single_track_poles_radps(speed_mps, UNRESISTED))
    assert seen == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("speed_mps", [12.0, 20.0, 30.0])
def test_a_small_step_of_the_steering_is_answered_as_by_the_linear_single_track_model(speed_mps):
    # The steering gets from zero to its angle in the sample between; its middle is time zero.
    steer = np.concatenate([[0.0], steady(1.5, 0.003)])
    motion = drive_open_loop(Plane(0.8), speed_mps=speed_mps, steer_rad=steer, hold_speed=True)
    expected = analytic.step_response_radps(motion.time_s[1:] - 0.005, speed_mps=speed_mps, steer_rad=0.003)
    assert np.abs(motion.yaw_rate_radps[1:] - expected).max() < 0.03 * expected[-1]


def energy_j(motion, car):
    """Return kinetic energy of body and wheels, energy of roll and of the tyres' carcasses."""
    tyre, arm = car.tyre, analytic.roll_arm_m(car)
    spring = car.roll_stiffness_nmprad - car.mass_kg * GRAVITY_MPS2 * arm
    roll_rate = np.gradient(motion.roll_rad, 0.01)
    return (
        0.5 * car.mass_kg * (motion.velocity_x_mps**2 + motion.velocity_y_mps**2)
        + 0.5 * car.yaw_inertia_kgm2 * motion.yaw_rate_radps**2
        + 0.5 * car.wheel_inertia_kgm2 * (motion.wheel_speed_radps**2).sum(1)
        + 0.5 * spring * motion.roll_rad**2
        + 0.5 * car.roll_inertia_kgm2 * roll_rate**2
        + (0.5 * motion.wheel_force_x_n**2 / tyre.stiffness_x_npm).sum(1)
        + (0.5 * motion.wheel_force_y_n**2 / tyre.stiffness_y_npm).sum(1)
    )


@pytest.mark.parametrize("mu", [0.15, 0.4, 0.9])
def test_a_car_that_rolls_free_never_gains_energy_whatever_is_steered(mu):
    time = np.arange(600) * 0.01
    steer = 0.08 * np.sin(2.0 * time) + 0.03 * np.sin(9.0 * time)
    energy = energy_j(drive_open_loop(Plane(mu), speed_mps=25.0, steer_rad=steer), XC90)
    assert energy[-1] < energy[0]
    # Over a tenth of a second, in which springs give back what they took.
    assert (energy[10:] - energy[:-10]).max() < 2e-4 * energy[0]


def test_straight_coasting_loses_what_air_and_rolling_resistance_take():
    car = XC90
    motion = drive_open_loop(Plane(0.8), speed_mps=35.0, steer_rad=steady(12.0, 0.0))
    energy = energy_j(motion, car)
    speed = motion.velocity_x_mps
    resisting = car.drag_npm2ps2_ratio * speed**3
    resisting += (
        car.tyre.rolling_resistance_ratio
        * (motion.wheel_load_n * motion.wheel_speed_radps).sum(1)
        * (car.tyre.rolling_radius_m)
    )
    taken = np.trapezoid(resisting[50:], dx=0.01)
    assert energy[50] - energy[-1] == pytest.approx(taken, rel=2e-3)


def test_without_air_and_rolling_resistance_a_straight_coast_loses_nothing():
    motion = drive_open_loop(Plane(0.8), speed_mps=30.0, steer_rad=steady(5.0, 0.0), vehicle=UNRESISTED)
    assert motion.velocity_x_mps[-1] == pytest.approx(30.0, rel=1e-12)


def test_on_a_surface_without_grip_momentum_stays_while_the_car_turns():
    # A body with next to no yaw inertia turns round even there; its velocity over ground must not notice.
    car = XC90._replace(drag_npm2ps2_ratio=0.0, yaw_inertia_kgm2=60.0)
    mu, seconds = 1e-3, 4.0
    motion = drive_open_loop(Plane(mu), speed_mps=20.0, steer_rad=steady(seconds, 0.3), vehicle=car, step_s=0.001)
    heading = np.concatenate([[0.0], np.cumsum(motion.yaw_rate_radps[1:] + motion.yaw_rate_radps[:-1]) * 0.005])
    east = motion.velocity_x_mps * np.cos(heading) - motion.velocity_y_mps * np.sin(heading)
    north = motion.velocity_x_mps * np.sin(heading) + motion.velocity_y_mps * np.cos(heading)
    assert np.ptp(heading) > 0.4
    assert np.hypot(east - 20.0, north).max() < 1.2 * mu * GRAVITY_MPS2 * seconds


def test_what_changes_momentum_is_the_force_of_the_tyres():
    car = XC90._replace(drag_npm2ps2_ratio=0.0)
    steer = 0.05 * np.sin(3.0 * np.arange(400) * 0.01)
    motion = drive_open_loop(Plane(0.7), speed_mps=22.0, steer_rad=steer, vehicle=car, step_s=0.0005)
    turned = (
        motion.accel_y_mps2 - np.gradient(motion.velocity_y_mps, 0.01) - motion.yaw_rate_radps * motion.velocity_x_mps
    )
    assert np.abs(turned[2:-2]).max() < 0.02 * np.abs(motion.accel_y_mps2).max()


def test_yaw_accelerates_as_the_moments_of_the_tyre_forces_say():
    # Braking on split friction with straight wheels: longitudinal forces turn the car, lateral ones hold it.
    plane = Plane(0.9, right_friction_mu=0.3)
    pedal = -6.0 * np.clip(0.01 * np.arange(80) / 0.3, 0.0, 1.0)
    motion = drive_open_loop(plane, speed_mps=25.0, steer_rad=steady(0.8, 0.0), accel_mps2=pedal, step_s=0.0005)
    x = np.array([XC90.front_axle_m] * 2 + [-XC90.rear_axle_m] * 2)
    y = 0.5 * np.array([XC90.front_track_m, -XC90.front_track_m, XC90.rear_track_m, -XC90.rear_track_m])
    moment = (motion.wheel_force_y_n * x - motion.wheel_force_x_n * y).sum(1)
    turned = np.gradient(motion.yaw_rate_radps, 0.01) * XC90.yaw_inertia_kgm2
    assert np.abs(motion.wheel_force_x_n @ y).max() > 1_500.0
    assert np.abs(turned - moment)[2:-2].max() < 0.02 * np.abs(motion.wheel_force_x_n @ y).max()


@pytest.mark.parametrize("systems", [NO_SYSTEMS, ALL_SYSTEMS])
@pytest.mark.parametrize("pedals_mps2", [-9.0, 0.0, 3.0])
def test_mirrored_steering_on_a_mirrored_surface_gives_the_mirrored_motion(systems, pedals_mps2):
    steer = 0.05 * np.sin(2.0 * np.arange(250) * 0.01)
    left = drive_open_loop(
        Plane(0.5, right_friction_mu=0.6, cross_slope_ratio=0.04),
        speed_mps=22.0,
        steer_rad=steer,
        accel_mps2=steady(2.5, pedals_mps2),
        systems=systems,
    )
    right = drive_open_loop(
        Plane(0.6, right_friction_mu=0.5, cross_slope_ratio=-0.04),
        speed_mps=22.0,
        steer_rad=-steer,
        accel_mps2=steady(2.5, pedals_mps2),
        systems=systems,
    )
    for name in ("velocity_y_mps", "yaw_rate_radps", "roll_rad", "accel_y_mps2"):
        np.testing.assert_allclose(getattr(left, name), -getattr(right, name), rtol=0.0, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(left.velocity_x_mps, right.velocity_x_mps, rtol=1e-12)
    np.testing.assert_allclose(left.wheel_load_n, right.wheel_load_n[:, MIRRORED_WHEELS], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(left.wheel_force_x_n, right.wheel_force_x_n[:, MIRRORED_WHEELS], rtol=0.0, atol=1e-6)
    assert np.array_equal(left.esc_active, right.esc_active)
    assert np.array_equal(left.abs_active, right.abs_active)


@pytest.mark.parametrize("mu", [0.35, 0.6, 0.9])
def test_a_mirrored_road_is_driven_as_the_mirror_image(mu):
    plan = PassagePlan(
        base_friction_mu=mu,
        seed=3,
        target_speed_mps=17.0,
        sensor_grade=SensorGrade.IDEAL,
        roughness=None,
        driver=Driver(friction_guess_mu=1.1 * mu, comfort_accel_mps2=7.0, grip_share_ratio=0.85),
    )
    left = simulate_passage(curvy_road(bank_ratio=0.04), plan)
    right = simulate_passage(curvy_road(bank_ratio=0.04, mirrored=True), replace(plan))
    assert left.completed
    assert right.completed
    for name in ("sideslip_rad", "yaw_rate_radps", "steer_rad", "roll_rad", "lateral_offset_m"):
        np.testing.assert_allclose(getattr(left.truth, name), -getattr(right.truth, name), rtol=0, atol=1e-7)
    np.testing.assert_allclose(left.truth.velocity_x_mps, right.truth.velocity_x_mps, rtol=1e-8)
    assert left.label_mu == right.label_mu


@pytest.mark.parametrize("grade_ratio", [0.0, -0.08, 0.06])
def test_wheel_loads_carry_the_weight(grade_ratio):
    plane = Plane(0.9, grade_ratio=grade_ratio)
    motion = drive_open_loop(plane, speed_mps=15.0, steer_rad=steady(3.0, 0.03), accel_mps2=steady(3.0, -1.0))
    weight = XC90.mass_kg * GRAVITY_MPS2 / math.hypot(1.0, grade_ratio)
    np.testing.assert_allclose(motion.wheel_load_n[1:].sum(1), weight, rtol=1e-9)


def test_in_a_banked_bend_the_wheels_bear_a_part_of_the_centripetal_force():
    plan = PassagePlan(
        base_friction_mu=0.9, seed=1, target_speed_mps=17.0, sensor_grade=SensorGrade.IDEAL, roughness=None
    )
    truth = simulate_passage(curvy_road(radius_m=60.0, bank_ratio=0.07), plan).truth
    middle = np.abs(truth.station_m - 148.0) < 20.0
    bank = math.atan(-0.07)
    normal = GRAVITY_MPS2 * math.cos(bank) - truth.velocity_x_mps**2 / 60.0 * math.sin(bank)
    np.testing.assert_allclose(truth.wheel_load_n[middle].sum(1), XC90.mass_kg * normal[middle], rtol=2e-3)


@pytest.mark.parametrize("accel_y_mps2", [1.0, 3.0, 5.0])
def test_steady_cornering_shifts_load_as_statics_say(accel_y_mps2):
    steer = accel_y_mps2 * (XC90.wheelbase_m / 20.0**2 + analytic.understeer_gradient_s2pm(XC90))
    motion = drive_open_loop(Plane(0.9), speed_mps=20.0, steer_rad=steady(5.0, steer), hold_speed=True)
    expected = analytic.steady_loads_n(motion.accel_y_mps2[-1], force_x_mps2=float(motion.accel_x_mps2[-1]))
    np.testing.assert_allclose(motion.wheel_load_n[-1], expected, rtol=0.01)


@pytest.mark.parametrize("accel_y_mps2", [1.0, 3.0, 5.0])
def test_the_body_leans_as_its_springs_say(accel_y_mps2):
    steer = accel_y_mps2 * (XC90.wheelbase_m / 20.0**2 + analytic.understeer_gradient_s2pm(XC90))
    motion = drive_open_loop(Plane(0.9), speed_mps=20.0, steer_rad=steady(5.0, steer), hold_speed=True)
    assert motion.roll_rad[-1] == pytest.approx(analytic.steady_roll_rad(motion.accel_y_mps2[-1], XC90), rel=5e-3)


@pytest.mark.parametrize("decel_mps2", [1.0, 3.0, 6.0])
def test_steady_braking_shifts_load_as_statics_say(decel_mps2):
    motion = drive_open_loop(
        Plane(1.0), speed_mps=30.0, steer_rad=steady(2.0, 0.0), accel_mps2=steady(2.0, -decel_mps2)
    )
    expected = analytic.steady_loads_n(0.0, force_x_mps2=float(motion.accel_x_mps2[-1]))
    np.testing.assert_allclose(motion.wheel_load_n[-1], expected, rtol=5e-3)


@pytest.mark.parametrize("speed_mps", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize(("cross_slope_ratio", "grade_ratio"), [(0.0, 0.0), (-0.08, 0.06), (0.05, -0.10)])
def test_a_braked_car_comes_to_rest_and_stays_there(speed_mps, cross_slope_ratio, grade_ratio):
    plane = Plane(0.5, cross_slope_ratio=cross_slope_ratio, grade_ratio=grade_ratio)
    motion = drive_open_loop(
        plane, speed_mps=speed_mps, steer_rad=steady(12.0, 0.1), accel_mps2=steady(12.0, -3.0), systems=ALL_SYSTEMS
    )
    # It rocks on its tyres for a while; on average it creeps less than a tenth of a millimetre per second.
    velocity = np.column_stack([motion.velocity_x_mps, motion.velocity_y_mps])
    assert np.abs(velocity[700:].mean(0)).max() < 1e-4
    assert np.abs(velocity[1000:]).max() < 2e-4
    assert np.abs(velocity[800:1000]).max() < 0.7 * np.abs(velocity[300:500]).max() + 1e-4
    assert np.abs(motion.yaw_rate_radps[1000:]).max() < 1e-4


@pytest.mark.parametrize("speed_mps", [0.1, 0.5, 1.0])
def test_at_a_crawl_the_car_follows_its_front_wheels(speed_mps):
    motion = drive_open_loop(Plane(0.5), speed_mps=speed_mps, steer_rad=steady(20.0, 0.35), hold_speed=True)
    expected = motion.velocity_x_mps * math.tan(0.35) / XC90.wheelbase_m
    np.testing.assert_allclose(motion.yaw_rate_radps[1800:], expected[1800:], rtol=0.02)
    assert np.ptp(motion.yaw_rate_radps[1800:]) < 1e-3 * expected[-1]


@pytest.mark.parametrize("grade_ratio", [-0.1, 0.1])
def test_from_rest_on_a_hill_a_free_car_rolls_down_as_gravity_says(grade_ratio):
    motion = drive_open_loop(Plane(0.6, grade_ratio=grade_ratio), speed_mps=0.0, steer_rad=steady(3.0, 0.0))
    inertia = 1.0 + 4.0 * XC90.wheel_inertia_kgm2 / (XC90.mass_kg * XC90.tyre.rolling_radius_m**2)
    fall = (
        GRAVITY_MPS2 * (abs(grade_ratio) - XC90.tyre.rolling_resistance_ratio) / math.hypot(1.0, grade_ratio) / inertia
    )
    assert motion.velocity_x_mps[-1] == pytest.approx(-math.copysign(fall * 2.99, grade_ratio), rel=0.02)


@pytest.mark.parametrize("steer_rad", [-0.4, 0.0, 0.4])
def test_nothing_becomes_infinite_around_standstill(steer_rad):
    # Forward, brake to rest, off again, all around zero speed, on a slope with a bank.
    pedals = np.concatenate([steady(1.5, -2.0), steady(1.5, 1.5), steady(2.0, -8.0), steady(1.0, 0.0)])
    motion = drive_open_loop(
        Plane(0.3, right_friction_mu=0.5, cross_slope_ratio=0.06, grade_ratio=0.04),
        speed_mps=1.0,
        steer_rad=steady(6.0, steer_rad),
        accel_mps2=pedals,
        systems=ALL_SYSTEMS,
    )
    assert np.isfinite(motion.wheel_force_x_n).all()
    assert np.isfinite(motion.wheel_force_y_n).all()
    assert np.hypot(motion.velocity_x_mps, motion.velocity_y_mps).max() < 5.0
    assert np.abs(motion.accel_y_mps2).max() < 5.0


@pytest.mark.parametrize(("cross_slope_ratio", "grade_ratio"), [(0.08, 0.0), (-0.08, 0.0), (0.05, 0.06)])
def test_on_a_bank_the_wheels_bear_the_centripetal_force_too(cross_slope_ratio, grade_ratio):
    plane = Plane(0.9, cross_slope_ratio=cross_slope_ratio, grade_ratio=grade_ratio)
    motion = drive_open_loop(plane, speed_mps=15.0, steer_rad=steady(3.0, 0.03), accel_mps2=steady(3.0, -1.0))
    # What the surface bears against gravity and against the centripetal part normal to it.
    normal = GRAVITY_MPS2 / math.sqrt(1.0 + cross_slope_ratio**2 + grade_ratio**2)
    normal -= motion.yaw_rate_radps * motion.velocity_x_mps * cross_slope_ratio
    np.testing.assert_allclose(motion.wheel_load_n.sum(1)[50:], XC90.mass_kg * normal[50:], rtol=1e-3)

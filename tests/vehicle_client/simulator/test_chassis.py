import numpy as np
import pytest

from roadgrip.units import GRAVITY_MPS2
from tests.vehicle_client.simulator.rig import Rig
from vehicle_client.simulator import lanes
from vehicle_client.simulator.driver import understeer_gradient_s2pm
from vehicle_client.simulator.vehicle import XC90

pytestmark = pytest.mark.sim


@pytest.mark.parametrize("speed_mps", [10.0, 20.0, 30.0])
def test_a_gentle_steady_circle_has_the_linear_understeer(speed_mps):
    steer = 0.2 * XC90.wheelbase_m / speed_mps**2  # some 0.2 m/s2
    rig = Rig(speed_mps=speed_mps)
    yaw = rig.run(6.0, steer_rad=steer, hold_speed_mps=speed_mps)[-1, 1]
    speed = rig.of_body(lanes.VELOCITY_X)
    expected = speed * steer / (XC90.wheelbase_m + understeer_gradient_s2pm(XC90) * speed**2)
    assert yaw == pytest.approx(expected, rel=0.025)  # drive force and air drag are not in it


def load_sensitive_limit_mps2(mu):
    """Return the lateral acceleration at which the first axle has no more to give, its tyres at the loads they bear."""
    car, tyre = XC90, XC90.tyre
    arm = car.cog_height_m - (car.front_roll_centre_m * car.rear_axle_m + car.rear_roll_centre_m * car.front_axle_m) / (
        car.wheelbase_m
    )
    accel = np.linspace(0.0, 1.2 * mu * GRAVITY_MPS2, 2001)
    roll = car.mass_kg * arm * accel / (car.roll_stiffness_nmprad - car.mass_kg * GRAVITY_MPS2 * arm)
    limits = []
    for share, lever, centre, track in (
        (car.front_roll_stiffness_frac, car.rear_axle_m, car.front_roll_centre_m, car.front_track_m),
        (1.0 - car.front_roll_stiffness_frac, car.front_axle_m, car.rear_roll_centre_m, car.rear_track_m),
    ):
        mass = car.mass_kg * lever / car.wheelbase_m
        shift = (share * car.roll_stiffness_nmprad * roll + mass * accel * centre) / track
        load = 0.5 * mass * GRAVITY_MPS2 + np.array([-1.0, 1.0])[:, None] * shift
        degression = 1.0 + (tyre.peak_y2_ratio / tyre.peak_y1_ratio - 1.0) * (load / tyre.nominal_load_n - 1.0)
        limits.append(accel[np.argmax((mu * load * degression).sum(0) < mass * accel)])
    return min(limits)


@pytest.mark.parametrize("mu", [0.1, 0.2, 0.35, 0.6, 0.8, 1.0])
def test_the_car_corners_with_what_its_loaded_tyres_give(mu):
    rig = Rig(speed_mps=30.0, mu=mu)
    history = rig.run(9.0, steer_rate_radps=0.04 * mu)
    best = np.convolve(history[:, 0], np.full(100, 0.01), mode="valid").max()
    assert best == pytest.approx(load_sensitive_limit_mps2(mu), rel=0.01)
    assert 0.9 * mu * GRAVITY_MPS2 < best < 1.01 * mu * GRAVITY_MPS2


@pytest.mark.parametrize("mu", [0.15, 0.3, 0.6])
def test_the_best_braking_is_nearly_what_friction_gives(mu):
    best = 0.0
    for brake_nm in np.linspace(0.7, 1.1, 9) * mu * XC90.mass_kg * GRAVITY_MPS2 / 4.0 * XC90.tyre.rolling_radius_m:
        rig = Rig(speed_mps=25.0, mu=mu)
        rig.run(0.6, brake_nm=brake_nm)
        before = rig.of_body(lanes.VELOCITY_X)
        rig.run(0.4, brake_nm=brake_nm)
        best = max(best, (before - rig.of_body(lanes.VELOCITY_X)) / 0.4)
    # Equal torques cannot use both axles' grip fully, since braking moves load to the front.
    assert 0.80 * mu * GRAVITY_MPS2 < best < 1.06 * mu * GRAVITY_MPS2


def test_a_parked_car_stays_parked_on_a_banked_slope():
    rig = Rig(speed_mps=0.0, cross_slope_ratio=-0.08, grade_ratio=0.05)
    rig.run(12.0, brake_nm=2_000.0)
    assert (
        np.abs([rig.of_body(lanes.VELOCITY_X), rig.of_body(lanes.VELOCITY_Y), rig.of_body(lanes.YAW_RATE)]).max() < 1e-3
    )
    # The accelerometer sees gravity's components: uphill forward, and towards the right of a car banked to the left.
    assert rig.of_body(lanes.FORCE_X) == pytest.approx(0.05 * GRAVITY_MPS2, rel=0.02)
    assert rig.of_body(lanes.FORCE_Y) == pytest.approx(-0.08 * GRAVITY_MPS2, rel=0.02)


def test_crawling_in_a_tight_circle_is_calm():
    rig = Rig(speed_mps=1.0)
    history = rig.run(6.0, steer_rad=0.4, hold_speed_mps=1.0)
    assert np.ptp(history[-500:, 1]) < 1e-4


def test_a_car_that_rolls_free_loses_what_air_and_tyres_take():
    rig = Rig(speed_mps=30.0)
    rig.run(1.0)
    start = rig.of_body(lanes.VELOCITY_X)
    rig.run(10.0)
    mean = 0.5 * (start + rig.of_body(lanes.VELOCITY_X))
    inertia = XC90.mass_kg + 4.0 * XC90.wheel_inertia_kgm2 / XC90.tyre.rolling_radius_m**2
    lost = XC90.drag_npm2ps2_ratio * mean**2 + XC90.tyre.rolling_resistance_ratio * XC90.mass_kg * GRAVITY_MPS2
    assert (start - rig.of_body(lanes.VELOCITY_X)) / 10.0 == pytest.approx(lost / inertia, rel=0.01)


def test_a_turning_car_gains_no_energy_from_turning():
    rig = Rig(speed_mps=25.0, mu=0.9)
    history = rig.run(8.0, steer_rad=0.03)
    assert (np.diff(history[500:, 2]) < 0.0).all()


def test_wheel_loads_carry_the_car():
    rig = Rig(speed_mps=20.0)
    rig.run(5.0, steer_rad=0.03, hold_speed_mps=20.0)
    load = rig.of_wheels(lanes.LOAD)
    assert load.sum() == pytest.approx(XC90.mass_kg * GRAVITY_MPS2, rel=1e-6)
    # A left turn loads the right wheels; the moments about the ground line balance.
    shift = (load[1] - load[0]) * XC90.front_track_m / 2 + (load[3] - load[2]) * XC90.rear_track_m / 2
    arm = XC90.cog_height_m - (0.08 * XC90.rear_axle_m + 0.12 * XC90.front_axle_m) / XC90.wheelbase_m
    lean = XC90.mass_kg * GRAVITY_MPS2 * arm * rig.of_body(lanes.ROLL)
    assert shift == pytest.approx(XC90.mass_kg * rig.of_body(lanes.FORCE_Y) * XC90.cog_height_m + lean, rel=0.01)
    assert rig.of_body(lanes.ROLL) > 0.0


def test_the_body_leans_as_its_springs_say():
    rig = Rig(speed_mps=20.0)
    rig.run(4.0, steer_rad=0.02, hold_speed_mps=20.0)
    arm = XC90.cog_height_m - (0.08 * XC90.rear_axle_m + 0.12 * XC90.front_axle_m) / XC90.wheelbase_m
    spring = XC90.roll_stiffness_nmprad - XC90.mass_kg * GRAVITY_MPS2 * arm
    assert rig.of_body(lanes.ROLL) == pytest.approx(XC90.mass_kg * arm * rig.of_body(lanes.FORCE_Y) / spring, rel=0.01)


def linear_single_track(*, speed_mps, steer_rad, seconds, step_s=0.002):
    """Return the yaw rate of the textbook model after a step of the steering.

    Tyres with relaxation length; a steering that gives way to the lateral force of its axle.
    """
    a, b = XC90.front_axle_m, XC90.rear_axle_m
    stiffness, length = [], []
    for lever in (b, a):
        load = 0.5 * XC90.mass_kg * GRAVITY_MPS2 * lever / XC90.wheelbase_m
        u = load / XC90.tyre.nominal_load_n - 1.0
        slope = load * (XC90.tyre.slope_y1_ratio + (XC90.tyre.slope_y2_ratio - XC90.tyre.slope_y1_ratio) * u)
        stiffness.append(2.0 * slope)
        length.append(slope / XC90.tyre.stiffness_y_npm)
    vy = yaw = front = rear = yielded = 0.0
    history = []
    for _ in range(round(seconds / step_s)):
        yielded += (XC90.steer_compliance_radpn * front - yielded) * step_s / XC90.steer_compliance_lag_s
        front += (
            (stiffness[0] * (steer_rad - yielded - (vy + a * yaw) / speed_mps) - front) * step_s * speed_mps / length[0]
        )
        rear += (stiffness[1] * (b * yaw - vy) / speed_mps - rear) * step_s * speed_mps / length[1]
        vy += ((front + rear) / XC90.mass_kg - speed_mps * yaw) * step_s
        yaw += (a * front - b * rear) / XC90.yaw_inertia_kgm2 * step_s
        history.append(yaw)
    return np.array(history)


@pytest.mark.parametrize("speed_mps", [12.0, 25.0])
def test_a_small_step_of_the_steering_is_answered_as_by_the_linear_single_track_model(speed_mps):
    yaw = Rig(speed_mps=speed_mps).run(1.5, steer_rad=0.004, hold_speed_mps=speed_mps)[:, 1]
    expected = linear_single_track(speed_mps=speed_mps, steer_rad=0.004, seconds=1.5)
    assert np.abs(yaw - expected).max() < 0.06 * expected.max()


def test_bank_takes_over_a_part_of_cornering():
    flat, banked = Rig(speed_mps=20.0), Rig(speed_mps=20.0, cross_slope_ratio=-0.08)
    plain = flat.run(5.0, steer_rad=0.02, hold_speed_mps=20.0, on_circle=True)
    helped = banked.run(5.0, steer_rad=0.02, hold_speed_mps=20.0, on_circle=True)
    assert helped[-1, 1] > plain[-1, 1]
    # At the same yaw rate the accelerometer would see 0.08 g less; here: acceleration minus gravity's share.
    assert banked.of_body(lanes.FORCE_Y) == pytest.approx(helped[-1, 0] - 0.0797 * GRAVITY_MPS2, rel=0.01)


def test_left_and_right_are_mirror_images():
    left, right = Rig(speed_mps=22.0, mu=0.4), Rig(speed_mps=22.0, mu=0.4)
    a = left.run(3.0, steer_rate_radps=0.03, hold_speed_mps=22.0)
    b = right.run(3.0, steer_rate_radps=-0.03, hold_speed_mps=22.0)
    np.testing.assert_allclose(a * [1, 1, -1], b * [-1, -1, -1], rtol=0, atol=1e-9)


def test_half_the_step_changes_little():
    coarse, fine = Rig(mu=0.3, step_s=0.002), Rig(mu=0.3, step_s=0.001)
    a = coarse.run(4.0, steer_rate_radps=0.01, hold_speed_mps=20.0)
    b = fine.run(4.0, steer_rate_radps=0.01, hold_speed_mps=20.0)[1::2]
    assert np.abs(a - b).max() < 0.01


@pytest.mark.parametrize("angle_rad", [-0.4, 0.0, 0.4])
def test_gravity_pulls_down_the_slope_whichever_way_the_car_points(angle_rad):
    grade, cross = 0.05, 0.03
    rig = Rig(mu=1e-6, grade_ratio=grade, cross_slope_ratio=cross)
    rig.of_wheels(lanes.ANGLE)[:] = angle_rad
    rig.run(rig.step_s)
    fall = GRAVITY_MPS2 / np.sqrt(1.0 + grade**2 + cross**2)
    pulled_x = rig.of_body(lanes.ACCEL_X) - rig.of_body(lanes.FORCE_X)
    pulled_y = rig.of_body(lanes.ACCEL_Y) - rig.of_body(lanes.FORCE_Y)
    assert pulled_x == pytest.approx(-fall * (grade * np.cos(angle_rad) + cross * np.sin(angle_rad)), abs=1e-6)
    assert pulled_y == pytest.approx(-fall * (cross * np.cos(angle_rad) - grade * np.sin(angle_rad)), abs=1e-6)


@pytest.mark.parametrize("offset_m", [-2.0, 0.0, 2.0])
def test_on_the_inside_of_a_bend_the_road_passes_faster(offset_m):
    rig = Rig()
    rig.of_wheels(lanes.CURVATURE)[:] = 0.02
    rig.of_wheels(lanes.OFFSET)[:] = offset_m
    rig.run(rig.step_s)
    assert rig.of_body(lanes.PACE) == pytest.approx(20.0 / (1.0 - 0.02 * offset_m), rel=1e-4)
    assert rig.of_body(lanes.ANGLE) == pytest.approx(-0.02 * rig.of_body(lanes.PACE) * rig.step_s, rel=1e-3)


@pytest.mark.parametrize("wheel", [0, 1, 2, 3])
def test_a_bump_loads_the_wheel_that_stands_on_it_and_lifts_its_corner(wheel):
    flat, bumpy = Rig(), Rig()
    bumpy.of_wheels(lanes.ROAD_Z)[wheel] = 0.01
    for rig in (flat, bumpy):
        rig.run(rig.step_s)
    more = bumpy.of_wheels(lanes.LOAD) - flat.of_wheels(lanes.LOAD)
    assert more[wheel] == pytest.approx(0.01 * XC90.tyre.vertical_stiffness_npm, rel=0.01)
    np.testing.assert_allclose(np.delete(more, wheel), 0.0, atol=1e-9)
    for rig in (flat, bumpy):
        rig.run(3.0)
    assert bumpy.of_wheels(lanes.SPRUNG_Z)[wheel] == pytest.approx(0.01, rel=0.02)
    assert np.abs(bumpy.of_wheels(lanes.LOAD) - flat.of_wheels(lanes.LOAD)).max() < 10.0


def test_the_road_changes_by_its_steps():
    rig = Rig()
    rows = (
        (lanes.FRICTION, lanes.FRICTION_STEP),
        (lanes.CURVATURE, lanes.CURVATURE_STEP),
        (lanes.GRADE, lanes.GRADE_STEP),
        (lanes.CROSS_SLOPE, lanes.CROSS_SLOPE_STEP),
        (lanes.GRADE_CHANGE, lanes.GRADE_CHANGE_STEP),
        (lanes.CROSS_CHANGE, lanes.CROSS_CHANGE_STEP),
    )
    before = [rig.of_body(row) for row, _ in rows]
    for k, (_, step_row) in enumerate(rows):
        rig.of_wheels(step_row)[:] = 1e-5 * (k + 1)
    rig.run(5 * rig.step_s)
    for k, (row, _) in enumerate(rows):
        assert rig.of_body(row) == pytest.approx(before[k] + 5e-5 * (k + 1), abs=1e-12)

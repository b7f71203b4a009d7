"""Laws of the limit: what the loaded tyres give is what the car can do, cornering, braking and driving."""

import math

import numpy as np
import pytest

from roadgrip.units import GRAVITY_MPS2
from tests.vehicle_client.simulator import analytic
from vehicle_client.simulator.proving_ground import Plane, drive_open_loop
from vehicle_client.simulator.vehicle import XC90

pytestmark = pytest.mark.sim

FRICTIONS = pytest.mark.parametrize("mu", [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])


def best_mean(values, seconds):
    count = round(100 * seconds)
    return float(np.convolve(values, np.full(count, 1.0 / count), mode="valid").max())


def largest_lateral_force_mps2(mu, *, cross_slope_ratio=0.0, start_mps=30.0):
    """Return the largest lateral tyre force per mass, held for 0.2 s, as the steering is turned slowly left."""
    seconds = 9.0
    steer = np.linspace(0.0, 0.36 * mu, round(100 * seconds))
    plane = Plane(mu, cross_slope_ratio=cross_slope_ratio)
    motion = drive_open_loop(plane, speed_mps=start_mps, steer_rad=steer)
    uphill = GRAVITY_MPS2 * cross_slope_ratio / math.hypot(1.0, cross_slope_ratio)
    return best_mean(motion.accel_y_mps2 + uphill, 0.2)


def largest_longitudinal_force_mps2(mu, *, braking, grade_ratio=0.0):
    """Return the largest sum of longitudinal tyre forces per mass while the pedal goes down slowly.

    Brakes or drive are shared such that all tyres reach their peak together, and as strong as they need to be.
    """
    speed_mps = 20.0
    limit = analytic.longitudinal_limit(mu, braking=braking, speed_mps=speed_mps, grade_ratio=grade_ratio)
    car = XC90._replace(
        front_brake_frac=limit.front_frac,
        front_drive_frac=limit.front_frac,
        drag_npm2ps2_ratio=0.0,
        power_w=1e7,
        brake_limit_mps2=30.0,
    )
    limit = analytic.longitudinal_limit(mu, braking=braking, car=car, grade_ratio=grade_ratio)
    force = np.linspace(0.5, 1.1, 600) * limit.force_mps2
    # The pedals allow for the grade: less that, the tyres' force is what is asked for.
    pedals = (-force if braking else force) - GRAVITY_MPS2 * grade_ratio
    motion = drive_open_loop(
        Plane(mu, grade_ratio=grade_ratio),
        speed_mps=3.0 * speed_mps if braking else speed_mps,
        steer_rad=np.zeros(600),
        accel_mps2=pedals,
        vehicle=car,
    )
    seen = motion.wheel_force_x_n.sum(1) / car.mass_kg
    return best_mean(-seen if braking else seen, 0.1), limit.force_mps2


@FRICTIONS
def test_the_car_corners_with_what_its_loaded_tyres_give(mu):
    assert largest_lateral_force_mps2(mu) == pytest.approx(analytic.lateral_limit_mps2(mu), rel=0.01)


@FRICTIONS
@pytest.mark.parametrize("braking", [True, False])
def test_the_car_brakes_and_accelerates_with_what_its_loaded_tyres_give(mu, braking):
    seen, expected = largest_longitudinal_force_mps2(mu, braking=braking)
    assert seen == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("mu", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("braking", [True, False])
@pytest.mark.parametrize("grade_ratio", [-0.08, 0.08])
def test_on_a_grade_the_car_brakes_and_accelerates_with_what_its_loaded_tyres_give(mu, braking, grade_ratio):
    seen, expected = largest_longitudinal_force_mps2(mu, braking=braking, grade_ratio=grade_ratio)
    assert seen == pytest.approx(expected, rel=0.02)


def test_the_lateral_limit_does_not_depend_on_speed():
    assert largest_lateral_force_mps2(0.5, start_mps=40.0) == pytest.approx(largest_lateral_force_mps2(0.5), rel=5e-3)


def test_less_than_mu_g_is_left_of_cornering_and_the_more_is_missing_the_more_load_is_moved():
    share = [analytic.lateral_limit_mps2(mu) / (mu * GRAVITY_MPS2) for mu in (0.1, 0.4, 0.7, 1.0)]
    assert (np.diff(share) < 0.0).all()
    assert 0.90 < share[-1] < share[0] < 1.0


@pytest.mark.parametrize("mu", [0.2, 0.6, 1.0])
def test_a_lighter_higher_or_narrower_car_follows_its_own_limit(mu):
    car = XC90._replace(cog_height_m=0.9, front_roll_stiffness_frac=0.7)
    steer = np.linspace(0.0, 0.36 * mu, 900)
    motion = drive_open_loop(Plane(mu), speed_mps=30.0, steer_rad=steer, vehicle=car)
    assert best_mean(motion.accel_y_mps2, 0.2) == pytest.approx(analytic.lateral_limit_mps2(mu, car=car), rel=0.02)


@FRICTIONS
@pytest.mark.parametrize("cross_slope_ratio", [-0.08, 0.08])
def test_on_a_bank_the_car_corners_with_what_its_loaded_tyres_give(mu, cross_slope_ratio):
    expected = analytic.lateral_limit_mps2(mu, cross_slope_ratio=cross_slope_ratio)
    assert largest_lateral_force_mps2(mu, cross_slope_ratio=cross_slope_ratio) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("mu", [0.1, 0.4, 0.9])
def test_spinning_wheels_take_no_more_power_than_the_engine_has(mu):
    motion = drive_open_loop(Plane(mu), speed_mps=8.0, steer_rad=np.zeros(600), accel_mps2=np.full(600, 8.0))
    # What the wheels give to the road and lose in it, and what their spin stores.
    spin = motion.wheel_speed_radps
    given = (
        motion.wheel_force_x_n + XC90.tyre.rolling_resistance_ratio * motion.wheel_load_n
    ) * XC90.tyre.rolling_radius_m
    stored = XC90.wheel_inertia_kgm2 * np.gradient(spin, motion.time_s, axis=0)
    power = ((given + stored) * spin).sum(1)[50:-5]
    assert power.max() < 1.02 * XC90.power_w
    assert power.mean() > 0.9 * XC90.power_w

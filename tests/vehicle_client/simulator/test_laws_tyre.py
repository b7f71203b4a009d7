"""Laws of the tyre: the published curve, what friction means, and how force builds up."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.vehicle_client.simulator import analytic
from vehicle_client.simulator.proving_ground import Plane, drive_open_loop
from vehicle_client.simulator.tyre import steady_force_n
from vehicle_client.simulator.vehicle import XC90, Tyre

pytestmark = pytest.mark.sim

TYRE = Tyre()
NOMINAL_N = TYRE.nominal_load_n

# Passenger-car estimate of Project Chrono, ChTMeasyTire::GuessPassCar70Par: at the nominal load N and at 2 N
# slope, peak, slip of the peak, sliding force, slip of entire sliding; forces over the load that they belong to.
PUBLISHED = {
    (0, 1.0): (18.6758, 1.1205, 0.17, 0.8766, 0.90),
    (0, 2.0): (20.1757, 1.072, 0.15, 0.8245, 0.95),
    (1, 1.0): (14.9858, 1.0084, 0.18197, 0.83941, 0.82534),
    (1, 2.0): (10.0505, 0.90003, 0.24472, 0.76782, 0.91309),
}
PUBLISHED_PEAK = {0: 1.1205, 1: 1.0084}
CASES = pytest.mark.parametrize(("axis", "loads"), list(PUBLISHED))
AXES = pytest.mark.parametrize("axis", [0, 1])

FRICTIONS = st.floats(0.05, 1.2)
LOADS = st.floats(100.0, 18_000.0)
SLIPS = st.floats(-2.5, 2.5)


def pure_force_n(slip, *, axis, load_n=NOMINAL_N, mu=1.0):
    slip_x, slip_y = (slip, 0.0) if axis == 0 else (0.0, slip)
    return steady_force_n(slip_x, slip_y, load_n, mu, TYRE)[axis]


def searched_peak_n(*, axis, load_n, mu):
    """Return the largest force over slip, found by looking for it: a coarse grid, then finer ones around its best."""
    low, high = 0.0, 2.0
    for _ in range(4):
        slips = np.linspace(low, high, 201)
        forces = [pure_force_n(s, axis=axis, load_n=load_n, mu=mu) for s in slips]
        best = int(np.argmax(forces))
        low, high = slips[max(0, best - 1)], slips[min(200, best + 1)]
    return max(forces)


@CASES
def test_the_slope_at_no_slip_is_the_published_one(axis, loads):
    slope = pure_force_n(1e-7, axis=axis, load_n=loads * NOMINAL_N, mu=PUBLISHED_PEAK[axis]) / 1e-7
    assert slope == pytest.approx(PUBLISHED[axis, loads][0] * loads * NOMINAL_N, rel=1e-5)


@CASES
def test_the_slope_at_no_slip_does_not_depend_on_friction(axis, loads):
    slopes = [pure_force_n(1e-7, axis=axis, load_n=loads * NOMINAL_N, mu=mu) / 1e-7 for mu in (0.1, 1.0)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-4)


@CASES
def test_the_peak_lies_at_the_published_slip_and_force(axis, loads):
    _, peak, slip, _, _ = PUBLISHED[axis, loads]
    load = loads * NOMINAL_N
    assert pure_force_n(slip, axis=axis, load_n=load, mu=PUBLISHED_PEAK[axis]) == pytest.approx(peak * load, rel=1e-9)
    assert searched_peak_n(axis=axis, load_n=load, mu=PUBLISHED_PEAK[axis]) == pytest.approx(peak * load, rel=1e-9)


@CASES
@pytest.mark.parametrize("further", [1.0, 1.3, 2.0])
def test_from_the_published_slip_on_the_tyre_slides_with_the_published_force(axis, loads, further):
    _, _, _, slide, slip = PUBLISHED[axis, loads]
    load = loads * NOMINAL_N
    force = pure_force_n(further * slip, axis=axis, load_n=load, mu=PUBLISHED_PEAK[axis])
    assert force == pytest.approx(slide * load, rel=1e-9)


@AXES
@pytest.mark.parametrize("mu", [0.1, 0.2, 0.35, 0.6, 1.0])
def test_friction_is_the_largest_force_over_the_nominal_load(axis, mu):
    assert searched_peak_n(axis=axis, load_n=NOMINAL_N, mu=mu) == pytest.approx(mu * NOMINAL_N, rel=1e-9)


@AXES
@pytest.mark.parametrize("load_n", [800.0, 3_000.0, 8_000.0, 12_000.0])
def test_at_other_loads_the_largest_force_follows_the_degression_of_the_axis(axis, load_n):
    expected = analytic.peak_force_n(np.array(load_n), mu=0.5, axis=axis, tyre=TYRE)
    assert searched_peak_n(axis=axis, load_n=load_n, mu=0.5) == pytest.approx(float(expected), rel=1e-9)


@given(sx=SLIPS, sy=SLIPS, mu=FRICTIONS)
def test_at_the_nominal_load_no_slip_gives_more_than_friction_times_load(sx, sy, mu):
    assert math.hypot(*steady_force_n(sx, sy, NOMINAL_N, mu, TYRE)) <= mu * NOMINAL_N * (1.0 + 1e-9)


@given(sx=SLIPS, sy=SLIPS, mu=FRICTIONS, load_n=LOADS)
def test_at_any_load_no_slip_gives_more_than_the_degression_leaves(sx, sy, mu, load_n):
    most = max(float(analytic.peak_force_n(np.array(load_n), mu=mu, axis=axis, tyre=TYRE)) for axis in (0, 1))
    assert math.hypot(*steady_force_n(sx, sy, load_n, mu, TYRE)) <= most * (1.0 + 1e-9)


@given(sx=SLIPS, sy=SLIPS, mu=FRICTIONS, load_n=LOADS)
def test_force_opposes_slip(sx, sy, mu, load_n):
    # Slips are signed such that force points along them: the power that the patch takes is never negative.
    fx, fy = steady_force_n(sx, sy, load_n, mu, TYRE)
    assert fx * sx >= 0.0
    assert fy * sy >= 0.0


@given(sx=SLIPS, sy=SLIPS, mu=FRICTIONS, load_n=LOADS)
def test_force_is_odd_in_either_slip(sx, sy, mu, load_n):
    fx, fy = steady_force_n(sx, sy, load_n, mu, TYRE)
    assert steady_force_n(-sx, sy, load_n, mu, TYRE) == (-fx, fy)
    assert steady_force_n(sx, -sy, load_n, mu, TYRE) == (fx, -fy)


@given(slip=st.floats(1e-4, 2.5), mu=FRICTIONS, load_n=LOADS, axis=st.integers(0, 1))
def test_pure_slip_is_self_similar_in_friction(slip, mu, load_n, axis):
    alike = mu * pure_force_n(slip / mu, axis=axis, load_n=load_n, mu=1.0)
    assert pure_force_n(slip, axis=axis, load_n=load_n, mu=mu) == pytest.approx(alike, rel=1e-9)


@given(angle=st.floats(0.0, 0.5 * math.pi), mu=FRICTIONS, load_n=st.floats(1_000.0, 12_000.0))
def test_along_any_direction_of_slip_force_rises_to_one_peak_and_then_never_again(angle, mu, load_n):
    size = mu * np.linspace(0.0, 2.0, 201)
    force = np.array(
        [math.hypot(*steady_force_n(s * math.cos(angle), s * math.sin(angle), load_n, mu, TYRE)) for s in size]
    )
    peak = int(force.argmax())
    assert (np.diff(force[: peak + 1]) > 0.0).all()
    assert (np.diff(force[peak:]) <= 1e-9 * force[peak]).all()


@given(angle=st.floats(0.0, 0.5 * math.pi), mu=FRICTIONS, load_n=st.floats(1_000.0, 12_000.0))
def test_force_has_no_jump_and_no_kink_along_slip(angle, mu, load_n):
    size = mu * np.linspace(0.0, 1.5, 601)
    force = np.array([steady_force_n(s * math.cos(angle), s * math.sin(angle), load_n, mu, TYRE) for s in size])
    force /= mu * load_n
    # Steepest is the origin; the change of slope per step is that of smooth branches, also where they join.
    step = size[1] / mu
    slope = np.diff(force, axis=0) / step
    assert np.abs(slope).max() < 22.0
    assert np.abs(np.diff(slope, axis=0)).max() < 0.12 * np.abs(slope).max()


@given(mu=FRICTIONS, load_n=LOADS, sy=st.floats(0.01, 0.5))
def test_braking_takes_from_cornering(mu, load_n, sy):
    alone = steady_force_n(0.0, sy, load_n, mu, TYRE)[1]
    locked = steady_force_n(-2.0, sy, load_n, mu, TYRE)[1]
    assert locked < 0.6 * alone


def relaxation_m(speed_mps):
    """Return the length over which the front axle's force follows its slip angle, fitted to a step of the steering.

    Between samples the slip is a straight line, so the sampled first-order law is exact with both its ends.
    """
    steer = np.concatenate([np.zeros(3), np.full(60, 0.004)])
    rigid = XC90._replace(steer_compliance_radpn=0.0)
    motion = drive_open_loop(Plane(4.0), speed_mps=speed_mps, steer_rad=steer, step_s=0.0005, vehicle=rigid)
    angle = steer - (motion.velocity_y_mps + XC90.front_axle_m * motion.yaw_rate_radps) / motion.velocity_x_mps
    force = motion.wheel_force_y_n[:, :2].sum(1)
    rows = np.column_stack([force[4:-1], angle[4:-1], angle[5:]])
    keep = np.linalg.lstsq(rows / rows.max(0), force[5:], rcond=None)[0][0] / rows[:, 0].max()
    return -speed_mps * 0.01 / math.log(keep)


@pytest.mark.parametrize("speed_mps", [8.0, 15.0, 30.0])
def test_lateral_force_builds_up_over_the_relaxation_length_at_any_speed(speed_mps):
    load = 0.5 * XC90.mass_kg * 9.80665 * XC90.rear_axle_m / XC90.wheelbase_m
    length = analytic.cornering_stiffness_n(load, TYRE) / TYRE.stiffness_y_npm
    # What the damping of the carcass adds is a time, not a length.
    delay_m = speed_mps * TYRE.damping_y_nspm / TYRE.stiffness_y_npm
    assert relaxation_m(speed_mps) - delay_m == pytest.approx(length, rel=0.04)

"""The tyre curve read backwards: against the published formula, the simulator's tyre, and laws for any load."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.vehicle_client.estimation.grip.two_axles import stiffness_n
from vehicle_client.estimation.grip.axle import FULL_USE_RATIO, axle_slip, wheel_curve
from vehicle_client.estimation.handling import XC90_HANDLING

TYRE = XC90_HANDLING.tyre
FRICTIONS_MU = np.array([[0.12], [0.3], [0.6], [1.0]])
LOADS_N = st.floats(500.0, 12_000.0)
FORCES_N = st.floats(-60_000.0, 60_000.0)


def slip_of(lateral_n, along_n=0.0, *, loads_n=(4600.0, 5600.0), friction_mu=FRICTIONS_MU, tyre=TYRE):
    """Return what an axle with two loads needs, at each friction."""
    lateral, along = (np.atleast_1d(np.asarray(force, dtype=np.float64)) for force in (lateral_n, along_n))
    lateral, along = np.broadcast_arrays(lateral, along)
    wheels = tuple(wheel_curve(np.full(lateral.shape, load_n), tyre) for load_n in loads_n)
    return axle_slip(friction_mu, lateral, along, (wheels[0], wheels[1]))


def axle_n(angle_rad, *, loads_n, friction_mu):
    """Return the lateral force of two wheels that roll freely, by the published formula."""
    return sum(
        angle_rad * stiffness_n(np.abs(angle_rad), load_n=np.array(load_n), friction_mu=friction_mu, tyre=TYRE)
        for load_n in loads_n
    )


@pytest.mark.parametrize("loads_n", [(5199.0, 5199.0), (4200.0, 6200.0), (2600.0, 7800.0)])
def test_the_angle_that_is_told_gives_the_force_that_was_asked_for(loads_n):
    angle = np.linspace(0.002, 0.16, 60)
    for friction_mu in (0.15, 0.4, 0.9):
        steep = angle[angle < 0.85 * friction_mu * 0.18]
        force = axle_n(steep, loads_n=loads_n, friction_mu=np.array(friction_mu))
        told = slip_of(force, loads_n=loads_n, friction_mu=np.array([[friction_mu]])).angle_rad[0]
        assert told == pytest.approx(steep, rel=0.03)


def test_on_equal_loads_the_reading_is_exact():
    angle = np.linspace(0.005, 0.085, 40)
    force = axle_n(angle, loads_n=(5000.0, 5000.0), friction_mu=np.array(0.6))
    # A newton is added lest nothing be divided by nothing.
    told = slip_of(force, loads_n=(5000.0, 5000.0), friction_mu=np.array([[0.6]])).angle_rad[0]
    assert told == pytest.approx(angle, rel=2e-3)


@given(lateral_n=FORCES_N, along_n=FORCES_N, left_n=LOADS_N, right_n=LOADS_N, friction_mu=st.floats(0.05, 1.5))
def test_whatever_is_asked_the_answer_is_a_number(lateral_n, along_n, left_n, right_n, friction_mu):
    slip = slip_of(lateral_n, along_n, loads_n=(left_n, right_n), friction_mu=np.array([[friction_mu]]))
    for told in (slip.angle_rad, slip.along_per_force_1pn, slip.angle_per_force_radpn, slip.use_ratio):
        assert np.isfinite(told).all()
    assert (slip.use_ratio > 0.0).all()
    assert (slip.along_per_force_1pn > 0.0).all()
    assert (slip.angle_per_force_radpn >= 0.0).all()
    assert np.abs(slip.angle_rad).max() < friction_mu


@given(load_n=st.floats(1.0, 60_000.0))
def test_no_load_turns_a_curve_over(load_n):
    curve = wheel_curve(np.array([load_n]), TYRE)
    assert min(curve.stiffness_n[0], curve.peak_n[0], curve.peak_slip_ratio[0], curve.along_ratio[0]) > 0.0


@given(lateral_n=FORCES_N, along_n=FORCES_N)
def test_left_and_right_are_alike(lateral_n, along_n):
    left = slip_of(lateral_n, along_n, loads_n=(4000.0, 6000.0))
    right = slip_of(-lateral_n, along_n, loads_n=(6000.0, 4000.0))
    assert left.angle_rad == pytest.approx(-right.angle_rad, rel=1e-9, abs=1e-15)
    assert left.angle_per_force_radpn == pytest.approx(right.angle_per_force_radpn, rel=1e-9)
    assert left.along_per_force_1pn == pytest.approx(right.along_per_force_1pn, rel=1e-9)


@given(use_ratio=st.floats(0.1, 0.9), along=st.floats(0.0, 1.0))
def test_the_curve_is_its_own_image_at_every_friction(use_ratio, along):
    # Force and slip go with friction: what friction 1 needs for ten times the force is ten times as much.
    full_n = 10_000.0 * use_ratio
    lateral, pushed = full_n * np.sqrt(1.0 - along**2), full_n * along
    once = slip_of(lateral, pushed, friction_mu=np.array([[1.0]]))
    for friction_mu in (0.1, 0.35):
        there = slip_of(friction_mu * lateral, friction_mu * pushed, friction_mu=np.array([[friction_mu]]))
        assert there.use_ratio == pytest.approx(once.use_ratio, rel=0.02)
        # The newton that keeps divisions from nothing weighs more where forces are small.
        assert there.angle_rad / friction_mu == pytest.approx(once.angle_rad, rel=0.03, abs=2e-4)


@given(lateral_n=st.floats(50.0, 9000.0), along_n=st.floats(-2000.0, 2000.0))
def test_the_less_friction_the_more_slip(lateral_n, along_n):
    frictions_mu = np.linspace(0.1, 1.2, 40)[:, None]
    slip = slip_of(lateral_n, along_n, friction_mu=frictions_mu)
    within = slip.use_ratio[:, 0] < 0.9 * FULL_USE_RATIO
    angle = slip.angle_rad[within, 0]
    assert (np.diff(angle) <= 1e-12).all()
    assert (np.diff(slip.along_per_force_1pn[within, 0]) <= 1e-15).all()


def test_the_more_force_the_more_slip_and_the_rate_is_its_derivative():
    force = np.linspace(100.0, 5000.0, 400)
    slip = slip_of(force, 500.0)
    for told, rate, use in zip(slip.angle_rad, slip.angle_per_force_radpn, slip.use_ratio, strict=True):
        within = use < 0.8
        assert (np.diff(told[within]) > 0.0).all()
        if within.sum() > 10:
            assert rate[within][1:-1] == pytest.approx(np.gradient(told[within], force[within])[1:-1], rel=0.1)


def test_what_is_pushed_takes_grip_from_what_is_steered():
    free, pushed = slip_of(3000.0), slip_of(3000.0, 2500.0)
    assert (pushed.use_ratio > free.use_ratio).all()
    within = pushed.use_ratio < 0.9
    assert within.sum() == 2
    assert (pushed.angle_rad > free.angle_rad)[within].all()


def test_more_than_the_peak_is_told_as_its_slip_and_as_use_beyond_one():
    slip = slip_of([5_000.0, 50_000.0])
    assert slip.use_ratio[0, 1] == pytest.approx(10.0 * slip.use_ratio[0, 0], rel=1e-3)
    assert slip.use_ratio[0, 0] > 1.0
    assert slip.angle_rad[0, 0] == pytest.approx(slip.angle_rad[0, 1], rel=0.2)


def test_a_stiffer_tyre_needs_less_slip():
    stiffer = replace(TYRE, stiffness_ratio=1.2 * TYRE.stiffness_ratio, stiffness_twice_ratio=1.2 * 10.05)
    assert (slip_of(1000.0, tyre=stiffer).angle_rad < slip_of(1000.0).angle_rad).all()


@pytest.mark.sim
@pytest.mark.parametrize("load_n", [3500.0, 5199.0, 7500.0])
@pytest.mark.parametrize("friction_mu", [0.2, 0.5, 0.9])
@pytest.mark.parametrize("along_share", [0.0, 0.3])
def test_the_simulators_tyre_is_read_backwards(load_n, friction_mu, along_share):
    from vehicle_client.simulator.tyre import steady_force_n
    from vehicle_client.simulator.variation import handling_of
    from vehicle_client.simulator.vehicle import XC90

    tyre = handling_of(XC90).tyre
    for angle_rad in np.array([0.15, 0.4, 0.6]) * friction_mu * 0.18:
        along_n, lateral_n = steady_force_n(along_share * angle_rad, angle_rad, load_n, friction_mu, XC90.tyre)
        told = slip_of(
            2.0 * lateral_n, 2.0 * along_n, loads_n=(load_n, load_n), friction_mu=np.array([[friction_mu]]), tyre=tyre
        )
        # With a push the simulator's two axes have peaks of their own; the inverse has one for both.
        assert told.angle_rad[0, 0] == pytest.approx(angle_rad, rel=0.01 if along_share == 0.0 else 0.05)
        assert told.along_per_force_1pn[0, 0] * 2.0 * along_n == pytest.approx(along_share * angle_rad, rel=0.12)

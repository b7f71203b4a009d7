import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_client.simulator.tyre import built_up_force_n, slip_slope, steady_force_n
from vehicle_client.simulator.vehicle import Tyre

pytestmark = pytest.mark.sim

TYRE = Tyre()
NOMINAL_N = TYRE.nominal_load_n
FRICTIONS = st.floats(0.05, 1.2)
LOADS = st.floats(200.0, 15_000.0)


def curve(axis, mu, load_n=NOMINAL_N, upto=1.5):
    slips = np.linspace(0.0, upto, 3001)
    pairs = [(s, 0.0) if axis == 0 else (0.0, s) for s in slips]
    return slips, np.array([steady_force_n(sx, sy, load_n, mu, TYRE)[axis] for sx, sy in pairs])


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("mu", [0.1, 0.35, 0.7, 1.0])
def test_friction_is_peak_force_over_nominal_load(axis, mu):
    _, force = curve(axis, mu)
    assert force.max() == pytest.approx(mu * NOMINAL_N, rel=1e-4)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_published_points_come_back_at_the_scale_of_their_own_peak(axis):
    # With mu equal to the published peak over load the curve is the published one.
    peak, slip, slide, slide_slip, slope = (
        (
            TYRE.peak_x1_ratio,
            TYRE.peak_slip_x1_ratio,
            TYRE.slide_x1_ratio,
            TYRE.slide_slip_x1_ratio,
            TYRE.slope_x1_ratio,
        )
        if axis == 0
        else (
            TYRE.peak_y1_ratio,
            TYRE.peak_slip_y1_ratio,
            TYRE.slide_y1_ratio,
            TYRE.slide_slip_y1_ratio,
            TYRE.slope_y1_ratio,
        )
    )

    def force_at(s):
        return steady_force_n(s if axis == 0 else 0.0, s if axis == 1 else 0.0, NOMINAL_N, peak, TYRE)[axis]

    assert force_at(slip) == pytest.approx(peak * NOMINAL_N, rel=1e-9)
    assert force_at(slide_slip) == pytest.approx(slide * NOMINAL_N, rel=1e-9)
    assert force_at(1e-7) / 1e-7 == pytest.approx(slope * NOMINAL_N, rel=1e-4)


@given(slip=st.floats(1e-4, 2.0), mu=FRICTIONS, load=LOADS, axis=st.integers(0, 1))
def test_pure_slip_is_self_similar_in_friction(slip, mu, load, axis):
    def pure(s, m):
        return steady_force_n(s if axis == 0 else 0.0, s if axis == 1 else 0.0, load, m, TYRE)[axis]

    assert pure(slip, mu) == pytest.approx(mu * pure(slip / mu, 1.0), rel=1e-9)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("load", [1_500.0, 5_199.0, 9_000.0])
def test_force_rises_until_the_peak_and_never_after(axis, load):
    _, force = curve(axis, 0.5, load)
    peak = int(force.argmax())
    assert (np.diff(force[: peak + 1]) > 0.0).all()
    assert (np.diff(force[peak:]) <= 1e-9).all()


@given(sx=st.floats(-2.0, 2.0), sy=st.floats(-2.0, 2.0), mu=FRICTIONS, load=LOADS)
def test_no_direction_gives_more_than_the_better_axis(sx, sy, mu, load):
    force = np.hypot(*steady_force_n(sx, sy, load, mu, TYRE))
    best = max(curve_peak(axis, mu, load) for axis in (0, 1))
    assert force <= best * (1.0 + 1e-9)


def curve_peak(axis, mu, load):
    u = min(load / NOMINAL_N, 3.5) - 1.0
    one, two = (TYRE.peak_x1_ratio, TYRE.peak_x2_ratio) if axis == 0 else (TYRE.peak_y1_ratio, TYRE.peak_y2_ratio)
    return mu / one * min(load, 3.5 * NOMINAL_N) * (one + (two - one) * u)


@given(sx=st.floats(-2.0, 2.0), sy=st.floats(-2.0, 2.0), mu=FRICTIONS, load=LOADS)
def test_force_is_odd_in_either_slip(sx, sy, mu, load):
    fx, fy = steady_force_n(sx, sy, load, mu, TYRE)
    mirror_x, mirror_y = steady_force_n(sx, -sy, load, mu, TYRE)
    assert (mirror_x, mirror_y) == (fx, -fy)
    assert steady_force_n(-sx, sy, load, mu, TYRE) == (-fx, fy)


def test_braking_takes_from_cornering():
    alone = steady_force_n(0.0, 0.05, NOMINAL_N, 0.5, TYRE)[1]
    shared = steady_force_n(-0.05, 0.05, NOMINAL_N, 0.5, TYRE)[1]
    assert 0.3 * alone < shared < 0.95 * alone


def test_a_lifted_wheel_has_no_force():
    assert steady_force_n(0.1, 0.1, 0.0, 0.5, TYRE) == (0.0, 0.0)


def test_lateral_force_builds_up_over_its_relaxation_length():
    rolling, sliding, step = 20.0, 0.1, 1e-4
    slope, _, hy, _ = slip_slope(0.0, -sliding / rolling, NOMINAL_N, 0.8, TYRE)
    final = -slope * sliding / rolling / hy
    length = slope / (hy * TYRE.stiffness_y_npm)
    bristle, travelled, force = 0.0, 0.0, 0.0
    while travelled < length:
        bristle, force, _ = built_up_force_n(
            bristle, sliding, rolling, slope, hy, TYRE.stiffness_y_npm, TYRE.damping_y_nspm, step
        )
        travelled += rolling * step
    assert 0.2 < length < 1.0
    # Carcass damping makes the build-up somewhat slower in time than the undamped length says.
    assert 0.55 < force / final < 0.70

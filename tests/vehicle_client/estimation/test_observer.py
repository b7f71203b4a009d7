"""The kinematic observer on motion whose velocities are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from vehicle_client.estimation.observer import (
    PAPER_PARAMETERS,
    observed_velocity_mps,
    sideslip_rad,
    sideslip_rate_radps,
    straightness_1ps,
)

N = 1500
TIME_S = np.arange(N) * 0.01
ZERO = np.zeros(N)


def observe(ax, ay, w, v, f):
    return observed_velocity_mps(ax, ay, w, v, f, parameters=PAPER_PARAMETERS)


def test_the_constants_are_the_papers():
    p = PAPER_PARAMETERS
    assert (p.alpha_0_1ps, p.alpha_1_ratio, p.alpha_2_ratio, p.accel_x_threshold_mps2) == (15.0, 14.0, 5.0, 1.0)
    assert (p.sigma_wheel_steady_mps2, p.sigma_wheel_accelerating_mps2) == (4.5, 1.0)
    assert (p.sigma_yaw_rate_radps, p.sigma_yaw_accel_radps2, p.sigma_steer_rad) == (0.22, 0.22, 0.12)
    assert (p.sigma_steer_rate_radps, p.sigma_sideslip_rate_radps, p.sigma_sideslip_accel_radps2) == (0.08, 0.05, 0.3)


@given(radius_m=st.floats(30.0, 500.0), speed=st.floats(5.0, 25.0), left=st.booleans())
def test_a_steady_circle_without_sideslip_stays_one(radius_m, speed, left):
    w = np.full(N, speed / radius_m * (1.0 if left else -1.0))
    v = np.full(N, speed)
    x, y = observe(ZERO, w * speed, w, v, np.full(N, 0.5))
    assert np.allclose(x, speed, atol=1e-9)
    assert np.allclose(y, 0.0, atol=1e-9)


def test_sinusoidal_sideslip_is_followed_where_nothing_pulls():
    # V_x = 20, V_y = 0.8 sin(2 t), w = 0.2 cos(t): exact accelerations, exact encoders, F = 0.
    vy, dvy = 0.8 * np.sin(2.0 * TIME_S), 1.6 * np.cos(2.0 * TIME_S)
    w = 0.2 * np.cos(TIME_S)
    x, y = observe(-w * vy, dvy + w * 20.0, w, np.full(N, 20.0), ZERO)
    assert np.abs(x - 20.0).max() < 1e-3
    assert np.abs(y - vy).max() < 2e-3


def test_the_recursion_solves_the_papers_equation():
    # Away from the truth too: wrong encoders, offsets, F that varies. An independent integrator is the judge.
    ax = 0.5 * np.sin(TIME_S)
    ay = 1.0 + np.cos(0.7 * TIME_S)
    w = 0.3 * np.sin(0.5 * TIME_S)
    v = 15.0 + 0.5 * np.cos(TIME_S)
    f = 0.5 + 0.5 * np.sin(0.9 * TIME_S) ** 2
    x, y = observe(ax, ay, w, v, f)

    def slope(t, s):
        wt, vt = 0.3 * np.sin(0.5 * t), 15.0 + 0.5 * np.cos(t)
        pull = 15.0 + 14.0 * abs(wt)
        dx = -pull * s[0] + wt * s[1] + 0.5 * np.sin(t) + pull * vt
        dy = -6.0 * wt * s[0] - (0.5 + 0.5 * np.sin(0.9 * t) ** 2) * s[1] + 1.0 + np.cos(0.7 * t) + 5.0 * wt * vt
        return [dx, dy]

    truth = solve_ivp(slope, (0.0, TIME_S[-1]), [v[0], 0.0], t_eval=TIME_S, rtol=1e-9, atol=1e-9).y
    assert np.abs(x - truth[0]).max() < 2e-3
    assert np.abs(y - truth[1]).max() < 2e-3


def test_on_a_straight_an_accelerometer_offset_cannot_run_away():
    x, y = observe(ZERO, np.full(N, 0.1), ZERO, np.full(N, 20.0), np.ones(N))
    assert np.abs(y).max() <= 0.1 + 1e-9
    assert np.allclose(x, 20.0)


def test_the_mirror_slides_the_other_way():
    rng = np.random.default_rng(3)
    ax, ay, w = rng.normal(0.0, 0.3, (3, N))
    v, f = np.full(N, 15.0), rng.uniform(0.0, 1.0, N)
    x, y = observe(ax, ay, w, v, f)
    mirrored_x, mirrored_y = observe(ax, -ay, -w, v, f)
    assert np.allclose(mirrored_x, x, atol=1e-12)
    assert np.allclose(mirrored_y, -y, atol=1e-12)


def test_straight_driving_pulls_with_one_per_second_and_action_does_not():
    assert np.allclose(straightness_1ps(ZERO, ZERO, ZERO, parameters=PAPER_PARAMETERS), 1.0)
    w = np.full(N, 0.22)
    assert np.allclose(straightness_1ps(w, ZERO, ZERO, parameters=PAPER_PARAMETERS), np.exp(-0.5))
    assert straightness_1ps(w * 4, ZERO + 0.4, ZERO, parameters=PAPER_PARAMETERS).max() < 1e-5


def test_the_sideslip_rate_is_what_turns_the_velocity_beyond_the_yaw():
    ay = 3.0 + 2.0 * np.sin(TIME_S)
    rate = sideslip_rate_radps(ay, np.full(N, 0.2), np.full(N, 15.0))
    assert np.abs(rate - 2.0 * np.sin(TIME_S) / 15.0)[40:-40].max() < 1e-4


def test_sideslip_and_its_rate_are_finite_at_standstill():
    assert np.isfinite(sideslip_rate_radps(ZERO, ZERO, ZERO)).all()
    assert sideslip_rad(np.array([0.0]), np.array([0.1]))[0] == pytest.approx(np.arctan(0.1))

"""The kinematic observer on motion whose velocities are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from vehicle_client.estimation.observer import (
    XC90_PARAMETERS,
    gripping_velocity_y_mps,
    observed_velocity_mps,
    sideslip_rad,
    sideslip_rate_radps,
    straightness_1ps,
    two_way_velocity_mps,
)

N = 1500
TIME_S = np.arange(N) * 0.01
ZERO = np.zeros(N)


def observe(ax, ay, w, v, f):
    return observed_velocity_mps(ax, ay, w, v, f, parameters=XC90_PARAMETERS)


def test_the_constants_are_the_papers():
    p = XC90_PARAMETERS
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


@pytest.mark.parametrize("pulled_to_mps", [None, -0.2, 0.3])
@pytest.mark.parametrize("observer", [observed_velocity_mps, two_way_velocity_mps])
def test_a_steady_circle_with_sideslip_settles_between_it_and_what_is_pulled_to(observer, pulled_to_mps):
    # The equation at rest, solved by hand: V_y counts with (1 + a_2) w^2 / (a_0 + a_1 |w|), the pull with F.
    w, v, vy, f = 0.3, 15.0, -0.6, 0.4
    held = None if pulled_to_mps is None else np.full(N, pulled_to_mps)
    _, y = observer(
        np.full(N, -w * vy),
        np.full(N, w * v),
        np.full(N, w),
        np.full(N, v),
        np.full(N, f),
        parameters=XC90_PARAMETERS,
        gripping_velocity_y_mps=held,
    )
    kept = 6.0 * w**2 / (15.0 + 14.0 * w)
    # Both runs have forgotten their start in the middle: 7.5 s at a rate of more than 0.4 per second.
    assert y[N // 2] == pytest.approx((kept * vy + f * (pulled_to_mps or 0.0)) / (kept + f), abs=0.03)
    long = np.full(20 * N, 1.0)
    _, y = observer(-w * vy * long, w * v * long, w * long, v * long, f * long, parameters=XC90_PARAMETERS)
    assert y[10 * N] == pytest.approx(kept * vy / (kept + f), abs=1e-9)


def test_run_both_ways_the_observer_lags_nothing_and_keeps_w2_over_w2_plus_f2():
    omega, f = 1.5, 0.5
    vy = np.sin(omega * TIME_S)
    _, y = two_way_velocity_mps(
        ZERO, np.gradient(vy, 0.01), ZERO, np.full(N, 20.0), np.full(N, f), parameters=XC90_PARAMETERS
    )
    middle = slice(700, 800)
    assert np.abs(y - omega**2 / (omega**2 + f**2) * vy)[middle].max() < 0.05


def test_run_both_ways_an_offset_of_the_accelerometer_cancels():
    _, y = two_way_velocity_mps(
        ZERO, np.full(N, 0.1), ZERO, np.full(N, 20.0), np.full(N, 3.0), parameters=XC90_PARAMETERS
    )
    assert abs(y[N // 2]) < 1e-9


def test_run_both_ways_time_may_run_backward():
    rng = np.random.default_rng(4)
    ax, ay, w = rng.normal(0.0, 0.3, (3, N))
    v, f, held = np.full(N, 15.0), rng.uniform(0.0, 1.0, N), rng.normal(0.0, 0.1, N)
    x, y = two_way_velocity_mps(ax, ay, w, v, f, parameters=XC90_PARAMETERS, gripping_velocity_y_mps=held)
    back = two_way_velocity_mps(
        -ax[::-1], -ay[::-1], -w[::-1], v, f[::-1], parameters=XC90_PARAMETERS, gripping_velocity_y_mps=held[::-1]
    )
    assert np.allclose(back[0][::-1], x, atol=1e-12)
    assert np.allclose(back[1][::-1], y, atol=1e-12)


def test_a_gripping_car_turns_about_a_point_beside_its_rear_axle():
    # Slowly round a circle of 20 m: sideslip is the distance of the rear axle over the radius.
    w = np.full(N, 2.0 / 20.0)
    p = replace(XC90_PARAMETERS, rear_slip_gradient_s2pm=0.005)
    slow = gripping_velocity_y_mps(ZERO, w, np.full(N, 2.0), rear_axle_m=1.5, parameters=p)
    assert np.allclose(slow / 2.0, 1.5 / 20.0)
    # Four m/s^2 take 0.02 rad of slip at the rear tyres.
    fast = gripping_velocity_y_mps(np.full(N, 4.0), w, np.full(N, 40.0), rear_axle_m=1.5, parameters=p)
    assert np.allclose(fast / 40.0, 1.5 * 0.1 / 40.0 - 0.02)


def test_a_car_on_a_straight_grips_without_lateral_velocity():
    assert not gripping_velocity_y_mps(ZERO, ZERO, np.full(N, 30.0), rear_axle_m=1.5, parameters=XC90_PARAMETERS).any()


def test_the_papers_pull_to_zero_is_a_constant_away():
    p = replace(XC90_PARAMETERS, grip_pull_ratio=0.0)
    assert not gripping_velocity_y_mps(
        np.full(N, 4.0), np.full(N, 0.3), np.full(N, 13.0), rear_axle_m=1.5, parameters=p
    ).any()


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
    assert np.allclose(straightness_1ps(ZERO, ZERO, ZERO, parameters=XC90_PARAMETERS), 1.0)
    w = np.full(N, 0.22)
    assert np.allclose(straightness_1ps(w, ZERO, ZERO, parameters=XC90_PARAMETERS), np.exp(-0.5))
    assert straightness_1ps(w * 4, ZERO + 0.4, ZERO, parameters=XC90_PARAMETERS).max() < 1e-5


def test_the_sideslip_rate_is_what_turns_the_velocity_beyond_the_yaw():
    ay = 3.0 + 2.0 * np.sin(TIME_S)
    rate = sideslip_rate_radps(ay, np.full(N, 0.2), np.full(N, 15.0))
    assert np.abs(rate - 2.0 * np.sin(TIME_S) / 15.0)[40:-40].max() < 1e-4


def test_sideslip_and_its_rate_are_finite_at_standstill():
    assert np.isfinite(sideslip_rate_radps(ZERO, ZERO, ZERO)).all()
    assert sideslip_rad(np.array([0.0]), np.array([0.1]))[0] == pytest.approx(np.arctan(0.1))


@pytest.mark.parametrize(("speed_mps", "divisor_mps"), [(0.2, 1.0), (1.5, 1.5), (20.0, 20.0)])
def test_the_sideslip_rate_is_a_rate_of_angle_down_to_one_metre_a_second(speed_mps, divisor_mps):
    found = sideslip_rate_radps(np.full(N, 0.6), np.full(N, 0.1), np.full(N, speed_mps))
    assert found == pytest.approx(np.full(N, 0.6 / divisor_mps - 0.1))


def test_what_shakes_faster_than_the_filter_is_no_sideslip_rate():
    shaking = 3.0 * np.sin(2.0 * np.pi * 40.0 * TIME_S)
    assert np.abs(sideslip_rate_radps(shaking, ZERO, np.full(N, 20.0)))[40:-40].max() < 1e-4

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.domain.change import ChangePolicy, mu_since_change
from rsu_app.domain.watch import ChangeWatch
from rsu_app.domain.window import FrictionWindow

POLICY = ChangePolicy()
HOUR_S = 3600.0


def traffic(rng, count, mu_new):
    return mu_new * rng.uniform(0.8, 1.0, count) * np.exp(0.05 * rng.standard_normal(count))


def filled(left_at_s, mu, *, policy=POLICY, window_s=HOUR_S):
    window, watch = FrictionWindow(window_s=window_s), ChangeWatch(policy=policy, window_s=window_s)
    for at_s, value in zip(left_at_s, mu, strict=True):
        watch.add(left_at_s=float(at_s), mu=float(value))
        window.add(left_at_s=float(at_s), mu=float(value))
    return window, watch


def counted_mu(window, watch, *, now_s):
    window.evict(now_s=now_s)
    rows = window.rows
    return np.sort(rows.mu[rows.left_at_s >= watch.counted_from_s(window, now_s=now_s)])


def test_an_empty_window_counts_whole():
    window, watch = filled([], [])
    assert watch.counted_from_s(window, now_s=0.0) == -inf


@given(seed=st.integers(0, 2**32 - 1), per_hour=st.sampled_from([15, 60, 200]))
def test_the_unit_cuts_as_the_study_does(seed, per_hour):
    rng = np.random.default_rng(seed)
    mu = np.concatenate([traffic(rng, 60, 0.5), traffic(rng, int(rng.integers(0, 40)), 0.25)])
    left_at_s = np.arange(len(mu)) * HOUR_S / per_hour
    now_s = float(left_at_s[-1])
    window, watch = filled(left_at_s, mu)
    remembered = left_at_s >= now_s - watch.memory_s
    expected = mu_since_change(left_at_s[remembered], mu[remembered], policy=POLICY, counted_from_s=now_s - HOUR_S)
    assert counted_mu(window, watch, now_s=now_s) == pytest.approx(expected)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_order_of_arrival_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    mu = np.concatenate([traffic(rng, 60, 0.5), traffic(rng, 15, 0.25)])
    left_at_s = np.arange(75) * 60.0
    order = rng.permutation(75)
    in_order, shuffled = filled(left_at_s, mu), filled(left_at_s[order], mu[order])
    assert counted_mu(*in_order, now_s=4500.0).tolist() == counted_mu(*shuffled, now_s=4500.0).tolist()


def test_fewer_than_ten_vehicles_never_count_alone(rng):
    mu = np.concatenate([traffic(rng, 60, 0.5), traffic(rng, 7, 0.2)])
    window, watch = filled(np.arange(67) * 50.0, mu)
    assert counted_mu(window, watch, now_s=3350.0).tolist() == sorted(mu[-10:])


def test_a_change_stays_found_when_traffic_pushes_what_was_before_out_of_memory(rng):
    policy = ChangePolicy(watched_count=200)
    mu = np.concatenate([traffic(rng, 300, 0.5), traffic(rng, 600, 0.25)])
    left_at_s = np.arange(900) * 3.0
    window, watch = filled(left_at_s, mu, policy=policy)
    assert watch.since_s(now_s=2700.0) == pytest.approx(900.0, abs=15.0)
    # An hour later nothing of the window is older than the change.
    window.evict(now_s=5000.0)
    assert watch.counted_from_s(window, now_s=5000.0) == -inf


def test_a_change_that_late_reports_disprove_is_forgotten(rng):
    mu = np.concatenate([traffic(rng, 60, 0.5), traffic(rng, 12, 0.25)])
    left_at_s = np.arange(72) * 30.0
    _, watch = filled(left_at_s, mu)
    assert watch.since_s(now_s=2200.0) > 0.0
    # The slippery ones turn out to have been few among many that drove at the same time.
    for at_s, value in zip(np.linspace(1500.0, 2150.0, 100), traffic(rng, 100, 0.5), strict=True):
        watch.add(left_at_s=float(at_s), mu=float(value))
    assert watch.since_s(now_s=2200.0) == -inf


@pytest.mark.parametrize("count", [1_000, 5_000])
def test_no_traffic_makes_it_remember_more_than_it_looks_at(rng, count):
    policy = ChangePolicy(watched_count=500)
    _, watch = filled(np.arange(count) * 0.5, traffic(rng, count, 0.5), policy=policy)
    assert watch.since_s(now_s=0.5 * count) == -inf
    assert len(watch._memory) == 500  # noqa: SLF001 - the bound is what this test is about

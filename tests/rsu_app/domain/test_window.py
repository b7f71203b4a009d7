from __future__ import annotations

from math import inf, isnan
from statistics import median

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from rsu_app.domain.interval import median_of_ordered
from rsu_app.domain.window import FrictionWindow

FRICTIONS = st.floats(0.05, 1.5)
TIMES = st.floats(0.0, 10_000.0)
ESTIMATES = st.lists(st.tuples(TIMES, FRICTIONS), max_size=60)


def filled(estimates, **limits):
    window = FrictionWindow(**limits)
    for left_at_s, mu in estimates:
        window.add(left_at_s=left_at_s, mu=mu)
    return window


@given(ESTIMATES, st.randoms(use_true_random=False), st.integers(1, 20), TIMES)
def test_the_order_of_arrival_does_not_matter(estimates, chance, capacity_count, now_s):
    shuffled = list(estimates)
    chance.shuffle(shuffled)
    windows = [filled(order, capacity_count=capacity_count) for order in (estimates, shuffled)]
    for window in windows:
        window.evict(now_s=now_s)
    assert windows[0].ordered_mu == windows[1].ordered_mu
    assert np.array_equal(windows[0].rows.mu, windows[1].rows.mu)
    assert windows[0].newest_left_at_s == windows[1].newest_left_at_s


class WindowAgainstList(RuleBasedStateMachine):
    """The window does what a plain list of everything would do, only faster."""

    @initialize()
    def start(self):
        self.now_s = 0.0
        self.window = FrictionWindow(window_s=100.0, capacity_count=15)
        self.held: list[tuple[float, float]] = []

    @rule(age_s=st.floats(0.0, 150.0), mu=FRICTIONS)
    def add(self, age_s, mu):
        self.window.add(left_at_s=self.now_s - age_s, mu=mu)
        self.held = sorted([*self.held, (self.now_s - age_s, mu)])[-15:]

    @rule(seconds=st.floats(0.0, 60.0))
    def let_time_pass(self, seconds):
        self.now_s += seconds
        self.window.evict(now_s=self.now_s)
        self.held = [entry for entry in self.held if entry[0] >= self.now_s - 100.0]

    @invariant()
    def both_hold_the_same(self):
        assert list(self.window.ordered_mu) == sorted(mu for _, mu in self.held)
        assert len(self.window) == len(self.held)
        assert list(zip(self.window.rows.left_at_s, self.window.rows.mu, strict=True)) == sorted(self.held)
        if self.held:
            assert median_of_ordered(self.window.ordered_mu) == median(mu for _, mu in self.held)
            assert self.window.newest_left_at_s == max(left_at_s for left_at_s, _ in self.held)
        else:
            assert self.window.newest_left_at_s == float("-inf")


TestWindowAgainstList = WindowAgainstList.TestCase


def test_an_estimate_as_old_as_the_window_still_counts():
    window = filled([(0.0, 0.5)], window_s=3600.0)
    assert window.evict(now_s=3600.0) == 0
    assert window.evict(now_s=3600.1) == 1


def test_a_full_window_keeps_those_that_left_last():
    window = filled([(3.0, 0.3), (1.0, 0.1), (2.0, 0.2), (0.0, 0.9)], capacity_count=2)
    assert list(window.ordered_mu) == [0.2, 0.3]


def test_the_rows_hold_everything_that_was_said_oldest_first():
    window = FrictionWindow()
    window.add(left_at_s=2.0, mu=0.5, at_least=True, mu_low=0.4, expected_error_ratio=0.2, slowest_mps=12.0)
    window.add(left_at_s=1.0, mu=0.6)
    rows = window.rows
    assert isnan(rows.slowest_mps[0])
    assert rows.slowest_mps[1] == 12.0
    assert rows.left_at_s.tolist() == [1.0, 2.0]
    assert rows.mu.tolist() == [0.6, 0.5]
    assert rows.at_least.tolist() == [False, True]
    assert isnan(rows.mu_low[0])
    assert isnan(rows.expected_error_ratio[0])
    assert (rows.mu_low[1], rows.expected_error_ratio[1]) == (0.4, 0.2)


def test_the_rows_follow_every_change():
    window = filled([(0.0, 0.5), (10.0, 0.6)], window_s=60.0)
    assert window.rows.mu.tolist() == [0.5, 0.6]
    window.add(left_at_s=20.0, mu=0.7)
    assert window.rows.mu.tolist() == [0.5, 0.6, 0.7]
    window.evict(now_s=65.0)
    assert window.rows.mu.tolist() == [0.6, 0.7]
    window.evict(now_s=1000.0)
    assert [len(column) for column in (window.rows.mu, window.rows.at_least)] == [0, 0]


def test_at_least_must_say_at_least_what():
    with pytest.raises(ValueError, match="at least nan"):
        FrictionWindow().add(left_at_s=0.0, mu=0.5, at_least=True)


@pytest.mark.parametrize("mu", [float("nan"), float("inf"), 0.0, -0.1])
def test_what_is_no_friction_is_refused(mu):
    with pytest.raises(ValueError, match="does not belong"):
        FrictionWindow().add(left_at_s=0.0, mu=mu)


def test_a_time_that_cannot_be_ordered_is_refused():
    with pytest.raises(ValueError, match="does not belong"):
        FrictionWindow().add(left_at_s=float("nan"), mu=0.5)


def test_a_window_that_holds_nothing_cannot_be_made():
    with pytest.raises(ValueError, match="holds nothing"):
        FrictionWindow(window_s=0.0)


@given(st.lists(st.floats(0.0, 100.0), max_size=30), st.integers(1, 10))
def test_the_newest_rows_are_the_last_of_all(times_s, limit_count):
    window = FrictionWindow()
    for at_s in times_s:
        window.add(left_at_s=at_s, mu=0.5)
        assert window.newest_rows(limit_count).left_at_s.tolist() == sorted(window.rows.left_at_s)[-limit_count:]
    assert window.oldest_left_at_s == min(times_s, default=inf)

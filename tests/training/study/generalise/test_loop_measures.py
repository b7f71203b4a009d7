"""Measures of the closed loop on courses whose measures are known."""

from __future__ import annotations

import numpy as np
import pytest

from roadgrip.records import NotCounted
from roadgrip.sections import read_section
from rsu_app.domain.advisory import AdvisoryPolicy
from training.closed_loop import Course
from training.study.generalise.loop_measures import (
    Phase,
    drift,
    farthest,
    lag_s,
    largest,
    phase_measures,
    phases,
    published_mu,
    right_speed_mps,
)

SECTION = read_section("long-turn")
POLICY = AdvisoryPolicy()
DRY, SLIPPERY = phases((0.5, 0.2), phase_s=7200.0)


def course(mu_new, *, advised_mps=10.0, **vehicles):
    """Return a course of a vehicle a minute; `mu_new` is what the unit says, minute by minute."""
    at_s = 60.0 * np.arange(len(mu_new))
    one, true = np.ones(len(at_s)), np.ones(len(at_s), dtype=bool)
    columns = {
        "at_s": at_s,
        "base_friction_mu": one,
        "told_mps": one,
        "follows": true,
        "kept_to_road": true,
        "passed": true,
        "flags": 0.0 * one,
        "mu": 0.44 * one,
        "at_least": ~true,
        "label_mu": 0.4 * one,
        "mean_speed_mps": one,
        "peak_utilisation_ratio": 0.3 * one,
        "said_at_s": at_s,
        "said_mu_new": np.array(mu_new, dtype=float),
        "said_median_mu": 0.9 * np.array(mu_new),
        "said_count": one,
        "said_at_least": ~true,
        "advised_mps": advised_mps * one,
    }
    return Course(**columns | vehicles)


def measured(of, phase):
    return phase_measures(of, phase, section=SECTION, policy=POLICY)


def test_what_is_published_stands_until_something_else_is_said():
    said = published_mu(course([0.5, 0.4, np.nan]), np.array([-5.0, 0.0, 59.0, 60.0, 119.0, 500.0]))
    assert said == pytest.approx([0.45, 0.45, 0.45, 0.36, 0.36, np.nan], nan_ok=True)


def test_the_lag_ends_when_the_friction_is_known_and_stays_known():
    said = [0.5] * 120 + [0.5] * 10 + [0.2] + [0.3] * 9 + [0.21] * 100
    assert lag_s(course(said), DRY) == 0.0
    assert lag_s(course(said), SLIPPERY) == 20 * 60.0


def test_a_friction_that_never_is_known_has_no_end_of_its_lag():
    assert lag_s(course([0.5] * 240), SLIPPERY) == np.inf


def test_errors_are_those_of_the_second_hour():
    said = [np.nan] * 30 + [0.9] * 31 + [0.55] * 59 + [0.2] * 120
    dry = measured(course(said), DRY)
    assert (dry.error_frac, dry.bias_frac) == pytest.approx((0.1, 0.1))
    assert dry.silent_frac == 0.0
    assert measured(course(said), SLIPPERY).bias_frac == pytest.approx(0.0)
    low = measured(course([0.45] * 240), DRY)
    assert (low.error_frac, low.bias_frac) == pytest.approx((0.1, -0.1))


def test_a_unit_that_publishes_nothing_has_no_error_and_is_silent():
    silent = measured(course([np.nan] * 240), DRY)
    assert np.isnan(silent.error_frac)
    assert silent.silent_frac == 1.0
    assert silent.lag_s == np.inf


def test_those_who_leave_the_road_are_counted_before_and_after_the_unit_knew():
    minute = np.arange(240)
    kept = ~((minute >= 120) & (minute < 160) & (minute % 2 == 0) | (minute >= 160) & (minute % 10 == 0))
    said = [0.5] * 160 + [0.2] * 80
    slippery = measured(course(said, kept_to_road=kept), SLIPPERY)
    assert slippery.left_road_before_frac == 0.5
    assert slippery.left_road_after_frac == pytest.approx(0.1)
    assert slippery.left_road_frac == pytest.approx((20 + 8) / 120)


def test_shares_of_those_who_count():
    minute = np.arange(240)
    flags = np.where(minute % 4 == 0, float(NotCounted.OUT_OF_ENVELOPE.value), 0.0)
    dry = measured(course([0.5] * 240, flags=flags, follows=minute % 2 == 0, at_least=minute % 4 == 1), DRY)
    assert dry.counted_frac == 0.75
    assert dry.followers_counted_frac == 0.5
    assert dry.named_frac == pytest.approx(2.0 / 3.0)
    assert dry.estimate_error_frac == pytest.approx(0.1)
    assert dry.utilisation_ratio == pytest.approx(0.3)


def test_advice_is_held_against_that_for_the_true_friction():
    right_mps = right_speed_mps(SECTION, base_friction_mu=0.5, policy=POLICY)
    assert measured(course([0.5] * 240, advised_mps=1.2 * right_mps), DRY).advised_ratio == pytest.approx(1.2)
    assert right_speed_mps(SECTION, base_friction_mu=5.0, policy=POLICY) == SECTION.speed_limit_mps


def test_drift_is_what_a_lie_changes():
    right, wrong = course([0.5] * 240, advised_mps=10.0), course([0.4] * 240, advised_mps=9.0)
    found = drift(wrong, right, DRY)
    assert (found.claimed_frac, found.advised_frac) == pytest.approx((-0.2, -0.1))
    assert np.isnan(drift(course([np.nan] * 240), right, DRY).claimed_frac)


def test_what_is_marked_as_a_bound_is_published_and_claims_nothing():
    minute = np.arange(240)
    half = course([0.4] * 240, said_at_least=minute % 2 == 0)
    dry = measured(half, DRY)
    assert dry.bias_frac == pytest.approx(-0.2)
    assert dry.marked_frac == pytest.approx(0.5, abs=0.02)
    assert measured(course([0.4] * 240, said_at_least=minute >= 0), DRY).marked_frac == 1.0
    assert np.isnan(measured(course([0.4] * 240, said_at_least=minute >= 0), DRY).claimed_bias_frac)
    mixed = course(np.where(minute % 2, 0.5, 0.2).tolist(), said_at_least=minute % 2 == 0)
    assert measured(mixed, DRY).claimed_bias_frac == pytest.approx(0.0)
    assert drift(mixed, course([0.5] * 240), DRY).claimed_frac == pytest.approx(0.0)


def test_worst_values_pass_over_what_is_not_known():
    assert farthest([0.1, -0.3, np.nan, np.inf]) == -0.3
    assert largest([-0.2, np.nan, -0.1]) == -0.1
    assert np.isnan(farthest([np.nan]))
    assert np.isnan(largest([]))


def test_a_phase_knows_its_vehicles():
    assert np.flatnonzero(Phase(60.0, 180.0, 0.5).vehicles(course([0.5] * 5))).tolist() == [1, 2]

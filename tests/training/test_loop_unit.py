"""The laboratory's unit says what the road side unit says, and rests its advice on what it is told to."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.features import PROFILE_FRICTIONS_MU
from roadgrip.records import AdvisoryReason, NotCounted
from roadgrip.sections import read_section
from rsu_app.domain.advisory import AdvisoryPolicy
from rsu_app.domain.change import ChangePolicy
from rsu_app.domain.judgement import Judgement
from rsu_app.domain.pooling import PoolingPolicy
from rsu_app.domain.probing import ProbingPolicy
from rsu_app.domain.profiles import ProfilePolicy
from rsu_app.usecases.section_friction import FrictionPolicies, section_advisory
from rsu_app.usecases.section_state import section_states
from training.loop_unit import LoopUnit, UnitRules

SECTION = read_section("long-turn")
FLAT = np.zeros(len(PROFILE_FRICTIONS_MU))


def said(mu, *, at_least=False, flags=NotCounted.NONE):
    return Judgement(mu=mu, flags=flags, expected_error_ratio=0.05, mu_low=0.8 * mu, at_least=at_least)


def peak(mu, *, width_ratio=0.05):
    """Return the log likelihood of a passage that knows its friction that well."""
    return np.maximum(-0.5 * (np.log(np.array(PROFILE_FRICTIONS_MU) / mu) / width_ratio) ** 2, -40.0)


def unit_that_heard(mus, *, rules=None, every_s=60.0, at_least=False, profiles=None):
    unit = LoopUnit(SECTION, rules or UnitRules())
    for i, mu in enumerate(mus):
        profile = FLAT if profiles is None else profiles[i]
        unit.hear(said(mu, at_least=at_least), left_at_s=every_s * i, profile_ratio=profile)
    return unit


passages = st.lists(st.tuples(st.floats(0.05, 1.0), st.floats(5.0, 600.0), st.booleans()), min_size=1, max_size=60)


@settings(max_examples=50)
@given(heard=passages, cut=st.booleans())
def test_the_road_side_unit_publishes_and_advises_the_same(heard, cut):
    change = ChangePolicy() if cut else None
    unit = LoopUnit(SECTION, UnitRules(change=change, probing=ProbingPolicy()))
    states = section_states(
        [SECTION],
        policy=AdvisoryPolicy(),
        section_policies={},
        window_s=3600.0,
        window_capacity_count=1000,
        change_policy=change,
    )
    state = states[SECTION.section_id]
    now_s = 0.0
    for mu, later_s, at_least in heard:
        now_s += later_s
        likely = peak(mu, width_ratio=0.5)
        unit.hear(said(mu, at_least=at_least), left_at_s=now_s, profile_ratio=likely, slowest_mps=15.0)
        state.window.add(
            left_at_s=now_s, mu=mu, at_least=at_least, mu_low=0.8 * mu, expected_error_ratio=0.05, slowest_mps=15.0
        )
        state.likelihoods.add(left_at_s=now_s, profile_ratio=likely)
        if state.watch is not None and not at_least:
            state.watch.add(left_at_s=now_s, mu=mu)
        told = section_advisory(
            state,
            now_s=now_s,
            model_live=True,
            policies=FrictionPolicies(),
        )
        assert unit.advise(now_s=now_s) == told


def test_what_is_flagged_does_not_count():
    unit = LoopUnit(SECTION, UnitRules())
    assert not unit.hear(said(0.4, flags=NotCounted.OUT_OF_ENVELOPE), left_at_s=0.0, profile_ratio=FLAT)
    assert not unit.hear(Judgement(mu=None, flags=NotCounted.NONE), left_at_s=0.0, profile_ratio=FLAT)
    assert unit.advise(now_s=0.0).interval is None
    assert unit.advise(now_s=0.0).reason is AdvisoryReason.WINTER_SPEED_FEW_VEHICLES


def test_what_is_older_than_the_window_is_forgotten():
    unit = unit_that_heard([0.3] * 20)
    assert unit.interval(now_s=20 * 60.0) is not None
    assert unit.interval(now_s=20 * 60.0 + 3600.0) is None


def test_bounds_are_estimates_to_the_median_and_bounds_to_the_refined_interval():
    mus = [0.4] * 60
    by_median = unit_that_heard(mus, at_least=True).interval(now_s=3599.0)
    refined = unit_that_heard(mus, at_least=True, rules=UnitRules(pooling=PoolingPolicy())).interval(now_s=3599.0)
    assert by_median.mu_new == pytest.approx(0.4 / 0.9)
    assert refined.mu_new == pytest.approx(0.8 * 0.4 / 0.9)
    assert refined.median_low_mu == pytest.approx(0.8 * 0.4)


def test_what_is_hardly_more_than_a_bound_is_marked_whatever_advice_rests_on():
    for pooling in (None, PoolingPolicy()):
        for at_least in (True, False):
            unit = unit_that_heard([0.4] * 60, at_least=at_least, rules=UnitRules(pooling=pooling))
            unit.advise(now_s=3599.0)
            assert unit.at_least is at_least
    unknowing = unit_that_heard([0.4] * 60, rules=UnitRules(pooling=ProfilePolicy()))
    unknowing.advise(now_s=3599.0)
    assert unknowing.at_least


def test_likelihoods_place_the_interval_whatever_the_estimates_say():
    wear = np.linspace(0.8, 1.0, 60)
    profiles = [peak(0.3 * one) for one in wear]
    unit = unit_that_heard([0.6] * 60, profiles=profiles, rules=UnitRules(pooling=ProfilePolicy()))
    assert unit.interval(now_s=3599.0).mu_new == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("pooling", [None, PoolingPolicy(), ProfilePolicy()])
def test_a_window_cut_at_a_change_forgets_what_was_before(pooling):
    mus = [0.45] * 40 + [0.18] * 12
    unit = unit_that_heard(
        mus, rules=UnitRules(change=ChangePolicy(), pooling=pooling), profiles=[peak(mu) for mu in mus]
    )
    assert unit.interval(now_s=60.0 * 51).mu_new == pytest.approx(0.2, rel=0.15)


def test_where_likelihoods_decide_the_advice_is_held_where_they_leave_the_friction_open():
    rules = UnitRules(pooling=ProfilePolicy(), probing=ProbingPolicy())
    unit = unit_that_heard([0.45] * 30, rules=rules, profiles=[peak(0.45)] * 30)
    known = unit.advise(now_s=30 * 60.0)
    for i in range(30, 96):
        unit.hear(said(0.2, at_least=True), left_at_s=60.0 * i, profile_ratio=FLAT)
    held = unit.advise(now_s=95 * 60.0)
    assert unit.at_least
    assert held.speed_mps == known.speed_mps

"""While nobody knows the friction, advice is held: bounds do not lower it, and only shown headroom raises it."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.records import AdvisoryReason, Confidence
from roadgrip.units import kph_to_mps, mps_to_kph
from rsu_app.domain.advisory import AdvisoryPolicy, advise, curve_speed_mps
from rsu_app.domain.interval import IntervalPolicy, friction_interval
from rsu_app.domain.pooling import PoolingPolicy, RefinedInterval, support_of_window
from rsu_app.domain.probing import (
    ProbingPolicy,
    Standing,
    WindowKnowledge,
    advise_as_known,
    marked_interval,
    shows_headroom,
    standing_after,
)
from rsu_app.domain.window import FrictionWindow
from tests.rsu_app.fakes import make_section

POLICY = AdvisoryPolicy(winter_speed_mps=kph_to_mps(60.0), utilisation_frac=0.6)
PROBING = ProbingPolicy()
BEND = make_section(radius_m=100.0)
GENTLE = make_section(radius_m=2000.0, length_m=800.0)
BOUND_MU, GUESS_MU = 0.1, 0.3


def rows_of(bounds_count, *, named=(), slowest_kph=80.0, from_s=400.0, bound_mu=BOUND_MU):
    """Vehicles that only know a bound, then such that name a friction, a second apart."""
    window = FrictionWindow()
    for i in range(bounds_count):
        speed_mps = kph_to_mps(slowest_kph)
        window.add(left_at_s=from_s + i, mu=GUESS_MU, at_least=True, mu_low=bound_mu, slowest_mps=speed_mps)
    for i, mu in enumerate(named):
        window.add(left_at_s=from_s + bounds_count + i, mu=mu, slowest_mps=kph_to_mps(slowest_kph))
    return window.rows


def window_of(rows, likely=None):
    support = support_of_window(rows, policy=PoolingPolicy())
    assert support is not None
    return WindowKnowledge(rows, support, likely)


def interval_of(rows):
    return friction_interval(np.sort(rows.mu).tolist(), newest_age_s=0.0, policy=IntervalPolicy())


def open_above(count):
    """What likelihoods place that exclude no high friction."""
    return RefinedInterval(0.08, 0.1, inf, 0, count, clipped=False, at_least=True) if count else None


def advice(
    rows, *, standing_kph=40.0, likely=None, unsent=False, section=BEND, since_s=0.0, policy=POLICY, model_live=True
):
    sent = None if unsent else likely or open_above(len(rows.mu))
    return advise_as_known(
        section,
        interval=interval_of(rows),
        window=window_of(rows, sent),
        model_live=model_live,
        policy=policy,
        probing=PROBING,
        standing=None if standing_kph is None else Standing(kph_to_mps(standing_kph), since_s),
    )


def advised_kph(rows, **situation):
    return round(mps_to_kph(advice(rows, **situation).speed_mps), 6)


def likely_at(mu_new, *, count=60, at_least=False):
    half_width_mu = inf if at_least else 0.01
    return RefinedInterval(0.8 * mu_new, mu_new, half_width_mu, count, 0, clipped=False, at_least=at_least)


def kph_for(mu_low):
    return mps_to_kph(curve_speed_mps(BEND, mu=mu_low, utilisation_frac=0.6))


# Known ----------------------------------------------------------------------------------------------------------------


@given(st.lists(st.floats(0.05, 1.0), min_size=1, max_size=80), st.none() | st.integers(1, 16))
def test_where_vehicles_name_a_friction_nothing_is_different(named, previous):
    rows = rows_of(0, named=named)
    plain = advise(
        BEND,
        interval=interval_of(rows),
        model_live=True,
        policy=POLICY,
        previous_speed_mps=None if previous is None else kph_to_mps(5.0 * previous),
    )
    assert advice(rows, standing_kph=None if previous is None else 5.0 * previous) == plain


def test_without_vehicles_or_a_model_the_winter_speed_is_advised():
    nothing = advise_as_known(
        BEND, interval=None, window=None, model_live=True, policy=POLICY, probing=PROBING, standing=None
    )
    assert nothing.reason is AdvisoryReason.WINTER_SPEED_FEW_VEHICLES
    assert advice(rows_of(60), model_live=False).reason is AdvisoryReason.WINTER_SPEED_NO_MODEL
    assert advice(rows_of(9)).reason is AdvisoryReason.WINTER_SPEED_FEW_VEHICLES


def test_an_interval_that_rests_on_bounds_is_provisional_however_many_vehicles_there_are():
    rows = rows_of(200)
    interval = interval_of(rows)
    assert interval.confidence is Confidence.RECOMMENDED
    marked = marked_interval(interval, window_of(rows).support)
    assert marked == replace(interval, confidence=Confidence.PROVISIONAL)
    assert advice(rows).interval == marked
    few = interval_of(rows_of(5))
    assert marked_interval(few, window_of(rows).support) == few
    known = rows_of(0, named=[0.4] * 60)
    assert marked_interval(interval_of(known), window_of(known).support) == interval_of(known)


# Held -----------------------------------------------------------------------------------------------------------------


@given(
    count=st.integers(10, 120),
    bound_mu=st.floats(0.01, 0.6),
    standing=st.integers(1, 16),
    slowest_kph=st.floats(5.0, 100.0),
)
def test_vehicles_that_only_know_a_bound_never_lower_the_advice(count, bound_mu, standing, slowest_kph):
    rows = rows_of(count, bound_mu=bound_mu, slowest_kph=slowest_kph)
    assert advised_kph(rows, standing_kph=5.0 * standing) >= 5.0 * standing - 1e-6


@given(count=st.integers(10, 200), told=st.floats(0.3, 0.85), standing=st.integers(4, 16))
def test_drivers_who_are_told_less_than_is_meant_neither_lower_nor_raise_it(count, told, standing):
    meant_kph = 5.0 * standing
    rows = rows_of(count, slowest_kph=told * meant_kph, bound_mu=0.02)
    assert advised_kph(rows, standing_kph=meant_kph) == pytest.approx(meant_kph)


@pytest.mark.parametrize("sent_frac", [0.0, 0.4])
def test_without_likelihoods_nothing_would_tell_of_ice_so_nothing_is_held(sent_frac):
    rows = rows_of(60)
    plain = advise(
        BEND,
        interval=marked_interval(interval_of(rows), window_of(rows).support),
        model_live=True,
        policy=POLICY,
        previous_speed_mps=kph_to_mps(60.0),
    )
    few = open_above(int(sent_frac * 60))
    told = advice(rows, standing_kph=60.0, likely=few, unsent=few is None)
    assert told.speed_mps == plain.speed_mps < kph_to_mps(60.0)


def test_of_a_dense_traffic_the_newest_two_hundred_likelihoods_suffice():
    assert advised_kph(rows_of(900, slowest_kph=1.0), likely=open_above(100)) == pytest.approx(40.0)
    assert window_of(rows_of(900), open_above(100)).is_watched
    assert not window_of(rows_of(900), open_above(99)).is_watched


@given(
    named_mu=st.floats(0.1, 0.8),
    named_count=st.integers(50, 100),
    more_frac=st.floats(0.0, 1.45),
    bound_mu=st.floats(0.01, 0.05),
)
def test_low_bounds_beside_enough_who_know_do_not_lower_the_advice_below_what_those_say(
    named_mu, named_count, more_frac, bound_mu
):
    known = advice(rows_of(0, named=[named_mu] * named_count), standing_kph=80.0)
    mixed = rows_of(int(more_frac * named_count), named=[named_mu] * named_count, bound_mu=bound_mu)
    assert not window_of(mixed).support.at_least
    for standing_kph in (mps_to_kph(known.speed_mps), 80.0):
        assert advised_kph(mixed, standing_kph=standing_kph) >= mps_to_kph(known.speed_mps) - 1e-6


def test_bounds_beside_enough_who_know_do_not_keep_the_advice_from_falling():
    mixed = rows_of(20, named=[0.15] * 40)
    assert advised_kph(mixed, standing_kph=60.0) == pytest.approx(5.0 * (kph_for(0.8 / 0.9 * 0.15) // 5.0))


def test_the_advice_begins_as_with_a_provisional_interval():
    rows = rows_of(20)
    plain = advise(BEND, interval=interval_of(rows), model_live=True, policy=POLICY, previous_speed_mps=None)
    assert advice(rows, standing_kph=None).speed_mps == plain.speed_mps


@given(bound_mu=st.floats(0.02, 1.0), count=st.integers(50, 120))
def test_a_bound_gives_at_least_what_a_known_friction_of_its_value_would(bound_mu, count):
    known = advise(
        BEND,
        interval=friction_interval([bound_mu] * count, newest_age_s=0.0, policy=IntervalPolicy()),
        model_live=True,
        policy=POLICY,
        previous_speed_mps=None,
    )
    held = advice(rows_of(count, bound_mu=bound_mu, slowest_kph=1.0), standing_kph=5.0)
    assert held.speed_mps >= known.speed_mps - 1e-9


def test_on_a_gentle_road_bounds_suffice_for_the_limit():
    assert advised_kph(rows_of(60), section=GENTLE) == pytest.approx(80.0)
    assert advised_kph(rows_of(20), section=GENTLE) == pytest.approx(60.0)


# Raised ---------------------------------------------------------------------------------------------------------------


def test_the_advice_rises_by_a_step_when_vehicles_drove_by_it_and_felt_nothing():
    advisory = advice(rows_of(10, slowest_kph=38.0))
    assert mps_to_kph(advisory.speed_mps) == pytest.approx(45.0)
    assert advisory.reason is AdvisoryReason.LOWER_CONFIDENCE_BOUND


@pytest.mark.parametrize(
    "situation",
    [
        {"bounds_count": 9, "named": [0.2]},
        {"bounds_count": 40, "slowest_kph": 35.0},
        {"bounds_count": 40, "slowest_kph": nan},
        {"bounds_count": 40, "from_s": 250.0},
        {"bounds_count": 40, "named": [0.9] * 5},
    ],
    ids=["few", "slower than told", "speed not remembered", "before they heard it", "some felt the limit"],
)
def test_without_that_it_stays(situation):
    assert advised_kph(rows_of(**situation)) == pytest.approx(40.0)


def test_it_rises_step_by_step_each_after_new_vehicles():
    rows, standing = rows_of(30), None
    seen = []
    for now_s in (430.0, 440.0, 450.0):
        told = advise_as_known(
            BEND,
            interval=interval_of(rows),
            window=window_of(rows, open_above(30)),
            model_live=True,
            policy=POLICY,
            probing=PROBING,
            standing=standing or Standing(kph_to_mps(40.0), 0.0),
        )
        standing = standing_after(standing, told, now_s=now_s)
        seen.append(round(mps_to_kph(told.speed_mps)))
    assert seen == [45, 45, 45]
    assert standing is not None
    assert standing.since_s == 430.0


@given(standing=st.integers(1, 16), count=st.integers(10, 120))
def test_it_rises_by_one_step_at_most_and_not_above_the_winter_speed(standing, count):
    kph = advised_kph(rows_of(count, bound_mu=0.01), standing_kph=5.0 * standing)
    assert kph == pytest.approx(max(5.0 * standing, min(5.0 * standing + 5.0, 60.0)))


# Lowered --------------------------------------------------------------------------------------------------------------


def test_a_few_who_name_a_friction_lower_the_advice_but_do_not_raise_it():
    assert advised_kph(rows_of(60, named=[0.12] * 6)) == pytest.approx(5.0 * (kph_for(0.8 / 0.9 * 0.12) // 5.0))
    assert advised_kph(rows_of(60, named=[0.12] * 5)) == pytest.approx(45.0)
    assert advised_kph(rows_of(60, named=[1.2] * 12)) == pytest.approx(40.0)


def test_what_all_likelihoods_place_lowers_the_advice_but_does_not_raise_it():
    rows = rows_of(60)
    assert advised_kph(rows, likely=likely_at(0.15)) == pytest.approx(5.0 * (kph_for(0.12) // 5.0))
    assert advised_kph(rows, likely=likely_at(1.5)) == pytest.approx(45.0)
    assert advised_kph(rows, likely=likely_at(0.15, at_least=True)) == pytest.approx(45.0)
    assert advised_kph(rows, likely=likely_at(0.15, count=31)) < 45.0
    assert advised_kph(rows_of(30), likely=likely_at(0.15, count=19)) == pytest.approx(45.0)


@given(
    named=st.lists(st.floats(0.05, 1.2), max_size=20),
    count=st.integers(31, 80),
    standing=st.none() | st.integers(1, 16),
    likely_mu=st.none() | st.floats(0.05, 1.5),
    section=st.sampled_from([BEND, GENTLE, make_section(radius_m=30.0, speed_limit_mps=kph_to_mps(40.0))]),
)
def test_advice_is_a_multiple_of_five_between_five_and_the_limit(*, named, count, standing, likely_mu, section):
    likely = None if likely_mu is None else likely_at(likely_mu)
    standing_kph = None if standing is None else 5.0 * standing
    kph = advised_kph(rows_of(count, named=named), standing_kph=standing_kph, likely=likely, section=section)
    assert kph == pytest.approx(5.0 * round(kph / 5.0), abs=1e-6)
    assert 5.0 - 1e-6 <= kph <= mps_to_kph(section.speed_limit_mps) + 0.02


def test_a_standing_advice_keeps_its_time_until_it_changes():
    rows = rows_of(5)
    first = standing_after(None, advice(rows), now_s=10.0)
    assert first.since_s == 10.0
    assert standing_after(first, advice(rows), now_s=20.0) == first
    assert standing_after(replace(first, speed_mps=1.0), advice(rows), now_s=20.0).since_s == 20.0


def test_headroom_is_shown_by_those_who_heard_the_advice():
    standing = Standing(kph_to_mps(40.0), 0.0)
    assert shows_headroom(rows_of(10), standing=standing, policy=PROBING)
    assert not shows_headroom(rows_of(10), standing=replace(standing, since_s=105.0), policy=PROBING)


@pytest.mark.parametrize(
    "decisions",
    [
        {"evidence_count": 0},
        {"knowing_count": 0},
        {"likely_count": 0},
        {"sure_count": 0},
        {"named_frac": 1.0},
        {"driven_frac": 0.0},
        {"heard_after_s": -1.0},
    ],
)
def test_a_policy_that_cannot_be_meant_is_refused(decisions):
    with pytest.raises(ValueError, match=r".+"):
        replace(PROBING, **decisions)

"""The circle of unit, drivers and model closes on the truth where the model sees friction, and on lies where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.features import NEWEST_TABLE
from roadgrip.records import NotCounted
from roadgrip.sections import read_section
from rsu_app.domain.advisory import curve_speed_mps
from rsu_app.domain.judgement import Judgement
from training.advice_following import SLOWEST_FRAC
from training.closed_loop import Case, Course, Passed, Traveller, closed_loop, draw_travellers, heard
from training.loop_unit import UnitRules
from vehicle_client.simulator.plan import PassagePlan

SECTION = read_section("long-turn")
MIDDLING_WEAR = 0.9
HOURS = 3


def plan_of(mu, *, speed_mps=SECTION.speed_limit_mps, seed=0):
    return PassagePlan(base_friction_mu=mu, seed=seed, wear_factor=MIDDLING_WEAR, target_speed_mps=speed_mps)


def coming(frictions_mu=(0.5,), *, hours=HOURS, per_hour=60):
    """Return vehicles of middling wear, evenly spaced, friction after friction; all of them may be obedient."""
    count = hours * per_hour
    return [
        Traveller(
            at_s=3600.0 * i / per_hour + 1.0,
            plan=plan_of(frictions_mu[i * len(frictions_mu) // count], seed=i),
            reluctance_frac=(i % 10) / 10.0,
            obedience_ratio=1.0,
        )
        for i in range(count)
    ]


def drive(plans):
    """Drive with the wished speed; tell friction and speed in the first two columns."""
    passed = []
    for plan in plans:
        found_mu = plan.base_friction_mu * plan.wear_factor
        row = np.zeros(len(NEWEST_TABLE))
        row[:2] = found_mu, plan.target_speed_mps
        passed.append(
            Passed(
                row=row,
                kept_to_road=True,
                duration_s=30.0,
                label_mu=found_mu,
                mean_speed_mps=plan.target_speed_mps,
                peak_utilisation_ratio=0.5,
            )
        )
    return passed


def knowing(rows):
    return [Judgement(mu=float(row[0]), flags=NotCounted.NONE) for row in rows]


def speed_reading(rows):
    """Return the friction for which a unit would advise just the speed that is driven."""
    at_one_mps = curve_speed_mps(SECTION, mu=1.0, utilisation_frac=0.6)
    return [Judgement(mu=0.9 / 0.8 * float(row[1] / at_one_mps) ** 2, flags=NotCounted.NONE) for row in rows]


def case(name="case", *, judge=knowing, compliance_frac=1.0, told_ratio=1.0):
    return Case(name, judge, UnitRules(), compliance_frac, told_ratio)


def run(*cases, travellers=None):
    return closed_loop(cases, coming() if travellers is None else travellers, section=SECTION, drive=drive)


def published_mu(course):
    return 0.9 * course.said_mu_new[-1]


@pytest.mark.parametrize("compliance_frac", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("told_ratio", [0.7, 1.0, 1.3])
def test_a_model_that_sees_friction_finds_the_truth_within_a_window_whatever_drivers_are_told(
    compliance_frac, told_ratio
):
    frictions_mu = (0.5, 0.2)
    course = run(
        case(compliance_frac=compliance_frac, told_ratio=told_ratio),
        travellers=coming(frictions_mu, hours=4),
    )["case"]
    for place, mu in enumerate(frictions_mu):
        settled = (course.said_at_s > 7200.0 * place + 3600.0 + 30.0) & (course.said_at_s < 7200.0 * (place + 1))
        assert 0.9 * course.said_mu_new[settled] == pytest.approx(0.9 * mu)


def test_a_model_that_reads_friction_from_the_speed_believes_its_own_lies():
    went = run(*(case(f"{ratio}", judge=speed_reading, told_ratio=ratio) for ratio in (0.7, 1.0, 1.3)))
    slow, right, fast = (published_mu(went[f"{ratio}"]) for ratio in (0.7, 1.0, 1.3))
    assert slow < 0.9 * right
    assert fast > 1.1 * right


def test_where_nobody_obeys_no_lie_is_heard():
    went = run(*(case(f"{ratio}", judge=speed_reading, compliance_frac=0.0, told_ratio=ratio) for ratio in (0.7, 1.3)))
    low, high = (went[name].arrays() for name in ("0.7", "1.3"))
    assert all(np.array_equal(low[name], high[name], equal_nan=True) for name in low if name != "told_mps")


def test_those_who_drive_alike_are_driven_once():
    driven = []

    def counting(plans):
        driven.extend(plans)
        return drive(plans)

    travellers = coming(hours=1)
    cases = [case("a", compliance_frac=0.0), case("b", compliance_frac=0.0), case("c", compliance_frac=0.0)]
    closed_loop(cases, travellers, section=SECTION, drive=counting)
    assert [plan.seed for plan in driven] == list(range(len(travellers)))


def test_all_who_come_within_a_slot_hear_what_was_said_at_its_beginning():
    course = run(case(), travellers=coming(hours=2))["case"]
    slots = course.at_s // 300.0
    assert all(len(set(course.told_mps[slots == slot])) == 1 for slot in set(slots.tolist()))
    said = course.advised_mps[np.searchsorted(course.said_at_s, 300.0 * slots, side="right") - 1]
    assert np.array_equal(said, course.told_mps)


def test_who_leaves_the_road_tells_nothing():
    def ditch(plans):
        return [replace(one, row=None, kept_to_road=False) for one in drive(plans)]

    course = closed_loop([case()], coming(hours=1), section=SECTION, drive=ditch)["case"]
    assert not course.kept_to_road.any()
    assert not course.counted.any()
    assert np.isnan(course.mu).all()
    assert np.isnan(course.said_mu_new).all()


def test_what_is_flagged_is_written_down_and_does_not_count():
    def suspicious(rows):
        return [Judgement(mu=0.4, flags=NotCounted.OUT_OF_ENVELOPE) for _ in rows]

    course = run(case(judge=suspicious))["case"]
    assert course.passed.all()
    assert not course.counted.any()
    assert (course.said_count == 0.0).all()


def test_a_course_comes_back_from_its_arrays():
    course = run(case(compliance_frac=0.5))["case"]
    again = Course.of_arrays(course.arrays())
    assert again.follows.dtype == np.bool_
    assert again.arrays().keys() == course.arrays().keys()
    assert all(np.array_equal(again.arrays()[n], v, equal_nan=True) for n, v in course.arrays().items())


@given(reluctance=st.floats(0.0, 0.999), compliance=st.floats(0.0, 1.0), told_mps=st.floats(1.0, 40.0))
def test_who_obeys_drives_what_he_is_told_and_never_less_than_two_fifths_of_the_rated_speed(
    reluctance, compliance, told_mps
):
    one = Traveller(at_s=0.0, plan=plan_of(0.5), reluctance_frac=reluctance, obedience_ratio=1.02)
    plan = heard(one, section=SECTION, told_mps=told_mps, compliance_frac=compliance)
    if reluctance >= compliance:
        assert plan == one.plan
    else:
        assert plan.target_speed_mps == max(SLOWEST_FRAC * SECTION.speed_limit_mps, 1.02 * told_mps)
        assert replace(plan, target_speed_mps=one.plan.target_speed_mps) == one.plan


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32), per_hour=st.sampled_from([6.0, 60.0]))
def test_vehicles_come_in_order_so_many_an_hour(seed, per_hour):
    rng = np.random.default_rng(seed)
    drawn = draw_travellers(rng, until_s=7200.0, vehicles_per_hour=per_hour, plan_at=lambda _, at_s: plan_of(at_s))
    times_s = [one.at_s for one in drawn]
    assert times_s == sorted(times_s)
    assert len(drawn) == 2 * per_hour
    assert all(one.plan.base_friction_mu == one.at_s for one in drawn)

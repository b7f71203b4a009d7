from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.records import AdvisoryReason, Confidence, FrictionInterval
from roadgrip.section import BankOrigin, build_section
from roadgrip.units import GRAVITY_MPS2, kph_to_mps, mps_to_kph
from rsu_app.domain.advisory import AdvisoryPolicy, advise, curve_speed_mps
from rsu_app.domain.interval import IntervalPolicy, friction_interval
from tests.rsu_app.fakes import make_section

POLICY = AdvisoryPolicy(winter_speed_mps=kph_to_mps(50.0), utilisation_frac=0.6, rise_margin_mps=kph_to_mps(2.0))
BEND = make_section(radius_m=100.0)
# The spline through the nodes is two per cent tighter than the circle near its ends.
RADIUS_M = BEND.tightest_radius_m
LIMITS_KPH = (30.0, 50.0, 60.0, 70.0, 80.0, 90.0)


def interval_of(mu, *, count=60, newest_age_s=0.0, spread=0.0) -> FrictionInterval:
    ordered = sorted(mu * (1.0 + spread * offset) for offset in np.linspace(-1.0, 1.0, count))
    interval = friction_interval(ordered, newest_age_s=newest_age_s, policy=IntervalPolicy())
    assert interval is not None
    return interval


def advice(interval, *, section=BEND, model_live=True, policy=POLICY, previous_speed_mps=None):
    return advise(
        section, interval=interval, model_live=model_live, policy=policy, previous_speed_mps=previous_speed_mps
    )


def advised_kph(mu, *, previous_kph=None, section=BEND, policy=POLICY):
    previous_mps = None if previous_kph is None else kph_to_mps(previous_kph)
    return mps_to_kph(
        advice(interval_of(mu), section=section, policy=policy, previous_speed_mps=previous_mps).speed_mps
    )


def mu_for_kph(speed_kph):
    """The median friction at which the flat bend allows a speed."""
    return kph_to_mps(speed_kph) ** 2 / (GRAVITY_MPS2 * RADIUS_M) / 0.6 / (0.8 / 0.9)


def test_on_a_flat_bend_friction_alone_turns_the_car():
    expected_mps = np.sqrt(GRAVITY_MPS2 * RADIUS_M * 0.6 * 0.4)
    assert curve_speed_mps(BEND, mu=0.4, utilisation_frac=0.6) == pytest.approx(expected_mps, rel=1e-9)


@pytest.mark.parametrize("radius_m", [100.0, -100.0])
def test_a_measured_bank_helps_and_an_adverse_one_hurts(radius_m):
    def speed_mps(inward_bank_ratio):
        section = make_section(radius_m=radius_m, inward_bank_ratio=inward_bank_ratio, bank_origin=BankOrigin.MEASURED)
        return curve_speed_mps(section, mu=0.4, utilisation_frac=0.6)

    banked = np.sqrt(GRAVITY_MPS2 * RADIUS_M * (0.24 + 0.05) / (1.0 - 0.24 * 0.05))
    adverse = np.sqrt(GRAVITY_MPS2 * RADIUS_M * (0.24 - 0.05) / (1.0 + 0.24 * 0.05))
    assert speed_mps(0.05) == pytest.approx(banked, rel=1e-9)
    assert speed_mps(-0.05) == pytest.approx(adverse, rel=1e-9)
    assert speed_mps(-0.05) < speed_mps(0.0) < speed_mps(0.05)


@pytest.mark.parametrize("origin", [BankOrigin.INFERRED, BankOrigin.NONE])
def test_a_bank_that_nobody_measured_does_not_count(origin):
    guessed = make_section(inward_bank_ratio=0.06, bank_origin=origin)
    assert curve_speed_mps(guessed, mu=0.3, utilisation_frac=0.6) == curve_speed_mps(BEND, mu=0.3, utilisation_frac=0.6)


def test_a_bank_counts_up_to_the_cap_only():
    steep = make_section(inward_bank_ratio=0.2, bank_origin=BankOrigin.MEASURED)
    capped = make_section(inward_bank_ratio=0.08, bank_origin=BankOrigin.MEASURED)
    assert curve_speed_mps(steep, mu=0.3, utilisation_frac=0.6) == pytest.approx(
        curve_speed_mps(capped, mu=0.3, utilisation_frac=0.6)
    )


def test_ice_on_an_adverse_slope_leaves_the_lowest_advice():
    section = make_section(inward_bank_ratio=-0.08, bank_origin=BankOrigin.MEASURED)
    assert curve_speed_mps(section, mu=0.1, utilisation_frac=0.6) == 0.0
    assert advised_kph(0.1, section=section) == pytest.approx(5.0)


def test_the_tightest_turn_decides():
    wide, tight = make_section(radius_m=300.0), make_section(radius_m=60.0)
    offset = wide.nodes_m[-1]
    angle = 200.0 / 300.0
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    joined = build_section(
        section_id="joined",
        name="Joined",
        nodes_m=np.vstack([wide.nodes_m, offset + tight.nodes_m[1:] @ turn.T]),
        speed_limit_mps=kph_to_mps(80.0),
    )
    assert curve_speed_mps(joined, mu=0.4, utilisation_frac=0.6) == pytest.approx(
        curve_speed_mps(tight, mu=0.4, utilisation_frac=0.6), rel=0.06
    )


def test_a_straight_line_allows_any_speed_and_the_limit_holds():
    straight = build_section(
        section_id="straight",
        name="Straight",
        nodes_m=np.column_stack([np.arange(0.0, 200.0, 10.0), np.zeros(20), np.zeros(20)]),
        speed_limit_mps=kph_to_mps(80.0),
    )
    assert curve_speed_mps(straight, mu=0.1, utilisation_frac=0.6) == float("inf")
    assert advised_kph(0.1, section=straight) == pytest.approx(80.0)


@given(st.floats(0.05, 1.2), st.floats(0.05, 1.2))
def test_more_friction_never_lowers_the_advice(first_mu, second_mu):
    low_mu, high_mu = sorted((first_mu, second_mu))
    assert advised_kph(low_mu) <= advised_kph(high_mu)


@given(
    mu=st.floats(0.02, 1.4),
    count=st.integers(0, 120),
    radius_m=st.sampled_from([25.0, 60.0, -100.0, 400.0]),
    limit_kph=st.sampled_from(LIMITS_KPH),
    newest_age_s=st.floats(0.0, 3600.0),
    model_live=st.booleans(),
    previous=st.none() | st.integers(1, 18),
)
def test_advice_is_a_multiple_of_five_between_five_and_the_limit(
    *, mu, count, radius_m, limit_kph, newest_age_s, model_live, previous
):
    section = make_section(radius_m=radius_m, speed_limit_mps=kph_to_mps(limit_kph))
    interval = interval_of(mu, count=count, newest_age_s=newest_age_s) if count else None
    previous_mps = None if previous is None else kph_to_mps(min(5.0 * previous, limit_kph))
    advisory = advice(interval, section=section, model_live=model_live, previous_speed_mps=previous_mps)
    speed_kph = mps_to_kph(advisory.speed_mps)
    assert speed_kph == pytest.approx(5.0 * round(speed_kph / 5.0), abs=1e-9)
    assert 5.0 - 1e-9 <= speed_kph <= limit_kph + 1e-9
    assert advisory.valid_for_s > 0.0


@pytest.mark.parametrize("limit_kph", LIMITS_KPH)
def test_a_dry_road_gets_its_speed_limit_whatever_the_rounding(limit_kph):
    section = make_section(radius_m=400.0, speed_limit_mps=kph_to_mps(limit_kph))
    assert advised_kph(0.9, section=section) == pytest.approx(limit_kph)


def test_advice_falls_at_once_and_rises_only_with_a_margin():
    assert advised_kph(mu_for_kph(49.5), previous_kph=50.0) == pytest.approx(45.0)
    assert advised_kph(mu_for_kph(51.0), previous_kph=45.0) == pytest.approx(45.0)
    assert advised_kph(mu_for_kph(52.5), previous_kph=45.0) == pytest.approx(50.0)
    assert advised_kph(mu_for_kph(61.0), previous_kph=45.0) == pytest.approx(55.0)


def test_noise_about_a_step_does_not_make_the_advice_flicker(rng):
    speed_kph, seen = None, []
    for noise_kph in rng.uniform(-0.8, 0.8, 200):
        speed_kph = advised_kph(mu_for_kph(50.5 + noise_kph), previous_kph=speed_kph)
        seen.append(speed_kph)
    assert sum(a != b for a, b in pairwise(seen)) <= 1


def test_the_margin_does_not_keep_the_limit_out_of_reach():
    section = make_section(radius_m=400.0)
    assert advised_kph(0.9, previous_kph=60.0, section=section) == pytest.approx(80.0)


def test_no_model_means_winter_speed_even_with_a_full_window():
    advisory = advice(interval_of(0.9), model_live=False)
    assert (advisory.reason, advisory.speed_mps) == (AdvisoryReason.WINTER_SPEED_NO_MODEL, kph_to_mps(50.0))


@pytest.mark.parametrize("interval", [None, interval_of(0.1, count=9)])
def test_few_vehicles_mean_winter_speed(interval):
    advisory = advice(interval)
    assert (advisory.reason, advisory.speed_mps) == (AdvisoryReason.WINTER_SPEED_FEW_VEHICLES, kph_to_mps(50.0))
    assert advisory.confidence is Confidence.INSUFFICIENT


def test_a_stale_window_means_winter_speed():
    advisory = advice(interval_of(0.9, newest_age_s=1800.0))
    assert (advisory.reason, advisory.speed_mps) == (AdvisoryReason.WINTER_SPEED_STALE_WINDOW, kph_to_mps(50.0))


def test_a_provisional_interval_cannot_raise_the_advice_above_winter_speed():
    advisory = advice(interval_of(0.9, count=20))
    assert advisory.reason is AdvisoryReason.WINTER_SPEED_WHILE_PROVISIONAL
    assert advisory.speed_mps == pytest.approx(kph_to_mps(50.0))


def test_a_provisional_interval_lowers_the_advice_by_its_lower_confidence_bound():
    interval = interval_of(mu_for_kph(48.0), count=20, spread=0.3)
    advisory = advice(interval)
    assert advisory.reason is AdvisoryReason.LOWER_CONFIDENCE_BOUND
    bound_mps = curve_speed_mps(BEND, mu=interval.median_low_mu * 0.8 / 0.9, utilisation_frac=0.6)
    assert mps_to_kph(advisory.speed_mps) == pytest.approx(5.0 * np.floor(mps_to_kph(bound_mps) / 5.0))
    assert mps_to_kph(advisory.speed_mps) < 45.0


def test_a_recommended_interval_may_raise_the_advice_above_winter_speed():
    advisory = advice(interval_of(0.9))
    assert advisory.reason is AdvisoryReason.FRICTION_INTERVAL
    assert advisory.speed_mps > kph_to_mps(50.0)


def test_winter_speed_stays_below_the_limit_of_a_slow_section():
    section = make_section(speed_limit_mps=kph_to_mps(30.0))
    assert mps_to_kph(advice(None, section=section).speed_mps) == pytest.approx(30.0)


def test_advice_is_valid_no_longer_than_the_interval_behind_it():
    assert advice(interval_of(0.5, newest_age_s=1790.0)).valid_for_s == pytest.approx(10.0)
    assert advice(None).valid_for_s == POLICY.valid_for_s


@pytest.mark.parametrize(
    "decisions",
    [{"winter_speed_mps": 1.0}, {"utilisation_frac": 0.0}, {"utilisation_frac": 1.1}, {"rise_margin_mps": -1.0}],
)
def test_a_policy_that_cannot_be_meant_is_refused(decisions):
    with pytest.raises(ValueError, match=r".+"):
        replace(POLICY, **decisions)

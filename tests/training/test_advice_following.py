"""Drivers who follow the advice: who does, how fast they go then, and that the rest are the paper's drivers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.records import AdvisoryReason
from roadgrip.section import RoadSection
from roadgrip.sections import packaged_names, read_section
from rsu_app.domain.advisory import AdvisoryPolicy, curve_speed_mps
from training.advice_following import OBEDIENCE_SPREAD_RATIO, SLOWEST_FRAC, draw_advised_plan, draw_advisory
from vehicle_client.simulator.plan import SPEED_SPREAD_RATIO, PassagePlan, draw_plan

seeds = st.integers(0, 2**32)
roads = st.sampled_from(packaged_names()).map(read_section)
frictions = st.floats(0.2, 0.7)


def planned(seed: int, section: RoadSection, friction_mu: float, compliance_frac: float) -> PassagePlan:
    return draw_advised_plan(
        np.random.default_rng(seed),
        section=section,
        base_friction_mu=friction_mu,
        compliance_frac=compliance_frac,
    )


@given(seed=seeds, section=roads, friction_mu=frictions)
def test_where_nobody_follows_the_drives_are_those_of_the_papers_matrix(
    seed: int, section: RoadSection, friction_mu: float
) -> None:
    usual = draw_plan(np.random.default_rng(seed), section=section, base_friction_mu=friction_mu)
    assert planned(seed, section, friction_mu, 0.0) == usual


@given(seed=seeds, section=roads, friction_mu=frictions)
def test_following_changes_the_speed_and_nothing_else(seed: int, section: RoadSection, friction_mu: float) -> None:
    usual = planned(seed, section, friction_mu, 0.0)
    obedient = planned(seed, section, friction_mu, 1.0)
    assert replace(obedient, target_speed_mps=usual.target_speed_mps) == usual


@given(seed=seeds, section=roads, friction_mu=frictions)
def test_speeds_lie_between_two_fifths_of_the_rated_one_and_the_papers_highest(
    seed: int, section: RoadSection, friction_mu: float
) -> None:
    for compliance_frac in (0.0, 0.5, 1.0):
        speed_mps = planned(seed, section, friction_mu, compliance_frac).target_speed_mps
        assert speed_mps is not None
        rated_mps = section.speed_limit_mps
        assert SLOWEST_FRAC * rated_mps <= speed_mps <= (1.0 + SPEED_SPREAD_RATIO) * rated_mps


@given(seed=seeds, section=roads, friction_mu=frictions)
def test_who_follows_at_half_compliance_follows_at_full(seed: int, section: RoadSection, friction_mu: float) -> None:
    half = planned(seed, section, friction_mu, 0.5)
    assert half in {planned(seed, section, friction_mu, 0.0), planned(seed, section, friction_mu, 1.0)}


def test_half_of_the_drivers_follow_at_half_compliance() -> None:
    section = read_section("s-turn")
    follows = [planned(seed, section, 0.3, 0.5) == planned(seed, section, 0.3, 1.0) for seed in range(400)]
    assert np.mean(follows) == pytest.approx(0.5, abs=0.1)  # four standard deviations


def test_the_slipperier_the_road_the_lower_the_advice() -> None:
    section = read_section("s-turn")
    speeds = []
    for friction_mu in (0.2, 0.35, 0.5, 0.7):
        rngs = (np.random.default_rng(seed) for seed in range(50))
        speeds.append(
            np.mean([draw_advisory(rng, section=section, base_friction_mu=friction_mu).speed_mps for rng in rngs])
        )
    assert speeds == sorted(speeds)
    assert speeds[0] < 0.7 * speeds[-1]


def test_the_advice_rests_on_an_interval_that_is_off_by_what_a_good_units_interval_is_off() -> None:
    section = read_section("s-turn")
    errors = []
    for seed in range(300):
        advisory = draw_advisory(np.random.default_rng(seed), section=section, base_friction_mu=0.4)
        assert advisory.reason is AdvisoryReason.FRICTION_INTERVAL
        assert advisory.interval is not None
        errors.append(advisory.interval.mu_new / 0.4 - 1.0)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.02)
    assert np.std(errors) == pytest.approx(0.05, abs=0.015)


def test_an_obedient_driver_goes_about_as_fast_as_the_curve_speed_of_the_worn_tyre() -> None:
    section = read_section("s-turn")
    safe_mps = curve_speed_mps(section, mu=0.8 * 0.5, utilisation_frac=AdvisoryPolicy().utilisation_frac)
    speeds = [planned(seed, section, 0.5, 1.0).target_speed_mps or 0.0 for seed in range(100)]
    assert max(speeds) <= 1.1 * (1.0 + OBEDIENCE_SPREAD_RATIO) * safe_mps
    assert np.median(speeds) == pytest.approx(safe_mps, rel=0.12)  # rounded down to 5 km/h

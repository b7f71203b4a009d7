"""Friction that changes along the road: where it changes, and what the tyres experience."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.alignment import Element, GradePoint
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from training.friction_profiles import (
    HIGHER_BY_MU,
    PATCH_RATIOS,
    TRANSITION_M,
    has_like_turns,
    patches,
    turnover_m,
    two_frictions,
)
from training.road_design import RoadDesign, designed_section
from vehicle_client.simulator.plan import WEAR_RANGE, FrictionProfile
from vehicle_client.simulator.run import PassagePlan, simulate_passage


@pytest.fixture(scope="module")
def s_turn() -> RoadSection:
    return read_section("s-turn")


def two_turns(first_1pm: float, second_1pm: float) -> RoadSection:
    def arc(curvature_1pm: float) -> Element:
        return Element(length_m=60.0, start_curvature_1pm=curvature_1pm, end_curvature_1pm=curvature_1pm)

    between = Element(length_m=40.0, start_curvature_1pm=first_1pm, end_curvature_1pm=second_1pm)
    design = RoadDesign(
        section_id="two-turns",
        name="two turns",
        elements=(arc(first_1pm), between, arc(second_1pm)),
        grades=(GradePoint(0.0, 0.0),),
        start_heading_rad=0.0,
        origin_m=(570_000.0, 6_822_000.0, 500.0),
        rated_speed_mps=15.0,
        node_step_m=2.0,
    )
    return designed_section(design)


def at(profile: FrictionProfile, station_m: float) -> tuple[float, float]:
    return (
        float(np.interp(station_m, profile.station_m, profile.left_mu)),
        float(np.interp(station_m, profile.station_m, profile.right_mu)),
    )


def test_the_s_turns_over_in_its_middle_where_it_is_straight(s_turn: RoadSection) -> None:
    station_m = turnover_m(s_turn)
    assert station_m == pytest.approx(300.0, abs=5.0)
    profile = s_turn.profile
    assert np.interp(station_m, profile.station_m, profile.curvature_1pm) == pytest.approx(0.0, abs=1e-4)


def test_the_first_turn_grips_better_and_the_second_offers_the_base_friction(s_turn: RoadSection) -> None:
    profile = two_frictions(s_turn, base_friction_mu=0.3)
    middle_m = turnover_m(s_turn)
    assert at(profile, middle_m - TRANSITION_M) == pytest.approx((0.5, 0.5))
    assert at(profile, middle_m) == pytest.approx((0.4, 0.4))
    assert at(profile, middle_m + TRANSITION_M) == pytest.approx((0.3, 0.3))
    assert at(profile, -50.0) == pytest.approx((0.5, 0.5))
    assert at(profile, s_turn.length_m + 50.0) == pytest.approx((0.3, 0.3))


def test_the_slippery_turn_may_come_first(s_turn: RoadSection) -> None:
    profile = two_frictions(s_turn, base_friction_mu=0.3, slippery_first=True)
    middle_m = turnover_m(s_turn)
    assert at(profile, middle_m - TRANSITION_M) == pytest.approx((0.3, 0.3))
    assert at(profile, middle_m + TRANSITION_M) == pytest.approx((0.5, 0.5))


@pytest.mark.parametrize(("second_1pm", "like"), [(-0.02, True), (-0.013, True), (-0.011, False), (0.02, False)])
def test_turns_are_like_each_other_if_the_gentler_one_is_nearly_as_sharp(second_1pm: float, *, like: bool) -> None:
    road = two_turns(0.02, second_1pm)
    assert has_like_turns(road) is like


@pytest.mark.parametrize("base_mu", [0.2, 0.45, 0.7])
def test_wear_cannot_make_the_grippier_turn_the_slipperier_one(base_mu: float) -> None:
    assert WEAR_RANGE[0] * (base_mu + HIGHER_BY_MU) > WEAR_RANGE[1] * base_mu


def test_a_road_that_turns_one_way_has_no_two_frictions() -> None:
    with pytest.raises(ValueError, match="one way only"):
        two_frictions(read_section("long-turn"), base_friction_mu=0.3)


@pytest.mark.sim
def test_the_label_is_the_lower_friction_times_wear(s_turn: RoadSection) -> None:
    profile = two_frictions(s_turn, base_friction_mu=0.5)
    plan = PassagePlan(base_friction_mu=0.5, seed=3, wear_factor=0.9, friction_profile=profile, target_speed_mps=14.0)
    drive = simulate_passage(s_turn, plan)
    assert drive.completed
    assert drive.label_mu == pytest.approx(0.45, rel=1e-9)
    assert drive.truth.friction_mu.max() == pytest.approx(0.63, rel=1e-9)


@given(seed=st.integers(0, 2**32), base_mu=st.floats(0.2, 1.0), count=st.integers(0, 6))
def test_patches_only_take_friction_and_lie_inside_the_section(seed: int, base_mu: float, count: int) -> None:
    section = read_section("s-turn")
    profile = patches(np.random.default_rng(seed), section=section, base_friction_mu=base_mu, patches_count=count)
    both = np.concatenate([profile.left_mu, profile.right_mu])
    assert both.max() <= base_mu
    assert both.min() >= PATCH_RATIOS[0] * base_mu - 1e-12
    assert (both.min() < base_mu) == (count > 0)
    for station_m in (-20.0, section.length_m + 20.0):
        assert at(profile, station_m) == pytest.approx((base_mu, base_mu))


def test_some_patches_lie_under_one_side_of_the_car_and_some_under_both() -> None:
    section = read_section("sharp-turn")
    found = set()
    for seed in range(40):
        profile = patches(np.random.default_rng(seed), section=section, base_friction_mu=0.6, patches_count=1)
        found.add((bool(profile.left_mu.min() < 0.6), bool(profile.right_mu.min() < 0.6)))
    assert found == {(True, False), (False, True), (True, True)}

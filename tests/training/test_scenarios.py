from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from training.random_roads import LENGTH_RANGE_M, RADIUS_RANGE_M, random_section
from training.scenarios import Design, Run, Scenario, Terms, attempted, run_of, surveyed_map
from vehicle_client.simulator.plan import UNSCALED, AmplitudeScales, DriverKind, SensorGrade

TERMS = Terms("test", 1, SensorGrade.IDEAL)


@pytest.fixture(scope="module")
def s_turn() -> RoadSection:
    return read_section("s-turn")


@pytest.fixture(scope="module")
def scenario(s_turn: RoadSection) -> Scenario:
    return Scenario("s-turn", s_turn, attempted(200))


def runs(scenario: Scenario, *, terms: Terms = TERMS, count: int = 200, base_friction_mu: float = 0.3) -> list[Run]:
    return [run_of(terms, scenario, base_friction_mu=base_friction_mu, number=number) for number in range(count)]


def test_no_two_runs_of_a_design_share_their_chances(scenario: Scenario) -> None:
    other = replace(scenario, name="other")
    seeds = [run.plan.seed for one in (scenario, other) for mu in (0.3, 0.35) for run in _at(one, mu)]
    assert len(set(seeds)) == len(seeds)


def _at(scenario: Scenario, mu: float) -> list[Run]:
    return runs(scenario, count=20, base_friction_mu=mu)


def test_another_seed_changes_every_run(scenario: Scenario) -> None:
    one = {run.plan.seed for run in runs(scenario, count=20)}
    other = {run.plan.seed for run in runs(scenario, count=20, terms=replace(TERMS, seed=2))}
    assert not one & other


def test_other_sensors_see_the_same_runs(scenario: Scenario) -> None:
    automotive = replace(TERMS, sensor_grade=SensorGrade.AUTOMOTIVE)
    for ideal, real in zip(runs(scenario, count=20), runs(scenario, count=20, terms=automotive), strict=True):
        assert real.key == ideal.key
        assert replace(real.plan, sensor_grade=SensorGrade.IDEAL) == ideal.plan


def test_a_reacting_driver_is_the_prudent_one_without_a_guess(scenario: Scenario) -> None:
    reacting = runs(scenario, count=20, terms=replace(TERMS, driver_kind=DriverKind.REACTING))
    assert {run.plan.driver.friction_guess_mu for run in reacting} == {inf}
    for prudent, other in zip(runs(scenario, count=20), reacting, strict=True):
        assert other.plan.target_speed_mps == prudent.plan.target_speed_mps
        assert other.plan.driver._replace(friction_guess_mu=0.0) == prudent.plan.driver._replace(friction_guess_mu=0.0)


def test_three_quarters_of_the_vehicles_have_position_fixes(scenario: Scenario) -> None:
    with_gnss = [run.plan.with_gnss for run in runs(scenario)]
    # 200 vehicles: within four standard deviations.
    assert np.mean(with_gnss) == pytest.approx(0.75, abs=0.13)


def test_nobody_has_position_fixes_on_a_road_without_a_place_on_earth(scenario: Scenario) -> None:
    nowhere = replace(scenario, section=replace(scenario.section, anchors=()))
    assert not any(run.plan.with_gnss for run in runs(nowhere, count=20))


def test_two_frictions_are_the_base_friction_and_a_higher_one(scenario: Scenario) -> None:
    profile = runs(replace(scenario, two_frictions=True), count=1)[0].plan.friction_profile
    assert profile is not None
    assert profile.left_mu.min() == pytest.approx(0.3)
    assert profile.left_mu.max() > 0.3


def test_every_run_of_varied_vehicles_has_a_car_of_its_own_and_its_client_knows_its_wheels(scenario: Scenario) -> None:
    varied = runs(replace(scenario, varied_vehicles=True), count=10)
    assert len({run.plan.vehicle for run in varied}) == 10
    assert [run.geometry.wheelbase_m for run in varied] == [run.plan.vehicle.wheelbase_m for run in varied]


def test_who_follows_the_advice_at_one_compliance_follows_at_a_higher_one_and_the_rest_is_unchanged(
    scenario: Scenario,
) -> None:
    def at(compliance_frac: float) -> list[Run]:
        name = f"s-turn-{compliance_frac}"
        return runs(replace(scenario, name=name, compliance_frac=compliance_frac, drawn_as="s-turn"), count=40)

    none, half, all_follow = ([run.plan.target_speed_mps for run in at(share)] for share in (0.0, 0.5, 1.0))
    assert all(some in {usual, told} for usual, some, told in zip(none, half, all_follow, strict=True))
    assert len({*half} & {*none}) > 5
    assert len({*half} & {*all_follow}) > 5
    slowest = min(speed for speed in all_follow if speed is not None)
    assert 0.4 * scenario.section.speed_limit_mps <= slowest < 0.8 * scenario.section.speed_limit_mps


def test_drivers_of_any_speed_are_the_usual_ones_but_for_their_speeds_which_say_nothing_of_friction(
    scenario: Scenario,
) -> None:
    usual, any_speed = runs(scenario, count=60), runs(replace(scenario, any_speed=True), count=60)
    pairs = [(a.plan, b.plan) for a, b in zip(usual, any_speed, strict=True)]
    assert all(replace(one, target_speed_mps=other.target_speed_mps) == other for one, other in pairs)
    share = [(run.plan.target_speed_mps or 0.0) / scenario.section.speed_limit_mps for run in any_speed]
    assert 0.4 <= min(share) < 0.5
    assert 1.1 < max(share) <= 1.2
    assert replace(scenario, any_speed=True).identity != scenario.identity


def test_all_vehicles_with_automotive_sensors_have_one_slightly_wrong_map(s_turn: RoadSection) -> None:
    automotive = replace(TERMS, sensor_grade=SensorGrade.AUTOMOTIVE)
    surveyed = surveyed_map(automotive, s_turn)
    assert surveyed == surveyed_map(replace(automotive, design_name="other"), s_turn)
    error = surveyed.cross_slope_ratio - s_turn.cross_slope_ratio
    assert 0.0 < np.abs(error).max() < 0.03
    assert surveyed_map(TERMS, s_turn) == s_turn


def test_two_scenarios_of_one_name_are_refused(scenario: Scenario) -> None:
    with pytest.raises(ValueError, match="s-turn"):
        Design(TERMS, (scenario, scenario), (0.3,))


def test_random_roads_stay_within_the_papers_range_of_risk() -> None:
    for i in range(60):
        section = random_section(np.random.default_rng([5, i]), section_id=f"road-{i}")
        # The spline through the nodes may bend a little more than the design at the ends of an arc.
        assert LENGTH_RANGE_M[0] - 1.0 <= section.length_m <= LENGTH_RANGE_M[1] + 1.0
        assert 0.85 * RADIUS_RANGE_M[0] <= section.tightest_radius_m <= RADIUS_RANGE_M[1]
        assert 20.0 / 3.6 - 0.01 <= section.speed_limit_mps <= 80.0 / 3.6 + 0.01


def test_larger_disturbances_meet_the_same_drivers(scenario: Scenario) -> None:
    scales = AmplitudeScales(sensors_ratio=2.0, roughness_ratio=0.5)
    for usual, other in zip(
        runs(scenario, count=20), runs(scenario, count=20, terms=replace(TERMS, scales=scales)), strict=True
    ):
        assert other.key == usual.key
        assert other.plan.scales == scales
        assert replace(other.plan, scales=UNSCALED) == usual.plan


def test_scales_are_part_of_a_name_only_where_they_are_not_one() -> None:
    assert str(replace(TERMS, scales=AmplitudeScales())) == repr(TERMS)
    named = {str(replace(TERMS, scales=AmplitudeScales(*scales))) for scales in ((1.0, 1.0), (2.0, 1.0), (1.0, 2.0))}
    assert len(named) == 3


def test_a_map_errs_as_much_as_the_scale_says(s_turn: RoadSection) -> None:
    terms = replace(TERMS, sensor_grade=SensorGrade.AUTOMOTIVE)
    bank = [
        surveyed_map(replace(terms, scales=AmplitudeScales(sensors_ratio=ratio)), s_turn).profile.cross_slope_ratio
        for ratio in (0.0, 1.0, 2.0)
    ]
    assert np.array_equal(bank[0], s_turn.profile.cross_slope_ratio)
    assert np.std(bank[2] - bank[0]) == pytest.approx(2.0 * np.std(bank[1] - bank[0]), rel=0.05)

from __future__ import annotations

import numpy as np
import pytest

from training.designs import BASE_FRICTIONS_MU, DESIGNS, Size, named_design
from training.friction_profiles import has_like_turns
from training.scenarios import Design, Quota, Terms
from vehicle_client.simulator.plan import SensorGrade


def design(name: str, size: Size | None = None, *, seed: int = 4) -> Design:
    return named_design(name, Terms(name, seed, SensorGrade.IDEAL), size or Size(5, random_roads_count=3))


def test_the_papers_matrix_is_four_scenarios_at_eleven_frictions_with_twenty_tries_per_run() -> None:
    paper = design("paper", Size(1000))
    assert [s.name for s in paper.scenarios] == ["long-turn", "s-turn", "sharp-turn", "s-turn-two-frictions"]
    assert paper.base_frictions_mu == (0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7)
    assert {s.quota for s in paper.scenarios} == {Quota(20_000, 1000)}
    assert [s.two_frictions for s in paper.scenarios] == [False, False, False, True]


@pytest.mark.parametrize("name", DESIGNS)
def test_every_design_of_the_table_can_be_made_and_planned(name: str) -> None:
    made = design(name, Size(5, random_roads_count=24))
    assert made.name == name
    assert len(made.scenarios) > 1


def test_varied_vehicles_drive_the_papers_scenarios() -> None:
    varied, paper = design("varied-vehicles").scenarios, design("paper").scenarios
    assert [s.name for s in varied] == [s.name for s in paper]
    assert all(s.varied_vehicles for s in varied)


def test_the_advice_is_followed_by_none_half_and_all_in_every_scenario() -> None:
    scenarios = design("advice").scenarios
    assert len(scenarios) == 12
    assert {s.compliance_frac for s in scenarios if s.drawn_as == "s-turn-two-frictions"} == {0.0, 0.5, 1.0}
    assert all(s.two_frictions == (s.drawn_as == "s-turn-two-frictions") for s in scenarios)


def test_manoeuvres_reach_from_a_fifth_to_one() -> None:
    made = design("manoeuvres")
    assert (min(made.base_frictions_mu), max(made.base_frictions_mu)) == (0.2, 1.0)
    assert set(np.round(BASE_FRICTIONS_MU, 2)) <= set(made.base_frictions_mu)


def test_more_random_roads_leave_the_first_ones_as_they_are() -> None:
    few = [s.identity for s in design("random-roads", Size(5, random_roads_count=4)).scenarios]
    many = [s.identity for s in design("random-roads", Size(9, random_roads_count=8)).scenarios]
    assert many[:4] == few
    assert len({s.section.version for s in design("random-roads", Size(5, random_roads_count=8)).scenarios}) == 8


def test_another_seed_makes_other_random_roads() -> None:
    one, other = (design("random-roads", seed=seed).scenarios[0].section.version for seed in (1, 2))
    assert one != other


def test_the_mixed_design_has_the_papers_roads_with_many_vehicles_and_random_ones_with_a_few() -> None:
    made = design("mixed", Size(250, random_roads_count=120, random_runs_count=4))
    assert len(made.scenarios) == 123
    counts = [s.quota for s in made.scenarios]
    assert counts == [Quota(250)] * 3 + [Quota(4)] * 120


def test_the_default_bundle_adds_a_quarter_of_drives_at_any_speed_and_as_many_on_like_turns_of_two_frictions() -> None:
    made = design("default-bundle", Size(10, random_roads_count=24, random_runs_count=2)).scenarios
    usual = [s for s in made if not s.any_speed and not s.two_frictions]
    any_speed = [s for s in made if s.any_speed]
    two_frictions = [s for s in made if s.two_frictions]
    assert len(usual) + len(any_speed) + len(two_frictions) == len(made)
    assert [s.section for s in usual] == [s.section for s in any_speed]
    assert all(s.name.endswith("-any-speed") for s in any_speed)
    assert all(s.name.endswith("-two-frictions") for s in two_frictions)
    assert [s.quota for s in any_speed] == [Quota(3)] * 3 + [Quota(1)] * 24
    assert [(s.section, s.quota) for s in two_frictions] == [
        (s.section, s.quota) for s in usual if has_like_turns(s.section)
    ]


def test_on_roads_of_two_frictions_either_turn_may_be_the_slippery_one() -> None:
    made = design("random-roads-two-frictions", Size(1, random_roads_count=60)).scenarios
    assert {s.slippery_first for s in made} == {False, True}
    assert all(s.two_frictions and has_like_turns(s.section) for s in made)
    assert len({s.identity for s in made}) == len(made)

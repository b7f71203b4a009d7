from __future__ import annotations

from collections import Counter
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest

from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from training.random_roads import LENGTH_RANGE_M, RADIUS_RANGE_M, random_section
from training.scenarios import (
    BASE_FRICTIONS_MU,
    Design,
    mixed_design,
    paper_roads_design,
    runs_of,
    shards_of,
)
from vehicle_client.simulator.plan import DriverKind, SensorGrade


@pytest.fixture(scope="module")
def s_turn() -> RoadSection:
    return read_section("s-turn")


def design_of(section: RoadSection, *, runs_count: int = 25, seed: int = 1) -> Design:
    return paper_roads_design((section,), runs_count=runs_count, sensor_grade=SensorGrade.IDEAL, seed=seed)


def test_the_papers_matrix_has_eleven_frictions_from_a_fifth_to_seven_tenths() -> None:
    assert BASE_FRICTIONS_MU == (0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7)


def test_the_shards_of_a_design_hold_every_run_once(s_turn: RoadSection) -> None:
    design = design_of(s_turn)
    keys = Counter(run.key for shard in shards_of(design) for run in runs_of(shard))
    assert len(keys) == design.runs_count == 25 * 11
    assert set(keys.values()) == {1}


def test_a_run_does_not_change_when_the_design_grows(s_turn: RoadSection) -> None:
    few = {run.key: run.plan for shard in shards_of(design_of(s_turn, runs_count=3)) for run in runs_of(shard)}
    many = {run.key: run.plan for shard in shards_of(design_of(s_turn, runs_count=40)) for run in runs_of(shard)}
    assert all(many[key] == plan for key, plan in few.items())


def test_another_seed_changes_every_run(s_turn: RoadSection) -> None:
    one = [run.plan.seed for run in runs_of(shards_of(design_of(s_turn, seed=1))[0])]
    other = [run.plan.seed for run in runs_of(shards_of(design_of(s_turn, seed=2))[0])]
    assert not set(one) & set(other)


@pytest.mark.parametrize(
    "changed",
    [
        {"name": "mixed"},
        {"seed": 2},
        {"sensor_grade": SensorGrade.AUTOMOTIVE},
        {"driver_kind": DriverKind.REACTING},
        {"base_frictions_mu": (0.2, 0.3)},
    ],
)
def test_a_shard_with_other_runs_has_another_file(s_turn: RoadSection, changed: dict[str, Any]) -> None:
    design = design_of(s_turn)
    assert shards_of(replace(design, **changed))[0].name != shards_of(design)[0].name


def test_a_shard_on_a_road_that_was_mapped_anew_has_another_file(s_turn: RoadSection) -> None:
    anew = replace(s_turn, speed_limit_mps=s_turn.speed_limit_mps + 1.0)
    assert shards_of(design_of(anew))[0].name != shards_of(design_of(s_turn))[0].name


def test_runs_are_planned_as_the_design_says(s_turn: RoadSection) -> None:
    design = replace(design_of(s_turn), driver_kind=DriverKind.REACTING)
    plans = [run.plan for shard in shards_of(design) for run in runs_of(shard)]
    assert {plan.driver.friction_guess_mu for plan in plans} == {inf}  # a reacting driver guesses nothing
    assert {plan.sensor_grade for plan in plans} == {SensorGrade.IDEAL}
    # 275 vehicles, three quarters of them with position fixes: within four standard deviations.
    assert sum(plan.with_gnss for plan in plans) / len(plans) == pytest.approx(0.75, abs=0.11)


def test_random_roads_stay_within_the_papers_range_of_risk() -> None:
    for i in range(60):
        section = random_section(np.random.default_rng([5, i]), section_id=f"road-{i}")
        # The spline through the nodes may bend a little more than the design at the ends of an arc.
        assert LENGTH_RANGE_M[0] - 1.0 <= section.length_m <= LENGTH_RANGE_M[1] + 1.0
        assert 0.85 * RADIUS_RANGE_M[0] <= section.tightest_radius_m <= RADIUS_RANGE_M[1]
        assert 20.0 / 3.6 - 0.01 <= section.speed_limit_mps <= 80.0 / 3.6 + 0.01


def test_the_random_roads_of_a_design_are_the_same_each_time_and_differ_from_each_other(s_turn: RoadSection) -> None:
    def versions() -> list[str]:
        design = mixed_design(
            (s_turn,),
            runs_count=1,
            random_roads_count=8,
            random_runs_count=1,
            sensor_grade=SensorGrade.IDEAL,
            seed=4,
        )
        return [road.section.version for road in design.roads]

    assert versions() == versions()
    assert len(set(versions())) == 9

"""In which pieces a design is driven, judged with made-up completion rates and no drives."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.sections import read_section
from training.scenarios import Design, Quota, Scenario, Terms, attempted, kept
from training.schedule import (
    FIRST_SHARD_ATTEMPTS_COUNT,
    LATER_SHARD_ATTEMPTS_COUNT,
    Block,
    Counts,
    Shard,
    further_attempts_count,
    inside_quota,
    next_round,
    runs_of,
    streams_of,
)
from vehicle_client.simulator.plan import DriverKind, SensorGrade

SECTION = read_section("sharp-turn")
TERMS = Terms("test", 1, SensorGrade.IDEAL)


def design_of(*quotas: Quota, frictions_mu: tuple[float, ...] = (0.2, 0.4, 0.6)) -> Design:
    scenarios = tuple(Scenario(f"scenario-{i}", SECTION, quota) for i, quota in enumerate(quotas))
    return Design(TERMS, scenarios, frictions_mu)


def first_rounds(design: Design) -> list[Shard]:
    return [
        shard for cells in streams_of(design) for shard in next_round(design.terms, cells, [Counts() for _ in cells])
    ]


def attempts_of(shards: list[Shard]) -> Counter[tuple[int, int]]:
    return Counter((b.cell_index, n) for shard in shards for b in shard.blocks for n in range(b.first, b.last))


def test_the_first_round_holds_every_wanted_run_once() -> None:
    design = design_of(kept(30), attempted(500), attempted(4))
    attempts = attempts_of(first_rounds(design))
    assert set(attempts.values()) == {1}
    assert Counter(cell for cell, _ in attempts) == Counter({0: 30, 1: 30, 2: 30}) + Counter(
        {3: 500, 4: 500, 5: 500}
    ) + Counter({6: 4, 7: 4, 8: 4})


def test_shards_are_neither_tiny_nor_large() -> None:
    # A thousand runs a cell, and a hundred roads of twelve runs each.
    for design in (design_of(kept(1000)), design_of(*[attempted(4)] * 100)):
        sizes = [shard.attempts_count for shard in first_rounds(design)]
        assert max(sizes) <= FIRST_SHARD_ATTEMPTS_COUNT
        assert np.mean(sizes) > 0.4 * FIRST_SHARD_ATTEMPTS_COUNT


def test_a_scenario_that_is_added_leaves_runs_and_files_of_the_others_as_they_are() -> None:
    one, two = design_of(kept(100)), design_of(kept(100), kept(100))
    names = {shard.name for shard in first_rounds(two)}
    assert {shard.name for shard in first_rounds(one)} <= names
    runs = {run.key: run for shard in first_rounds(two) for block in shard.blocks for run in runs_of(block, TERMS)}
    for shard in first_rounds(one):
        assert all(runs[run.key].plan == run.plan for block in shard.blocks for run in runs_of(block, TERMS))


@given(kept_frac=st.floats(0.0, 1.0), wanted=st.integers(1, 1500), seed=st.integers(0, 2**32))
def test_a_cell_ends_with_its_last_wanted_run_or_at_its_limit_after_few_rounds(
    kept_frac: float, wanted: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    quota = kept(wanted)
    done, rounds_count = Counts(), 0
    while more := further_attempts_count(quota, done):
        done = Counts(done.attempts_count + more, done.kept_count + int(rng.binomial(more, kept_frac)))
        rounds_count += 1
    assert done.kept_count >= wanted or done.attempts_count == quota.attempts_limit_count
    assert done.attempts_count <= quota.attempts_limit_count
    assert rounds_count <= 30


def test_little_more_is_driven_than_needed() -> None:
    quota = kept(1000)
    after_half = further_attempts_count(quota, Counts(1000, 500))
    assert 1000 < after_half < 1200


def test_later_rounds_go_on_where_the_one_before_ended() -> None:
    design = design_of(kept(100))
    (cells,) = streams_of(design)
    shards = next_round(TERMS, cells, [Counts(100, 100), Counts(100, 10), Counts(100, 99)])
    assert {(b.cell_index, b.first) for shard in shards for b in shard.blocks if b.first <= 100} == {(1, 100), (2, 100)}
    assert max(shard.attempts_count for shard in shards) <= LATER_SHARD_ATTEMPTS_COUNT
    assert next_round(TERMS, cells, [Counts(100, 100)] * 3) == ()


def test_a_cell_is_cut_at_the_attempt_that_gives_its_last_wanted_run() -> None:
    outcome = np.array([False, True, False, True, False, True])
    assert inside_quota(outcome, 2).tolist() == [True, True, True, True, False, False]
    assert inside_quota(outcome, 4).all()
    assert inside_quota(outcome, None).all()


@pytest.mark.parametrize(
    "changed",
    [
        {"design_name": "mixed"},
        {"seed": 2},
        {"sensor_grade": SensorGrade.AUTOMOTIVE},
        {"driver_kind": DriverKind.REACTING},
    ],
)
def test_a_shard_under_other_terms_has_another_file(changed: dict[str, Any]) -> None:
    shard = first_rounds(design_of(kept(5)))[0]
    assert replace(shard, terms=replace(TERMS, **changed)).name != shard.name


@pytest.mark.parametrize(
    "changed",
    [
        {"base_friction_mu": 0.25},
        {"first": 1},
        {"last": 4},
        {"scenario": Scenario("scenario-0", SECTION, kept(5), varied_vehicles=True)},
        {"scenario": Scenario("scenario-0", replace(SECTION, speed_limit_mps=7.0), kept(5))},
    ],
)
def test_a_shard_with_other_runs_has_another_file(changed: dict[str, Any]) -> None:
    block = Block(0, Scenario("scenario-0", SECTION, kept(5)), 0.2, 0, 5)
    assert Shard(TERMS, (replace(block, **changed),)).name != Shard(TERMS, (block,)).name

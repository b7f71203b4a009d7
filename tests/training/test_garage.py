"""Cars of a garage learn once, keep it, and tell of a drive by what they have learned."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.errors import ConfigurationError
from roadgrip.features import NEWEST_TABLE, PAPER_TABLE
from roadgrip.sections import read_section
from training import cars, everyday, garage
from training.cars import Garage, cars_of
from training.everyday import schooled
from training.garage import memories, remembering_groups_count, school
from training.passage_rows import drive_shard
from training.scenarios import Design, Scenario, Terms, attempted, run_of
from training.schedule import Block, Shard
from training.simulation import GARAGE_FOLDER_NAME, Progress, drive_design
from training.workers import InThisProcess
from vehicle_client.estimation.grip.memory import AUTOMOTIVE_STDS, new_memory
from vehicle_client.simulator.plan import SensorGrade

TERMS = Terms("test", 11, SensorGrade.AUTOMOTIVE, garage=Garage(3, 2))
LIVES = Garage(3, 2).cars(TERMS.seed, TERMS.sensor_grade)
S_TURN = Scenario("s-turn", read_section("s-turn"), attempted(4))


@pytest.fixture
def taught_groups(monkeypatch):
    """Count the groups that learn; what they learn is made up."""
    groups = []

    def made_up(lives, group):
        groups.append(group)
        memory = new_memory(handling_std_ratio=0.01, sensor_stds=AUTOMOTIVE_STDS)
        return tuple(replace(memory, passages_count=group) for _ in cars_of(lives, group))

    monkeypatch.setattr(garage, "schooled", made_up)
    memories.cache_clear()
    yield groups
    memories.cache_clear()


def taught(folder, terms=TERMS):
    done = []
    school(terms, folder, InThisProcess(), on_group=lambda: done.append(1))
    assert len(done) == remembering_groups_count(terms)


def test_cars_learn_once_and_those_from_the_dealer_remember_nothing(tmp_path, taught_groups):
    taught(tmp_path)
    taught(tmp_path)
    assert taught_groups == [0, 1]
    found = memories(TERMS, tmp_path)
    assert {car.sensor_seed for group in (0, 1) for car in cars_of(LIVES, group)} == set(found)
    assert {found[car.sensor_seed].passages_count for car in cars_of(LIVES, 1)} == {1}


def test_a_bigger_garage_keeps_the_cars_there_were(tmp_path, taught_groups):
    taught(tmp_path)
    taught(tmp_path, replace(TERMS, garage=Garage(4, 4)))
    assert taught_groups == [0, 1, 2, 3]


@pytest.mark.parametrize("damage", ["cut short", "of other code"])
def test_what_is_damaged_or_of_other_code_is_learned_anew(tmp_path, taught_groups, damage):
    taught(tmp_path)
    first = min(tmp_path.iterdir())
    text = first.read_text()
    first.write_text(text[:100] if damage == "cut short" else text.replace('"code_digest": "', '"code_digest": "x'))
    taught(tmp_path)
    assert taught_groups == [0, 1, 0]


def test_cars_that_have_not_learned_yet_are_no_cars_that_remember_nothing(tmp_path, taught_groups):
    with pytest.raises(ConfigurationError, match="has not learned yet"):
        memories(TERMS, tmp_path)


def test_a_design_without_a_garage_needs_none(tmp_path, taught_groups):
    plain = replace(TERMS, garage=None)
    taught(tmp_path / "none", plain)
    assert not (tmp_path / "none").exists()
    assert memories(plain, tmp_path) == {}


def test_runs_take_cars_of_the_garage_and_keep_their_drivers_and_roads():
    plain = replace(TERMS, garage=None)
    seeds = {car.sensor_seed for group in range(3) for car in cars_of(LIVES, group)}
    runs = [run_of(TERMS, S_TURN, base_friction_mu=0.4, number=number) for number in range(20)]
    usual = [run_of(plain, S_TURN, base_friction_mu=0.4, number=number) for number in range(20)]
    assert {run.plan.sensor_seed for run in runs} <= seeds
    assert len({run.plan.sensor_seed for run in runs}) > 5
    assert [replace(run, plan=replace(run.plan, sensor_seed=None)) for run in runs] == usual


def test_a_fleet_comes_from_a_garage_of_a_fleet():
    fleet = replace(TERMS, garage=Garage(3, 2, varied_vehicles=True))
    varied = replace(S_TURN, varied_vehicles=True)
    made = {run_of(fleet, varied, base_friction_mu=0.4, number=number).handling.mass_kg for number in range(20)}
    assert len(made) > 5
    for terms, scenario in ((fleet, S_TURN), (TERMS, varied)):
        with pytest.raises(ValueError, match="other kinds of cars"):
            run_of(terms, scenario, base_friction_mu=0.4, number=0)


def test_designs_are_others_with_another_garage():
    designs = [
        Design(replace(TERMS, garage=one), (S_TURN,), (0.3,))
        for one in (None, Garage(3, 2), Garage(3, 3), Garage(4, 2))
    ]
    assert len({design.identity for design in designs}) == 4


@pytest.mark.sim
@pytest.mark.xdist_group("sim")
def test_what_is_remembered_changes_the_grip_features_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(everyday, "EVERYDAY_COUNT", 1)
    monkeypatch.setattr(cars, "CARS_COUNT", 2)
    memories.cache_clear()
    terms = replace(TERMS, garage=Garage(1, 1))
    design = Design(terms, (replace(S_TURN, quota=attempted(2)),), (0.5,))
    told: list[Progress] = []
    driven = drive_design(design, tmp_path, workers_count=1, on_progress=told.append)
    learned = memories(terms, tmp_path / GARAGE_FOLDER_NAME)
    assert {memory.passages_count for memory in learned.values()} <= {0, 1}
    forgetful = drive_shard(Shard(terms, (Block(0, S_TURN, 0.5, 0, 2),)))
    here, there = (runs.features[driven.usable] for runs in (driven, forgetful))
    changed = np.flatnonzero(~np.isclose(here, there, rtol=1e-5, atol=1e-6).all(axis=0))
    names = {NEWEST_TABLE.names[column] for column in changed.tolist()}
    assert names
    assert not names & set(PAPER_TABLE.names)
    assert told[-1].done_count == told[-1].wanted_count
    memories.cache_clear()


@pytest.mark.sim
@pytest.mark.xdist_group("sim")
def test_cars_learn_the_same_again(monkeypatch):
    monkeypatch.setattr(everyday, "EVERYDAY_COUNT", 1)
    monkeypatch.setattr(cars, "CARS_COUNT", 2)
    first, again = schooled(LIVES, 0), schooled(LIVES, 0)
    assert first == again
    assert any(memory.passages_count == 1 for memory in first)
    assert not np.allclose(first[0].mean, first[1].mean)

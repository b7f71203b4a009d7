"""A client's memory: read at the start, written after each lesson, and never in the way."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vehicle_client.synthetic import drive_over, road, s_turn, with_noise
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.shell.car_memory import ASIDE_SUFFIX, FOREIGN_SUFFIX, first_memory, keep_memory, memory_of
from vehicle_client.shell.live.learner import Learner
from vehicle_client.vehicle_profile import PAPER_VEHICLE, scaled_to

NEW = first_memory(PAPER_VEHICLE)
ROAD = road(s_turn)
OTHER = replace(PAPER_VEHICLE, handling=scaled_to(2500.0))


@pytest.fixture(scope="module")
def passage():
    trace, _ = drive_over(s_turn)
    made = summarise_passage(with_noise(trace, np.random.default_rng(1)), ROAD, memory=NEW)
    assert isinstance(made, Summarised)
    return made


@pytest.fixture
def path(tmp_path):
    return tmp_path / "car" / "memory.json"


def test_without_a_file_nothing_is_learned(passage):
    learner = Learner(None, PAPER_VEHICLE)
    assert learner.memory is None
    assert not learner.learn(passage, NEW)
    assert (learner.state(), learner.notes) == ({}, [])


def test_every_lesson_is_in_the_file_before_the_next_passage(path, passage):
    learner = Learner(path, PAPER_VEHICLE)
    for count in (1, 2, 3):
        assert learner.learn(passage, learner.memory or NEW)
        # Whoever loses its power now has lost nothing.
        again = Learner(path, PAPER_VEHICLE)
        assert again.memory == learner.memory
        assert again.state() == {"memory_passages": count}
        assert again.notes == []


def test_a_passage_that_teaches_nothing_writes_nothing(path, passage):
    blind = replace(passage, sensed=replace(passage.sensed, absent=("accel_y_mps2", "yaw_rate_radps")))
    learner = Learner(path, PAPER_VEHICLE)
    assert not learner.learn(blind, NEW)
    assert not path.exists()


@pytest.mark.parametrize("foreign", [False, True])
def test_a_damaged_file_and_that_of_another_car_are_moved_aside_with_a_note(path, passage, foreign):
    path.parent.mkdir()
    if foreign:
        keep_memory(path, first_memory(OTHER), OTHER)
    else:
        path.write_bytes(b"{")
    learner = Learner(path, PAPER_VEHICLE)
    assert learner.memory == NEW
    ((event, what),) = [(note["event"], note["what"]) for note in learner.notes]
    assert event == "memory_moved_aside"
    assert ("declared otherwise" in what) == foreign
    assert path.with_name(path.name + (FOREIGN_SUFFIX if foreign else ASIDE_SUFFIX)).exists()
    assert learner.learn(passage, NEW)
    assert memory_of(path, PAPER_VEHICLE).passages_count == 1


def test_a_file_that_cannot_be_read_is_left_and_nothing_is_learned(path, passage):
    path.mkdir(parents=True)
    learner = Learner(path, PAPER_VEHICLE)
    assert learner.memory is None
    assert [note["event"] for note in learner.notes] == ["memory_off"]
    assert not learner.learn(passage, NEW)
    assert path.is_dir()


def test_a_full_disk_costs_the_file_but_not_what_the_car_knows(path, passage, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    learner = Learner(path, PAPER_VEHICLE)
    monkeypatch.setattr("vehicle_client.shell.live.learner.keep_memory", full)
    with pytest.raises(OSError, match="No space"):
        learner.learn(passage, NEW)
    assert learner.state() == {"memory_passages": 1}
    monkeypatch.undo()
    assert learner.learn(passage, NEW)
    assert memory_of(path, PAPER_VEHICLE).passages_count == 2

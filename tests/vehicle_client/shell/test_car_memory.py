"""The file of a car's memory, and what may happen to it."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from roadgrip.errors import ConfigurationError
from roadgrip.features import NEWEST_TABLE
from tests.vehicle_client.synthetic import drive_over, road, s_turn, with_noise
from vehicle_client import pipeline
from vehicle_client.estimation.grip.memory import new_memory
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.shell import car_memory
from vehicle_client.shell.car_memory import (
    ASIDE_SUFFIX,
    FOREIGN_SUFFIX,
    LIMIT_BYTES,
    first_memory,
    forget_memory,
    keep_memory,
    learned,
    memory_of,
    memory_or_new,
    read_kept,
)
from vehicle_client.vehicle_profile import PAPER_VEHICLE, scaled_to

NEW = first_memory(PAPER_VEHICLE)
TAUGHT = replace(NEW, mean=(1e-4,) * len(NEW.mean), passages_count=3)
HEAVIER = replace(PAPER_VEHICLE, handling=scaled_to(2500.0))
ROAD = road(s_turn)
BEST = NEWEST_TABLE.index("grip_all_best_mu")


def never(message):
    raise AssertionError(message)


@cache
def a_passage(seed=1) -> Summarised:
    trace, _ = drive_over(s_turn)
    made = summarise_passage(with_noise(trace, np.random.default_rng(seed)), ROAD, memory=NEW)
    assert isinstance(made, Summarised)
    return made


@pytest.fixture
def path(tmp_path):
    return tmp_path / "memory.json"


def test_a_car_that_was_never_driven_starts_anew(path):
    assert memory_or_new(path, PAPER_VEHICLE, on_moved=never) == memory_of(path, PAPER_VEHICLE) == NEW
    assert not path.exists()


def test_what_was_kept_is_there_again(path):
    for memory in (TAUGHT, NEW):
        keep_memory(path, memory, PAPER_VEHICLE)
        assert memory_or_new(path, PAPER_VEHICLE, on_moved=never) == memory_of(path, PAPER_VEHICLE) == memory


def test_how_well_a_vehicle_is_declared_is_where_its_memory_starts():
    first = first_memory(replace(PAPER_VEHICLE, handling_std_ratio=0.03))
    assert first == new_memory(handling_std_ratio=0.03)


def kept_text(path, **changes):
    keep_memory(path, TAUGHT, PAPER_VEHICLE)
    return json.dumps(json.loads(path.read_text(encoding="utf-8")) | changes).encode()


DAMAGES = {
    "empty": lambda _: b"",
    "noise": lambda _: b"\xff\x00",
    "cut": lambda path: kept_text(path)[:300],
    "long": lambda path: b" " * LIMIT_BYTES + kept_text(path),
    "deep": lambda _: b"[" * 90_000,
    "a list": lambda _: b"[]",
    "another file of ours": lambda path: kept_text(path, what="a section"),
    "no constants": lambda path: kept_text(path, memory={}),
    "no object": lambda path: kept_text(path, memory=5),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_file_is_moved_aside_and_told_of_or_refused_and_left(path, damage):
    data = damage(path)
    path.write_bytes(data)
    with pytest.raises(ConfigurationError, match="memory"):
        memory_of(path, PAPER_VEHICLE)
    assert path.read_bytes() == data
    told: list[str] = []
    assert memory_or_new(path, PAPER_VEHICLE, on_moved=told.append) == NEW
    assert len(told) == 1
    assert str(path) in told[0]
    assert path.with_name(path.name + ASIDE_SUFFIX).read_bytes() == data
    keep_memory(path, TAUGHT, PAPER_VEHICLE)
    assert memory_or_new(path, PAPER_VEHICLE, on_moved=never) == TAUGHT


@pytest.mark.parametrize("other", [HEAVIER, replace(PAPER_VEHICLE, handling_std_ratio=0.02)])
def test_the_memory_of_another_vehicle_is_moved_aside_and_told_of_or_refused_and_left(path, other):
    keep_memory(path, TAUGHT, PAPER_VEHICLE)
    data = path.read_bytes()
    with pytest.raises(ConfigurationError, match="declared otherwise"):
        memory_of(path, other)
    assert path.read_bytes() == data
    told: list[str] = []
    assert memory_or_new(path, other, on_moved=told.append) == first_memory(other)
    assert len(told) == 1
    assert path.with_name(path.name + FOREIGN_SUFFIX).read_bytes() == data


def test_a_memory_that_starts_elsewhere_than_its_vehicle_is_another_ones(path):
    keep_memory(path, new_memory(handling_std_ratio=0.3), PAPER_VEHICLE)
    with pytest.raises(ConfigurationError, match="declared otherwise"):
        memory_of(path, PAPER_VEHICLE)


def test_another_name_is_the_same_vehicle(path):
    keep_memory(path, TAUGHT, PAPER_VEHICLE)
    assert memory_of(path, replace(PAPER_VEHICLE, name="our red one")) == TAUGHT


def test_a_power_cut_while_it_is_written_leaves_the_memory_before(path, monkeypatch):
    keep_memory(path, TAUGHT, PAPER_VEHICLE)

    def cut(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("vehicle_client.shell.whole_file.os.fsync", cut)
    with pytest.raises(KeyboardInterrupt):
        keep_memory(path, replace(TAUGHT, passages_count=4), PAPER_VEHICLE)
    assert memory_or_new(path, PAPER_VEHICLE, on_moved=never) == TAUGHT


def test_the_file_is_small_and_does_not_grow(path):
    sizes = []
    memory = NEW
    for _ in range(3):
        memory = learned(a_passage(), PAPER_VEHICLE, memory=memory, seen_with=memory)
        keep_memory(path, memory, PAPER_VEHICLE)
        sizes.append(path.stat().st_size)
    assert max(sizes) < 10_000


def test_forgetting_leaves_nothing_of_it(path):
    for suffix in ("", ASIDE_SUFFIX, FOREIGN_SUFFIX):
        keep_memory(path.with_name(path.name + suffix), TAUGHT, PAPER_VEHICLE)
    assert forget_memory(path)
    assert list(path.parent.iterdir()) == []
    assert not forget_memory(path)


def test_what_is_no_memory_is_not_removed(path):
    path.write_text("a recording of a drive", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="no memory"):
        forget_memory(path)
    assert path.exists()


def test_a_passage_teaches_and_the_friction_is_the_cars_own(monkeypatch):
    asked = []

    def teach(sensed, memory, **given):
        asked.append(given["friction_mu"])
        return pipeline.memory_after(sensed, memory, **given)

    monkeypatch.setattr(car_memory, "memory_after", teach)
    after = learned(a_passage(), PAPER_VEHICLE, memory=NEW, seen_with=NEW)
    assert after.passages_count == 1
    assert asked == [a_passage().summary.values[BEST]]
    # Seen with another memory than the one there is now: its best friction is found again with this one.
    apart = learned(a_passage(2), PAPER_VEHICLE, memory=after, seen_with=NEW)
    anew = summarise_passage(
        with_noise(drive_over(s_turn)[0], np.random.default_rng(2)), ROAD, memory=after, vehicle=PAPER_VEHICLE.geometry
    )
    assert isinstance(anew, Summarised)
    assert apart == learned(anew, PAPER_VEHICLE, memory=after, seen_with=after)
    assert asked[1] == pytest.approx(asked[2])


def test_a_car_without_the_sensors_learns_nothing():
    made = a_passage()
    blind = replace(made, sensed=replace(made.sensed, absent=("accel_y_mps2", "yaw_rate_radps")))
    assert learned(blind, PAPER_VEHICLE, memory=NEW, seen_with=NEW) is NEW


def test_a_lesson_that_leads_nowhere_is_not_taken():
    made = a_passage()
    broken = replace(made, sensed=replace(made.sensed, steer_rad=np.full_like(made.sensed.steer_rad, np.nan)))
    assert learned(broken, PAPER_VEHICLE, memory=NEW, seen_with=NEW) is NEW


def test_a_file_tells_whose_memory_it_is(path):
    keep_memory(path, TAUGHT, PAPER_VEHICLE)
    kept = read_kept(path)
    assert kept is not None
    assert (kept.vehicle_name, kept.memory) == (PAPER_VEHICLE.name, TAUGHT)

"""A client with a memory as a real process: what it keeps when its power goes, and that it drives on without one."""

import json
from functools import partial
from pathlib import Path

import pytest

from roadgrip.section_file import section_to_json
from tests.vehicle_client.shell.live.cars import ROAD, Car, a_drive
from vehicle_client.shell.car_memory import ASIDE_SUFFIX, memory_of
from vehicle_client.vehicle_profile import PAPER_VEHICLE

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]


@pytest.fixture
def options(tmp_path: Path) -> tuple[str, ...]:
    (tmp_path / "known.json").write_text(section_to_json(ROAD), encoding="utf-8")
    return ("--beacons", "none", "--section", str(tmp_path / "known.json"))


def passages_in(path: Path) -> int:
    return memory_of(path, PAPER_VEHICLE).passages_count


def holds(path: Path, count: int) -> bool:
    return path.exists() and passages_in(path) == count


def test_a_car_that_loses_its_power_after_each_passage_loses_no_lesson(tmp_path: Path, options: tuple[str, ...]):
    path = tmp_path / "car" / "memory.json"
    for count in (1, 2, 3):
        with Car(tmp_path / "car", a_drive(seed=count), *options, "--memory", str(path)) as car:
            car.wait_for(partial(holds, path, count))
            car.kill()
        (started,) = car.events("started")
        assert started["memory_passages"] == count - 1


def test_a_damaged_memory_is_moved_aside_told_and_counted_and_the_car_drives_on(
    tmp_path: Path, options: tuple[str, ...]
):
    path = tmp_path / "car" / "memory.json"
    path.parent.mkdir()
    path.write_bytes(b"\x00" * 100)
    with Car(tmp_path / "car", a_drive(), *options, "--memory", str(path), "--once") as car:
        car.wait_for(lambda: car.process.poll() == 0)
    assert len(car.events("memory_moved_aside")) == 1
    (stopped,) = car.events("stopped")
    assert (stopped["memory_moved_aside"], stopped["lessons"], stopped["memory_passages"]) == (1, 1, 1)
    assert len(car.events("passage")) == 1
    assert path.with_name(path.name + ASIDE_SUFFIX).exists()
    assert passages_in(path) == 1


def test_without_the_option_nothing_is_learned_or_written(tmp_path: Path, options: tuple[str, ...]):
    with Car(tmp_path / "car", a_drive(), *options, "--once") as car:
        car.wait_for(lambda: car.process.poll() == 0)
    told = json.dumps(car.lines())
    assert len(car.events("passage")) == 1
    assert "memory" not in told
    assert "lessons" not in told
    assert not list((tmp_path / "car").glob("memory*"))

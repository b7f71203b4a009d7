import pytest

from vehicle_client.estimation.grip.memory import memory_to_json, new_memory
from vehicle_client.shell.car_memory import ASIDE_SUFFIX, keep_memory, kept_memory

NEW = new_memory(handling_std_ratio=0.1)
OTHER = new_memory(handling_std_ratio=0.01)


def never(message):
    raise AssertionError(message)


def test_a_car_that_was_never_driven_starts_anew(tmp_path):
    assert kept_memory(tmp_path / "memory.json", otherwise=NEW, on_damage=never) == NEW


def test_what_was_kept_is_there_again(tmp_path):
    path = tmp_path / "memory.json"
    for memory in (OTHER, NEW):
        keep_memory(path, memory)
        assert kept_memory(path, otherwise=OTHER, on_damage=never) == memory


@pytest.mark.parametrize("damage", [b"", b"\xff\x00", memory_to_json(OTHER).encode()[:300], b" " * 200_000])
def test_a_damaged_file_is_moved_aside_and_told_of(tmp_path, damage):
    path = tmp_path / "memory.json"
    path.write_bytes(damage)
    told: list[str] = []
    assert kept_memory(path, otherwise=NEW, on_damage=told.append) == NEW
    assert len(told) == 1
    assert str(path) in told[0]
    assert path.with_name(path.name + ASIDE_SUFFIX).read_bytes() == damage
    keep_memory(path, OTHER)
    assert kept_memory(path, otherwise=NEW, on_damage=never) == OTHER

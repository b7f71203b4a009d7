import os
from pathlib import Path

import pytest

from tests.vehicle_client.shell.air import BEND, bend
from vehicle_client.shell.live.map_store import MapStore


def the_file(folder: Path) -> Path:
    (path,) = folder.glob("*.json")
    return path


def test_maps_outlive_the_process_and_newer_ones_replace_them(tmp_path: Path):
    store = MapStore(tmp_path / "maps", capacity_count=4)
    store.keep(BEND)
    assert MapStore(tmp_path / "maps", capacity_count=4).load() == (BEND,)
    newer = bend(speed_limit_mps=10.0)
    store.keep(newer)
    assert MapStore(tmp_path / "maps", capacity_count=4).load() == (newer,)


def test_the_map_used_longest_ago_makes_room(tmp_path: Path):
    store = MapStore(tmp_path, capacity_count=2)
    for age_s, name in ((30, "a"), (20, "b")):
        store.keep(bend(name))
        newest = max(tmp_path.iterdir(), key=lambda path: path.stat().st_mtime_ns)
        os.utime(newest, ns=(0, (1_000_000_000 - age_s) * 1_000_000_000))
    store.touch("a")
    store.keep(bend("c"))
    assert {section.section_id for section in MapStore(tmp_path, capacity_count=2).load()} == {"a", "c"}
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(
    ("old", "new"), [('"speed_limit_mps": 20', '"speed_limit_mps": 21'), ('"version"', '"Version"'), ("{", "")]
)
def test_a_damaged_map_is_dropped_and_counted(tmp_path: Path, old: str, new: str):
    MapStore(tmp_path, capacity_count=2).keep(BEND)
    path = the_file(tmp_path)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    store = MapStore(tmp_path, capacity_count=2)
    assert store.load() == ()
    assert store.unreadable_count == 1
    assert not path.exists()


def test_what_is_no_text_or_too_long_or_misnamed_is_dropped_too(tmp_path: Path):
    store = MapStore(tmp_path, capacity_count=4)
    store.keep(BEND)
    (tmp_path / "bytes.json").write_bytes(b"\xff\xfe")
    (tmp_path / "long.json").write_text(" " * 1_000_001, encoding="utf-8")
    (tmp_path / "elsewhere.json").write_bytes(the_file_of(BEND.section_id, tmp_path).read_bytes())
    (tmp_path / "half.json.part").write_text("{", encoding="utf-8")
    store = MapStore(tmp_path, capacity_count=4)
    assert store.load() == (BEND,)
    assert store.unreadable_count == 3
    assert len(list(tmp_path.iterdir())) == 1


def the_file_of(section_id: str, folder: Path) -> Path:
    return next(path for path in folder.glob("*.json") if f'"{section_id}"' in path.read_text(errors="replace"))

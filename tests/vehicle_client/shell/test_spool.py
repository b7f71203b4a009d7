from __future__ import annotations

import errno
import json
import os
import stat
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from roadgrip.records import QualityFlag
from tests.vehicle_client.shell.air import SUMMARY
from vehicle_client.shell.spool import ENTRY_LIMIT_BYTES, Spool, SpooledSummary, SpoolError, boot_clock


def entry(number: int, *, clock_id: str = "boot-1") -> SpooledSummary:
    return SpooledSummary(
        passage_id=number.to_bytes(16, "big"),
        section_id="bend",
        map_version="0123456789abcdef",
        summary=replace(SUMMARY, quality=QualityFlag.NO_GNSS | QualityFlag.STABILITY_ACTIVE),
        left_at_s=10.0 * number,
        clock_id=clock_id,
        frames_spent_count=6,
    )


def test_what_was_kept_is_there_after_a_restart(tmp_path: Path):
    Spool(tmp_path, clock_id="boot-1").keep(entry(1))
    assert Spool(tmp_path, clock_id="boot-1").waiting() == (entry(1),)


def test_summaries_wait_in_the_order_they_came_also_after_a_restart(tmp_path: Path):
    first = Spool(tmp_path, clock_id="boot-1")
    first.keep(entry(3))
    first.keep(entry(1))
    second = Spool(tmp_path, clock_id="boot-1")
    second.keep(entry(2))
    assert second.waiting() == (entry(3), entry(1), entry(2))


def test_a_summary_from_another_boot_has_no_age_and_is_dropped_and_counted(tmp_path: Path):
    spool = Spool(tmp_path, clock_id="boot-1")
    spool.keep(entry(1))
    spool.keep(entry(2))
    again = Spool(tmp_path, clock_id="boot-2")
    assert len(again) == 0
    assert again.counts.age_unknown_count == 2
    assert list(tmp_path.iterdir()) == []


def test_a_full_spool_drops_its_oldest_and_counts_it(tmp_path: Path):
    spool = Spool(tmp_path, clock_id="boot-1", capacity_count=3)
    for number in range(5):
        spool.keep(entry(number))
    assert spool.waiting() == (entry(2), entry(3), entry(4))
    assert spool.counts.overflowed_count == 2
    assert len(list(tmp_path.iterdir())) == 3


def test_a_spool_that_is_opened_smaller_drops_its_oldest(tmp_path: Path):
    large = Spool(tmp_path, clock_id="boot-1", capacity_count=5)
    for number in range(5):
        large.keep(entry(number))
    small = Spool(tmp_path, clock_id="boot-1", capacity_count=2)
    assert small.waiting() == (entry(3), entry(4))
    assert small.counts.overflowed_count == 3
    assert len(list(tmp_path.iterdir())) == 2


def test_keeping_a_passage_again_replaces_it_in_its_place(tmp_path: Path):
    spool = Spool(tmp_path, clock_id="boot-1")
    spool.keep(entry(1))
    spool.keep(entry(2))
    later = replace(entry(1), frames_spent_count=9)
    spool.keep(later)
    assert spool.waiting() == (later, entry(2))


def test_what_was_delivered_is_forgotten(tmp_path: Path):
    spool = Spool(tmp_path, clock_id="boot-1")
    spool.keep(entry(1))
    spool.drop(entry(1).passage_id)
    spool.drop(entry(7).passage_id)
    assert len(spool) == 0
    assert list(tmp_path.iterdir()) == []


def test_a_half_written_file_is_removed(tmp_path: Path):
    (tmp_path / "000000000000.json.part").write_text('{"format', encoding="utf-8")
    assert len(Spool(tmp_path, clock_id="boot-1")) == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"format_version": 1}', "\udcff", "9" * 20_000])
def test_a_file_that_is_no_summary_is_dropped_and_counted(tmp_path: Path, content: str):
    (tmp_path / "000000000004.json").write_text(content, encoding="utf-8", errors="surrogateescape")
    spool = Spool(tmp_path, clock_id="boot-1")
    assert len(spool) == 0
    assert spool.counts.unreadable_count == 1


@pytest.mark.parametrize(
    "changed", [{"format_version": 2}, {"passage_id": "0102"}, {"section_id": "x" * ENTRY_LIMIT_BYTES}]
)
def test_a_file_of_another_format_or_size_is_dropped_and_counted(tmp_path: Path, changed: dict[str, object]):
    Spool(tmp_path, clock_id="boot-1").keep(entry(1))
    (path,) = tmp_path.iterdir()
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | changed), encoding="utf-8")
    spool = Spool(tmp_path, clock_id="boot-1")
    assert len(spool) == 0
    assert spool.counts.unreadable_count == 1
    assert list(tmp_path.iterdir()) == []


def test_a_summary_under_a_name_that_is_no_number_is_dropped_and_counted(tmp_path: Path):
    Spool(tmp_path, clock_id="boot-1").keep(entry(1))
    (path,) = tmp_path.iterdir()
    path.rename(tmp_path / "copy.json")
    spool = Spool(tmp_path, clock_id="boot-1")
    assert len(spool) == 0
    assert spool.counts.unreadable_count == 1


def test_a_summary_is_on_the_disk_before_it_has_its_name_and_then_its_name_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    flushed = []

    def fsync(descriptor: int) -> None:
        is_folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
        flushed.append(("folder" if is_folder else "file", [path.name for path in tmp_path.iterdir()]))

    monkeypatch.setattr(os, "fsync", fsync)
    Spool(tmp_path, clock_id="boot-1").keep(entry(1))
    assert flushed == [("file", ["000000000000.json.part"]), ("folder", ["000000000000.json"])]


def test_a_disk_that_takes_nothing_leaves_the_spool_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    spool = Spool(tmp_path, clock_id="boot-1")
    spool.keep(entry(1))

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SpoolError, match="No space left"):
        spool.keep(entry(2))
    assert spool.waiting() == (entry(1),)
    assert [p.name for p in tmp_path.iterdir()] == ["000000000000.json"]


def test_a_summary_on_its_way_makes_no_room(tmp_path: Path):
    spool = Spool(tmp_path, clock_id="boot-1", capacity_count=2)
    spool.keep(entry(1))
    spool.keep(entry(2))
    with spool.delivering(entry(1).passage_id) as is_there:
        assert is_there
        spool.keep(entry(3))
        spool.keep(entry(4))
        assert spool.waiting() == (entry(1), entry(3), entry(4))
        spool.drop(entry(1).passage_id)  # delivered
    assert spool.waiting() == (entry(3), entry(4))
    assert spool.counts.overflowed_count == 1


def test_a_summary_that_comes_back_undelivered_is_dropped_once(tmp_path: Path):
    spool = Spool(tmp_path, clock_id="boot-1", capacity_count=1)
    spool.keep(entry(1))
    with spool.delivering(entry(1).passage_id):
        spool.keep(entry(2))
        spool.keep(replace(entry(1), frames_spent_count=8))
    assert spool.waiting() == (entry(2),)
    assert spool.counts.overflowed_count == 1


def test_a_summary_is_on_its_way_once_and_what_is_gone_is_not(tmp_path: Path):
    spool = Spool(tmp_path, clock_id="boot-1")
    spool.keep(entry(1))
    with spool.delivering(entry(1).passage_id), spool.delivering(entry(1).passage_id) as again:
        assert not again
    with spool.delivering(entry(2).passage_id) as is_there:
        assert not is_there


def test_a_folder_that_cannot_be_is_said(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(SpoolError, match="cannot use"):
        Spool(tmp_path / "file" / "spool", clock_id="boot-1")
    with pytest.raises(SpoolError, match="at least one"):
        Spool(tmp_path, clock_id="boot-1", capacity_count=0)


def test_a_summary_of_another_clock_is_not_taken(tmp_path: Path):
    with pytest.raises(SpoolError, match="clock"):
        Spool(tmp_path, clock_id="boot-1").keep(entry(1, clock_id="boot-2"))


@given(
    steps=st.lists(st.tuples(st.sampled_from(["keep", "drop", "restart"]), st.integers(0, 5)), max_size=20),
    capacity_count=st.integers(1, 4),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)
def test_the_disk_always_holds_exactly_what_waits(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[str, int]], capacity_count: int
):
    folder = tmp_path_factory.mktemp("spool")
    spool = Spool(folder, clock_id="boot-1", capacity_count=capacity_count)
    for step, number in steps:
        if step == "keep":
            spool.keep(entry(number))
        elif step == "drop":
            spool.drop(entry(number).passage_id)
        else:
            before = spool.waiting()
            spool = Spool(folder, clock_id="boot-1", capacity_count=capacity_count)
            assert spool.waiting() == before
        assert len(spool) == len(list(folder.iterdir())) <= capacity_count


def test_the_boot_clock_keeps_its_name_and_runs_forward():
    name, first_s = boot_clock()
    again, second_s = boot_clock()
    assert name
    if Path("/proc/sys/kernel/random/boot_id").exists():
        assert again == name
    assert second_s >= first_s

from __future__ import annotations

from math import isnan
from pathlib import Path

import pytest

from rsu_app.observability import Metrics
from rsu_app.ports import WriterPulse
from rsu_app.vital_signs import (
    VitalSigns,
    control_groups,
    disk_room,
    kernel_drops_count,
    memory_limit_bytes,
    show_vital_signs,
    status_fields,
)
from tests.rsu_app.fakes import FakeClock

PULSE = WriterPulse(committed_ago_s=None, busy_s=2.5, queued_count=0)


class Box:
    def __init__(self) -> None:
        self.clock = FakeClock()
        self.metrics = Metrics(version="0", section_ids=["bend"])
        self.signs = VitalSigns(self.clock, self.metrics, now_s=self.clock.monotonic_s)

    def passes(self, count: int, outcome: str = "counted") -> None:
        self.metrics.passages.labels("bend", outcome, "", "udp").inc(count)

    def live(self, seconds: float) -> None:
        for _ in range(round(seconds / 5.0)):
            self.clock.advance(5.0)
            self.signs.look()


def test_rates_are_those_of_the_last_minute():
    box = Box()
    box.passes(1_000)
    box.live(300.0)
    box.passes(30)
    box.passes(6, "rejected")
    box.clock.advance(1.0)
    rates = box.signs.rates_per_s()
    assert rates["counted"] == pytest.approx(30 / 61.0)
    assert rates["rejected"] == pytest.approx(6 / 61.0)


def test_before_the_first_minute_is_over_rates_are_those_since_the_start():
    box = Box()
    box.passes(20)
    box.clock.advance(10.0)
    assert box.signs.rates_per_s() == {"counted": 2.0}


def test_a_clock_that_is_set_is_noticed_between_two_questions():
    box = Box()
    box.live(60.0)
    box.clock.now_unix_s += 3600.0
    box.live(120.0)
    box.clock.now_unix_s -= 1800.0
    box.live(10.0)
    signs = box.signs.clock()
    assert signs.steps.steps_count == 2
    assert signs.steps.last_step_s == pytest.approx(-1800.0)
    assert signs.steps.moved_s == pytest.approx(1800.0)
    assert not signs.wall.ok
    assert box.metrics.registry.get_sample_value("roadgrip_clock_steps_total") == 2.0


def test_a_turn_comes_once_in_its_period():
    box = Box()
    turns = []
    for _ in range(5):
        turns.append(box.signs.take_turn(10.0))
        box.clock.advance(5.0)
    assert turns == [True, False, True, False, True]


def test_the_process_says_what_it_takes():
    box = Box()
    box.clock.advance(7.0)
    process = box.signs.process()
    assert process.up_s == 7.0
    assert process.peak_bytes >= process.resident_bytes > 1_000_000
    assert process.files_count > 0


def test_the_room_of_a_folder_that_is_gone_is_unknown(tmp_path):
    assert disk_room(tmp_path / "gone") is None
    room = disk_room(tmp_path)
    assert room is not None
    assert 0 < room.free_bytes <= room.size_bytes


def test_sizes_of_the_kernel_s_files_are_bytes(tmp_path):
    path = tmp_path / "status"
    path.write_text("Name:\tpython\nVmRSS:\t   96 kB\nThreads:\t4\n")
    assert status_fields(path) == {"VmRSS": 96 * 1024}
    assert status_fields(tmp_path / "gone") == {}


def box_with_limits(root: Path, **limits: str) -> None:
    (root / "proc" / "7").mkdir(parents=True)
    (root / "proc" / "7" / "cgroup").write_text("1:name=systemd:/x\n0::/system.slice/roadgrip-rsu.service\n")
    inside = root / "sys" / "fs" / "cgroup" / "system.slice" / "roadgrip-rsu.service"
    inside.mkdir(parents=True)
    for folder, limit in zip((inside, inside.parent), limits.values(), strict=True):
        (folder / "memory.max").write_text(f"{limit}\n")


@pytest.mark.parametrize(
    ("own", "above", "limit_bytes"), [("536870912", "max", 536870912), ("max", "max", None), ("999", "500", 500)]
)
def test_the_tightest_limit_of_all_control_groups_holds(tmp_path, own, above, limit_bytes):
    box_with_limits(tmp_path, own=own, above=above)
    assert memory_limit_bytes("7", root=tmp_path) == limit_bytes


def test_datagrams_that_the_kernel_dropped_are_those_of_the_process_s_own_sockets(tmp_path):
    folder = tmp_path / "proc" / "7"
    (folder / "fd").mkdir(parents=True)
    (folder / "net").mkdir()
    (folder / "fd" / "3").symlink_to("/dev/null")
    (folder / "fd" / "4").symlink_to("socket:[4711]")
    head = (
        "  sl  local_address rem_address st tx_queue rx_queue tr tm->when retrnsmt uid timeout inode ref pointer drops"
    )
    row = " 12: 0100007F:1284 00000000:0000 07 00000000:00000000 00:00000000 00000000 0 0 {} 2 0000000000000000 {}"
    (folder / "net" / "udp").write_text("\n".join([head, row.format(4711, 12), row.format(9, 500)]) + "\n")
    assert kernel_drops_count("7", root=tmp_path) == 12
    assert kernel_drops_count("8", root=tmp_path) == 0


def test_without_control_groups_there_is_no_limit(tmp_path):
    assert control_groups("7", root=tmp_path) == []
    assert memory_limit_bytes("7", root=tmp_path) is None


def test_what_is_not_known_is_no_number_in_the_gauges(tmp_path):
    box = Box()
    show_vital_signs(box.signs, PULSE, folder=tmp_path / "gone", damaged_count=1, metrics=box.metrics)
    value = box.metrics.registry.get_sample_value
    assert isnan(value("roadgrip_store_commit_age_seconds") or 0.0)
    assert isnan(value("roadgrip_disk_free_bytes") or 0.0)
    assert value("roadgrip_store_writer_busy_seconds") == 2.5
    assert value("roadgrip_store_damaged_kept") == 1.0

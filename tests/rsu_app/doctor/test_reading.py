from __future__ import annotations

import os
import socket
from contextlib import closing
from pathlib import Path

import pytest

from roadgrip.errors import StoreError
from rsu_app.bootstrap import upgrade_database
from rsu_app.doctor.examination import examine, looked
from rsu_app.doctor.findings import Level
from rsu_app.doctor.machine_reading import (
    backup_seen,
    clock_seen,
    disk_seen,
    log_seen,
    memory_seen,
    processor_seen,
    service_seen,
    udp_buffer_seen,
)
from rsu_app.doctor.seen import DiskKind, PortState
from rsu_app.doctor.unit_reading import (
    bundle_seen,
    database_seen,
    ports_seen,
    repository_seen,
    running_status,
    sections_seen,
    trust_seen,
    unit_seen,
)
from rsu_app.settings import Settings, load_settings
from tests.bundles import make_bundle
from tests.repositories import SignedRepository
from tests.rsu_app.cli.test_rollout_cli import server_that_says


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """The files of another machine: a unit with process number 7 that ran out of memory once."""
    root = tmp_path / "root"
    group = root / "sys" / "fs" / "cgroup" / "roadgrip-rsu.service"
    for path, text in {
        root / "proc/7/cgroup": "0::/roadgrip-rsu.service\n",
        root / "proc/7/status": "VmRSS:\t  110592 kB\n",
        root / "proc/meminfo": "MemTotal: 2000000 kB\nMemAvailable: 900000 kB\nSwapTotal: 1000 kB\nSwapFree: 400 kB\n",
        group / "memory.max": "536870912\n",
        group / "memory.events": "low 0\noom_kill 1\n",
        group / "cpu.stat": "usage_usec 5\nnr_periods 200\nnr_throttled 50\n",
        root / "sys/class/thermal/thermal_zone0/temp": "61000\n",
        root / "sys/devices/system/cpu/cpu0/thermal_throttle/core_throttle_count": "3\n",
        root / "sys/class/rtc/rtc0/name": "rtc\n",
        root / "var/log/journal/1/system.journal": "x" * 1000,
    }.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def test_memory_is_that_of_the_box_and_of_the_unit(root):
    seen = memory_seen("7", root=root)
    assert (seen.total_bytes, seen.available_bytes, seen.swap_used_bytes) == (2_048_000_000, 921_600_000, 614_400)
    assert (seen.limit_bytes, seen.resident_bytes, seen.killed_count) == (536_870_912, 113_246_208, 1)
    alone = memory_seen(None, root=root)
    assert (alone.limit_bytes, alone.resident_bytes, alone.killed_count) == (None, None, 0)


def test_a_processor_that_is_held_back_is_seen(root):
    seen = processor_seen("7", root=root)
    assert (seen.throttled_frac, seen.slowed_count, seen.hottest_c) == (0.25, 3, 61.0)
    bare = processor_seen(None, root=root / "nothing")
    assert (bare.throttled_frac, bare.slowed_count, bare.hottest_c) == (None, 0, None)


def test_a_clock_that_outlasts_a_power_cut_is_seen(root):
    assert clock_seen(newest_stored_unix_s=None, speedup_ratio=1.0, root=root).battery_backed
    assert not clock_seen(newest_stored_unix_s=None, speedup_ratio=1.0, root=root / "nothing").battery_backed


def test_the_journal_is_as_large_as_its_files(root, tmp_path):
    assert log_seen(tmp_path, root=root).journal_bytes == 1000
    assert log_seen(tmp_path, root=root / "nothing").journal_bytes is None


def test_without_systemd_no_service_is_looked_for(root):
    assert not service_seen("roadgrip-rsu", root=root).managed


def mounted(root: Path, *lines: str) -> Path:
    (root / "proc" / "self").mkdir(parents=True, exist_ok=True)
    (root / "proc" / "self" / "mountinfo").write_text("\n".join(lines) + "\n")
    return root


def test_the_disk_is_that_of_the_innermost_mount(root, tmp_path):
    outer = "1 0 8:1 / / rw,relatime shared:1 - ext4 /dev/sda1 rw"
    inner = f"2 1 0:30 / {tmp_path} rw - nfs4 server:/x rw"
    locked = f"3 1 0:31 / {tmp_path}/locked rw - ext4 /dev/sdb1 ro,errors=remount-ro"
    (tmp_path / "locked").mkdir()
    mounted(root, outer, inner, locked)
    assert disk_seen(tmp_path / "not" / "made" / "yet", root=root).kind is DiskKind.NETWORK
    assert disk_seen(Path("/"), root=root).file_system == "ext4"
    seen = disk_seen(tmp_path / "locked", root=root)
    assert (seen.read_only, seen.sync_s) == (True, ())


@pytest.mark.parametrize(
    ("device", "rotational", "kind"),
    [
        ("mmcblk0/mmcblk0p2", "0", DiskKind.CARD),
        ("nvme0n1/nvme0n1p1", "0", DiskKind.SOLID),
        ("sda/sda1", "1", DiskKind.ROTATING),
        ("loop0/none", None, DiskKind.UNKNOWN),
    ],
)
def test_the_kind_of_disk_is_told_from_its_device(root, tmp_path, device, rotational, kind):
    place = root / "sys" / "devices" / "block" / device
    place.mkdir(parents=True)
    if rotational is not None:
        (place.parent / "queue").mkdir()
        (place.parent / "queue" / "rotational").write_text(rotational)
    number = tmp_path.stat().st_dev
    link = root / "sys" / "dev" / "block" / f"{os.major(number)}:{os.minor(number)}"
    link.parent.mkdir(parents=True)
    link.symlink_to(place)
    mounted(root, "1 0 8:1 / / rw - ext4 /dev/x rw")
    assert disk_seen(tmp_path, root=root).kind is kind


def test_what_the_disk_was_asked_for_is_gone_afterwards(tmp_path):
    seen = disk_seen(tmp_path)
    assert len(seen.sync_s) == 20
    assert min(seen.sync_s) > 0.0
    assert list(tmp_path.iterdir()) == []


def test_the_kernel_says_what_it_grants():
    seen = udp_buffer_seen(65_536, None)
    assert (seen.granted_bytes, seen.drops_count) == (65_536, 0)


def test_the_newest_backup_counts(tmp_path):
    assert backup_seen(tmp_path / "none").newest_unix_s is None
    for name, moment in (("old", 1_000.0), ("new", 2_000.0)):
        (tmp_path / name).write_text("")
        os.utime(tmp_path / name, (moment, moment))
    assert backup_seen(tmp_path).newest_unix_s == 2_000.0


# The unit ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def config(tmp_path: Path) -> Path:
    folder = tmp_path / "unit"
    make_bundle(folder / "bundle")
    path = folder / "rsu.toml"
    path.write_text('[database]\npath = "rsu.sqlite3"\n[model]\nbundle_path = "bundle"\n')
    return path


def with_lines(config: Path, text: str) -> Settings:
    config.write_text(config.read_text() + text)
    return load_settings(config)


def test_a_unit_that_is_whole_is_seen_so(config):
    settings = load_settings(config)
    upgrade_database(settings.database.path)
    database = database_seen(settings)
    assert (database.exists, database.problems, database.damaged) == (True, (), ())
    assert database.owner == database.folder_owner
    assert sections_seen(settings).section_ids == ("long-turn",)
    assert bundle_seen(settings).bundle_id
    assert trust_seen(settings).problem == ""
    said, problem = running_status(settings)
    assert (unit_seen(settings, said, problem=problem).runs, problem) == (False, "")


def test_a_unit_that_is_not_is_seen_so(config):
    settings = load_settings(config)
    settings.database.path.write_bytes(b"this is no database, and long enough not to be taken for one" * 20)
    (config.parent / "rsu.sqlite3.damaged-1").write_bytes(b"")
    (config.parent / "bundle" / "model.onnx").write_bytes(b"no model")
    database = database_seen(settings)
    assert "not a database" in database.problems[0]
    assert database.damaged == ("rsu.sqlite3.damaged-1",)
    assert "model.onnx differs" in bundle_seen(settings).problem
    assert "no-such-turn" in sections_seen(with_lines(config, '[[sections]]\nfile = "no-such-turn"\n')).problem


def test_a_control_socket_where_nothing_sensible_answers_is_a_problem(config):
    settings = with_lines(config, '[control]\nsocket_path = "c"\n')
    with server_that_says(config.parent / "c", b"nonsense"):
        said, problem = running_status(settings)
    assert said is None
    assert "does not answer" in problem
    assert unit_seen(settings, said, problem=problem).problem == problem


def test_ports_are_free_taken_or_of_another_machine(config):
    with closing(socket.socket()) as http, closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as udp:
        http.bind(("127.0.0.1", 0))
        http.listen()
        udp.bind(("127.0.0.1", 0))
        ports = f"[http]\nport = {http.getsockname()[1]}\n[udp]\nport = {udp.getsockname()[1]}\n"
        settings = with_lines(config, ports)
        assert [port.state for port in ports_seen(settings, ours=False)] == [PortState.TAKEN, PortState.TAKEN]
    assert [port.state for port in ports_seen(settings, ours=False)] == [PortState.FREE, PortState.FREE]
    elsewhere = settings.model_copy(update={"udp": settings.udp.model_copy(update={"host": "192.0.2.7"})})
    found = ports_seen(elsewhere, ours=False)[1]
    assert (found.state, found.loopback) == (PortState.NO_ADDRESS, False)


def test_a_key_that_others_may_read_is_seen(config):
    (config.parent / "tokens").write_text("")
    (config.parent / "tokens").chmod(0o644)
    settings = with_lines(config, '[operators]\ntokens_file = "tokens"\n')
    assert trust_seen(settings).exposed == (str(config.parent / "tokens"),)


def test_a_repository_is_visited_without_leaving_a_trace(config):
    folder = config.parent
    repository = SignedRepository(folder / "repository")
    (folder / "trusted-root.json").write_bytes(repository.trusted_root)
    repository.release(folder / "bundle", sequence_number=1)
    settings = with_lines(
        config, '[updates]\nsource = "repository"\ntrusted_root = "trusted-root.json"\nring = "canary"\n'
    )
    before = sorted(folder.rglob("*"))
    seen = repository_seen(settings, visit=True)
    assert (seen.visited, seen.problem) == (True, "")
    assert seen.expires_unix_s is not None
    assert sorted(folder.rglob("*")) == before
    other_ring = settings.model_copy(update={"updates": settings.updates.model_copy(update={"ring": "south"})})
    assert repository_seen(other_ring, visit=True).reason == "no_release"
    assert not repository_seen(settings, visit=False).visited


def test_with_settings_that_do_not_hold_the_machine_is_examined_all_the_same(config, tmp_path):
    config.write_text("[http]\nport = -1\n")
    findings = list(examine(config, visit=False, backups=tmp_path))
    assert findings[0].level is Level.FAIL
    assert {"disk", "memory", "processor"} <= {finding.name for finding in findings}


def test_what_cannot_even_be_looked_at_is_a_finding():
    def forbidden():
        raise PermissionError(13, "Permission denied", "/var/lib/roadgrip")

    def broken():
        raise StoreError("reading: database is locked")

    for look, told in ((forbidden, "/var/lib/roadgrip"), (broken, "locked")):
        (finding,) = looked("database", look)
        assert (finding.name, finding.level) == ("database", Level.FAIL)
        assert told in finding.seen

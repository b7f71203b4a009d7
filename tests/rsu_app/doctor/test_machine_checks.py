from __future__ import annotations

from dataclasses import replace

import pytest

from rsu_app.doctor.findings import Level, exit_code, failed, fine, warned
from rsu_app.doctor.machine_checks import (
    backup_finding,
    clock_finding,
    disk_finding,
    disk_speed_finding,
    log_finding,
    memory_finding,
    processor_finding,
    service_finding,
    udp_buffer_finding,
)
from rsu_app.doctor.seen import (
    BackupSeen,
    ClockSeen,
    DiskKind,
    DiskSeen,
    LogSeen,
    MemorySeen,
    ProcessorSeen,
    ServiceSeen,
    UdpBufferSeen,
)
from tests.rsu_app.fakes import NOON_UNIX_S

MEBI = 1024 * 1024
DISK = DiskSeen("/var/lib/roadgrip", DiskKind.SOLID, "ext4", False, 4096 * MEBI, 8192 * MEBI, (0.004, 0.005, 0.03))
CLOCK = ClockSeen(NOON_UNIX_S, True, 0.004, NOON_UNIX_S - 60.0, battery_backed=True)
MEMORY = MemorySeen(2048 * MEBI, 1500 * MEBI, limit_bytes=512 * MEBI, resident_bytes=110 * MEBI)
PROCESSOR = ProcessorSeen(cores_count=2, load_count=0.4, throttled_frac=0.0, hottest_c=51.0)
BUFFER = UdpBufferSeen(asked_bytes=4 * MEBI, granted_bytes=4 * MEBI)
SERVICE = ServiceSeen(
    True,
    {
        "LoadState": "loaded",
        "ActiveState": "active",
        "SubState": "running",
        "UnitFileState": "enabled",
        "NRestarts": "0",
        "Result": "success",
        "WatchdogUSec": "30s",
        "Type": "notify",
    },
)


def service(**changes: str) -> ServiceSeen:
    return ServiceSeen(True, SERVICE.properties | changes)


WELL = [
    disk_finding(DISK),
    disk_speed_finding(DISK),
    clock_finding(CLOCK),
    clock_finding(replace(CLOCK, synchronised=None, newest_stored_unix_s=None)),
    memory_finding(MEMORY),
    memory_finding(replace(MEMORY, limit_bytes=None, resident_bytes=None)),
    processor_finding(PROCESSOR),
    processor_finding(ProcessorSeen(cores_count=2, load_count=0.4)),
    udp_buffer_finding(BUFFER),
    service_finding(SERVICE, name="roadgrip-rsu"),
    service_finding(ServiceSeen(managed=False), name="roadgrip-rsu"),
    log_finding(LogSeen(300 * MEBI, 4096 * MEBI), lines_dropped_count=0),
    log_finding(LogSeen(None, None), lines_dropped_count=0),
    backup_finding(BackupSeen("/b", NOON_UNIX_S - 86_400.0), now_unix_s=NOON_UNIX_S),
]


@pytest.mark.parametrize("finding", WELL, ids=lambda finding: str(finding.name))
def test_what_is_well_needs_no_remedy(finding):
    assert (finding.level, finding.remedy) == (Level.OK, "")
    assert finding.seen


ILL = [
    (disk_finding(replace(DISK, read_only=True)), "fail", "read-only", "mount"),
    (disk_finding(replace(DISK, problem="No space left on device")), "fail", "No space", "make room"),
    (disk_finding(replace(DISK, kind=DiskKind.NETWORK, file_system="nfs4")), "fail", "nfs4", "database.path"),
    (disk_finding(replace(DISK, free_bytes=10 * MEBI)), "fail", "10.0 MB free", "make room"),
    (disk_finding(replace(DISK, free_bytes=400 * MEBI)), "warn", "400 MB free", "rows_limit_count"),
    (disk_finding(replace(DISK, kind=DiskKind.MEMORY)), "warn", "gone after", "database.path"),
    (disk_speed_finding(replace(DISK, sync_s=(0.08, 0.09))), "warn", "85.0 ms", "card"),
    (disk_speed_finding(replace(DISK, sync_s=(2.0, 3.0))), "fail", "3000 ms", "iotop"),
    (clock_finding(replace(CLOCK, unix_s=120.0)), "fail", "before 2024", "date -s"),
    (
        clock_finding(replace(CLOCK, newest_stored_unix_s=NOON_UNIX_S + 7200.0)),
        "fail",
        "2 h 0 min behind",
        "timedatectl",
    ),
    (clock_finding(replace(CLOCK, synchronised=False)), "warn", "nothing keeps it right", "set-ntp"),
    (clock_finding(replace(CLOCK, max_error_s=15.0)), "warn", "15 s only", "timedatectl"),
    (clock_finding(replace(CLOCK, speedup_ratio=60.0)), "fail", "60 times", "clock.speedup_ratio"),
    (memory_finding(replace(MEMORY, killed_count=2)), "fail", "2 times", "MemoryMax="),
    (memory_finding(replace(MEMORY, limit_bytes=100 * MEBI)), "fail", "limit 100 MB", "MemoryMax="),
    (memory_finding(replace(MEMORY, available_bytes=20 * MEBI)), "warn", "20.0 MB", "ps aux"),
    (memory_finding(replace(MEMORY, swap_used_bytes=900 * MEBI)), "warn", "900 MB swapped", "flash"),
    (processor_finding(replace(PROCESSOR, hottest_c=96.0)), "warn", "96 degrees", "vents"),
    (processor_finding(replace(PROCESSOR, slowed_count=7)), "warn", "7 times", "cool"),
    (processor_finding(replace(PROCESSOR, throttled_frac=0.4)), "warn", "40%", "CPUQuota="),
    (processor_finding(replace(PROCESSOR, load_count=9.0)), "warn", "load 9.0", "top"),
    (udp_buffer_finding(replace(BUFFER, granted_bytes=212_992)), "warn", "208 kB granted", "rmem_max=4194304"),
    (udp_buffer_finding(replace(BUFFER, drops_count=41)), "warn", "dropped 41", "rmem_max"),
    (service_finding(service(LoadState="not-found"), name="roadgrip-rsu"), "warn", "knows no", "install.md"),
    (
        service_finding(service(ActiveState="failed", Result="watchdog"), name="roadgrip-rsu"),
        "fail",
        "watchdog",
        "journalctl",
    ),
    (service_finding(service(NRestarts="12"), name="roadgrip-rsu"), "warn", "12 restarts", "journalctl"),
    (service_finding(service(UnitFileState="disabled"), name="roadgrip-rsu"), "warn", "does not start", "enable"),
    (service_finding(service(WatchdogUSec="infinity"), name="roadgrip-rsu"), "warn", "nobody watches", "WatchdogSec="),
    (log_finding(LogSeen(2048 * MEBI, 100 * MEBI), lines_dropped_count=0), "warn", "2.0 GB", "SystemMaxUse"),
    (log_finding(LogSeen(None, None), lines_dropped_count=5), "warn", "5 lines", "lines_limit_per_s"),
    (backup_finding(BackupSeen("/b", None), now_unix_s=NOON_UNIX_S), "warn", "none in /b", "roadgrip-rsu backup"),
    (backup_finding(BackupSeen("/b", 0.0), now_unix_s=NOON_UNIX_S), "warn", "old", "roadgrip-rsu backup"),
]


@pytest.mark.parametrize(("finding", "level", "seen", "remedy"), ILL, ids=lambda part: getattr(part, "name", None))
def test_what_is_ill_says_what_was_seen_and_what_mends_it(finding, level, seen, remedy):
    assert finding.level.value == level
    assert seen in finding.seen
    assert remedy in finding.remedy


@pytest.mark.parametrize(
    ("findings", "code"),
    [
        ([], 0),
        ([fine("a", "x")], 0),
        ([fine("a", "x"), warned("b", "y", "z")], 1),
        ([failed("c", "x", "y"), warned("b", "y", "z")], 2),
    ],
)
def test_the_worst_finding_gives_the_exit_code(findings, code):
    assert exit_code(findings) == code

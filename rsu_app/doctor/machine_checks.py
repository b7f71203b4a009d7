"""Judgements on the machine: disk, clock, memory, processor, kernel."""

from __future__ import annotations

from statistics import median

from rsu_app.doctor.findings import Finding, failed, fine, warned
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
from rsu_app.usecases.readiness import EARLIEST_SANE_UNIX_S
from rsu_app.words import duration_words, size_words

MEBI = 1024 * 1024
NEEDED_BYTES = 200 * MEBI
"""What a unit may take on a busy day, with room for a reload of the model."""
ROOM_FAIL_BYTES = 64 * MEBI
ROOM_WARN_BYTES = 512 * MEBI
SYNC_WARN_S = 0.05
SYNC_FAIL_S = 1.0
ERROR_WARN_S = 10.0
"""A wall clock may be so wrong before the age of a passage, told by two clocks, is."""
AHEAD_TOLERANCE_S = 60.0
HOT_C = 85.0
JOURNAL_WARN_BYTES = 1024 * MEBI
BACKUP_WARN_S = 35 * 86_400.0
RESTARTS_WARN_COUNT = 3
PROPERTIES = ("LoadState", "ActiveState", "SubState", "UnitFileState", "NRestarts", "Result", "WatchdogUSec", "Type")


def disk_finding(disk: DiskSeen) -> Finding:
    """Return whether the disk takes writes, and how much more."""
    name, remedy = "disk", "make room: journalctl --vacuum-size=100M; lower database.rows_limit_count"
    if disk.read_only:
        return failed(
            name, f"{disk.folder} is mounted read-only", "dmesg | grep -i error; mount -o remount,rw, or fsck"
        )
    if disk.problem:
        return failed(name, f"{disk.folder}: {disk.problem}", f"make room, or give {disk.folder} to the unit's account")
    if disk.kind is DiskKind.NETWORK:
        return failed(
            name, f"{disk.folder} is on a network ({disk.file_system})", "put database.path on a disk of this machine"
        )
    room = "room unknown" if disk.free_bytes is None else f"{size_words(disk.free_bytes)} free"
    seen = f"{disk.folder}: {disk.kind.value}, {disk.file_system or 'file system unknown'}, {room}"
    if disk.free_bytes is not None and disk.free_bytes < ROOM_FAIL_BYTES:
        return failed(name, seen, remedy)
    if disk.kind is DiskKind.MEMORY:
        return warned(name, f"{seen}: gone after a restart of the box", "put database.path on a disk that stays")
    if disk.free_bytes is not None and disk.free_bytes < ROOM_WARN_BYTES:
        return warned(name, seen, remedy)
    return fine(name, seen)


def disk_speed_finding(disk: DiskSeen) -> Finding:
    """Return whether the disk says soon enough that it has what was written; `sync_s` must have been measured."""
    name, usual_s = "disk speed", median(disk.sync_s)
    seen = f"a write is safe after {1e3 * usual_s:.1f} ms, at worst {1e3 * max(disk.sync_s):.0f} ms"
    if usual_s > SYNC_FAIL_S:
        return failed(name, seen, "the disk is worn out, or busy with something else: iotop; replace it")
    if usual_s > SYNC_WARN_S:
        return warned(name, seen, "it bounds passages a second: an industrial card or a solid state disk helps")
    return fine(name, seen)


def clock_finding(clock: ClockSeen) -> Finding:
    """Return whether the wall clock can be true, and whether anything keeps it so."""
    name, remedy = "clock", "timedatectl set-ntp true, with a server that answers: timedatectl timesync-status"
    if clock.speedup_ratio != 1.0:
        return failed(
            name, f"the unit's clock runs at {clock.speedup_ratio:g} times its pace", "remove clock.speedup_ratio"
        )
    if clock.unix_s < EARLIEST_SANE_UNIX_S:
        return failed(name, f"it says {clock.unix_s:.0f} s since 1970, before 2024", f"{remedy}; or date -s by hand")
    newest_unix_s = clock.newest_stored_unix_s
    if newest_unix_s is not None and newest_unix_s > clock.unix_s + AHEAD_TOLERANCE_S:
        behind = duration_words(newest_unix_s - clock.unix_s)
        return failed(name, f"it is {behind} behind the newest stored passage", remedy)
    battery = "" if clock.battery_backed else "; no clock of its own that outlasts a power cut"
    if clock.synchronised is None:
        return fine(name, f"plausible; what keeps it right is unknown here{battery}")
    if not clock.synchronised:
        return warned(name, f"plausible, but nothing keeps it right{battery}", remedy)
    if clock.max_error_s is not None and clock.max_error_s > ERROR_WARN_S:
        return warned(name, f"kept right within {clock.max_error_s:.0f} s only{battery}", remedy)
    within = "" if clock.max_error_s is None else f" within {1e3 * clock.max_error_s:.0f} ms"
    return fine(name, f"plausible, kept right{within}{battery}")


def memory_finding(memory: MemorySeen) -> Finding:
    """Return whether there is memory enough."""
    name = "memory"
    limit = "" if memory.limit_bytes is None else f", limit {size_words(memory.limit_bytes)}"
    held = "" if memory.resident_bytes is None else f", the unit holds {size_words(memory.resident_bytes)}"
    swap = f", {size_words(memory.swap_used_bytes)} swapped out" if memory.swap_used_bytes else ""
    seen = f"{size_words(memory.available_bytes)} of {size_words(memory.total_bytes)} to be had{limit}{held}{swap}"
    if memory.killed_count:
        return failed(
            name,
            f"the kernel has killed for memory {memory.killed_count} times; {seen}",
            "raise MemoryMax= of the unit",
        )
    if memory.limit_bytes is not None and memory.limit_bytes < NEEDED_BYTES:
        return failed(name, seen, f"MemoryMax= of the unit should not be below {size_words(NEEDED_BYTES)}")
    still_needed_bytes = NEEDED_BYTES - (memory.resident_bytes or 0)
    if memory.available_bytes < still_needed_bytes:
        return warned(name, seen, "see what else takes memory: ps aux --sort=-rss | head")
    if memory.swap_used_bytes > NEEDED_BYTES:
        return warned(name, seen, "swapping wears out flash and makes passages wait: stop what else runs here")
    return fine(name, seen)


def processor_finding(processor: ProcessorSeen) -> Finding:
    """Return whether there is time enough to compute in."""
    name = "processor"
    hot = "" if processor.hottest_c is None else f", {processor.hottest_c:.0f} degrees"
    seen = f"{processor.cores_count} cores, load {processor.load_count:.1f}{hot}"
    if processor.hottest_c is not None and processor.hottest_c > HOT_C:
        return warned(name, seen, "too hot: look at the vents, the fan and the sun on the box")
    if processor.slowed_count:
        return warned(
            name, f"{seen}; slowed down for heat {processor.slowed_count} times since the boot", "cool the box"
        )
    if processor.throttled_frac is not None and processor.throttled_frac > 0.05:
        return warned(
            name, f"{seen}; held back in {processor.throttled_frac:.0%} of the time", "raise CPUQuota= of the unit"
        )
    if processor.load_count > 2.0 * processor.cores_count:
        return warned(name, seen, "something else takes the processor: top")
    return fine(name, seen)


def udp_buffer_finding(buffer: UdpBufferSeen) -> Finding:
    """Return whether a burst of vehicles finds room while the unit is busy for a moment."""
    name = "udp buffer"
    seen = f"{size_words(buffer.granted_bytes)} granted of {size_words(buffer.asked_bytes)}"
    remedy = (
        f"sysctl -w net.core.rmem_max={buffer.asked_bytes}, and the same line in /etc/sysctl.d/roadgrip.conf; "
        "then start the unit anew"
    )
    if buffer.drops_count:
        return warned(name, f"{seen}; the kernel dropped {buffer.drops_count} datagrams since the start", remedy)
    if buffer.granted_bytes < buffer.asked_bytes:
        return warned(name, seen, remedy)
    return fine(name, seen)


def service_finding(service: ServiceSeen, *, name: str) -> Finding:
    """Return how the unit is as systemd sees it.

    Args:
        service: What systemd says.
        name: Of the service, such as "roadgrip-rsu".
    """
    found = service.properties
    if not service.managed:
        return fine("service", "systemd does not run this box")
    if found.get("LoadState") != "loaded":
        return warned("service", f"systemd knows no {name}", "install the package, or see docs/install.md")
    restarts_count = int(found["NRestarts"]) if found.get("NRestarts", "").isdigit() else 0
    seen = f"{name} is {found.get('ActiveState', 'unknown')} ({found.get('SubState', '?')}), {restarts_count} restarts"
    if found.get("ActiveState") != "active":
        return failed("service", f"{seen}; result {found.get('Result', '?')}", f"journalctl -n 50 -u {name}")
    if restarts_count > RESTARTS_WARN_COUNT:
        return warned("service", seen, f"journalctl -u {name} --since -1d | grep -v passage")
    if found.get("UnitFileState") != "enabled":
        return warned("service", f"{seen}; it does not start with the box", f"systemctl enable {name}")
    if found.get("Type") == "notify" and found.get("WatchdogUSec") in {"0", "infinity"}:
        return warned("service", f"{seen}; nobody watches it", f"WatchdogSec= of {name}: systemctl edit {name}")
    return fine("service", seen)


def log_finding(log: LogSeen, *, lines_dropped_count: int) -> Finding:
    """Return whether the log stays within its budget.

    Args:
        log: The journal.
        lines_dropped_count: Lines the running unit dropped.
    """
    size = "size unknown" if log.journal_bytes is None else size_words(log.journal_bytes)
    seen = f"journal {size}"
    if lines_dropped_count:
        return warned(
            "log",
            f"{seen}; {lines_dropped_count} lines dropped",
            "log.lines_limit_per_s, or find out what is so chatty",
        )
    if (
        log.journal_bytes is not None
        and log.journal_bytes > JOURNAL_WARN_BYTES
        and log.journal_bytes > (log.free_bytes or 0)
    ):
        return warned("log", seen, "SystemMaxUse=200M in /etc/systemd/journald.conf; journalctl --vacuum-size=200M")
    return fine("log", seen)


def backup_finding(backup: BackupSeen, *, now_unix_s: float) -> Finding:
    """Return whether there is a backup of late.

    Args:
        backup: Where backups lie.
        now_unix_s: By the wall clock.
    """
    if backup.newest_unix_s is None:
        return warned("backup", f"none in {backup.folder}", f"roadgrip-rsu backup, into {backup.folder} and elsewhere")
    age_s = now_unix_s - backup.newest_unix_s
    seen = f"the newest in {backup.folder} is {duration_words(age_s)} old"
    if age_s > BACKUP_WARN_S:
        return warned("backup", seen, f"roadgrip-rsu backup, into {backup.folder} and elsewhere")
    return fine("backup", seen)

"""What is read of the machine. Changes nothing but a small file beside the database, which it removes again."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
import time
from contextlib import closing, suppress
from pathlib import Path

from rsu_app.adapters.kernel_clock import kernel_clock
from rsu_app.doctor.machine_checks import PROPERTIES
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
from rsu_app.vital_signs import control_groups, disk_room, kernel_drops_count, memory_limit_bytes, status_fields

ROOT = Path("/")
SYNCS_COUNT = 20
SYNC_BYTES = 4096
COMMAND_TIMEOUT_S = 5.0
_NETWORKS = {"nfs", "nfs4", "cifs", "smb3", "9p", "fuse.sshfs", "ceph", "glusterfs"}
_IN_MEMORY = {"tmpfs", "ramfs"}


def disk_seen(folder: Path, *, root: Path = ROOT) -> DiskSeen:
    """Return the file system of a folder, or of the nearest one above it that exists."""
    there = next((place for place in (folder, *folder.parents) if place.is_dir()), Path("/"))
    file_system, read_only = _mount_of(there, root=root)
    room = disk_room(there)
    sync_s: tuple[float, ...] = ()
    problem = ""
    if not read_only:
        try:
            sync_s = _sync_times_s(there)
        except OSError as error:
            problem = error.strerror or str(error)
    return DiskSeen(
        folder=str(there),
        kind=_kind_of(there, file_system, root=root),
        file_system=file_system,
        read_only=read_only,
        free_bytes=None if room is None else room.free_bytes,
        size_bytes=None if room is None else room.size_bytes,
        sync_s=sync_s,
        problem=problem,
    )


def clock_seen(*, newest_stored_unix_s: float | None, speedup_ratio: float, root: Path = ROOT) -> ClockSeen:
    """Return what the clock says, and what is known of it."""
    kernel = kernel_clock()
    return ClockSeen(
        unix_s=time.time(),
        synchronised=None if kernel is None else kernel.synchronised,
        max_error_s=kernel.max_error_s if kernel is not None and kernel.synchronised else None,
        newest_stored_unix_s=newest_stored_unix_s,
        battery_backed=any((root / "sys" / "class" / "rtc").glob("rtc*")),
        speedup_ratio=speedup_ratio,
    )


def memory_seen(process: str | None, *, root: Path = ROOT) -> MemorySeen:
    """Return the memory of the box and of the running unit.

    Args:
        process: The unit's number; None if none runs.
        root: The file system to read.
    """
    box = status_fields(root / "proc" / "meminfo")
    own = {} if process is None else status_fields(root / "proc" / process / "status")
    groups = [] if process is None else control_groups(process, root=root)
    return MemorySeen(
        total_bytes=box.get("MemTotal", 0),
        available_bytes=box.get("MemAvailable", 0),
        swap_used_bytes=box.get("SwapTotal", 0) - box.get("SwapFree", 0),
        limit_bytes=None if process is None else memory_limit_bytes(process, root=root),
        resident_bytes=own.get("VmRSS"),
        killed_count=_counted(groups[0] / "memory.events").get("oom_kill", 0) if groups else 0,
    )


def processor_seen(process: str | None, *, root: Path = ROOT) -> ProcessorSeen:
    """Return the processor, and how far the running unit is held back; arguments as for `memory_seen`."""
    groups = [] if process is None else control_groups(process, root=root)
    counted = _counted(groups[0] / "cpu.stat") if groups else {}
    periods_count = counted.get("nr_periods", 0)
    sensors = [_number(path) for path in (root / "sys" / "class" / "thermal").glob("thermal_zone*/temp")]
    cores = (root / "sys" / "devices" / "system" / "cpu").glob("cpu*/thermal_throttle/core_throttle_count")
    return ProcessorSeen(
        cores_count=len(os.sched_getaffinity(0)),
        load_count=os.getloadavg()[1],
        throttled_frac=counted.get("nr_throttled", 0) / periods_count if periods_count else None,
        slowed_count=sum(int(_number(path) or 0) for path in cores),
        hottest_c=max((found / 1000.0 for found in sensors if found is not None), default=None),
    )


def udp_buffer_seen(asked_bytes: int, process: str | None) -> UdpBufferSeen:
    """Return what the kernel grants to a socket that asks for so much; `process` as for `memory_seen`."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as link:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, asked_bytes)
        # Linux doubles what it grants, for its own bookkeeping.
        granted_bytes = link.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    return UdpBufferSeen(
        asked_bytes=asked_bytes,
        granted_bytes=granted_bytes,
        drops_count=0 if process is None else kernel_drops_count(process),
    )


def service_seen(name: str, *, root: Path = ROOT) -> ServiceSeen:
    """Return what systemd says of a service, where it runs the box."""
    program = shutil.which("systemctl")
    if program is None or not (root / "run" / "systemd" / "system").is_dir():
        return ServiceSeen(managed=False)
    try:
        done = subprocess.run(  # noqa: S603 - a program of the system, and names of ours
            [program, "show", name, f"--property={','.join(PROPERTIES)}"],
            capture_output=True,
            text=True,
            timeout=COMMAND_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ServiceSeen(managed=False)
    pairs = (line.partition("=") for line in done.stdout.splitlines())
    return ServiceSeen(managed=True, properties={key: said for key, _, said in pairs})


def log_seen(folder: Path, *, root: Path = ROOT) -> LogSeen:
    """Return what the journal takes, and the room beside the database."""
    room = disk_room(folder)
    journals = [root / "var" / "log" / "journal", root / "run" / "log" / "journal"]
    sizes = [path.stat().st_size for journal in journals for path in _files(journal)]
    return LogSeen(
        journal_bytes=sum(sizes) if sizes else None,
        free_bytes=None if room is None else room.free_bytes,
    )


def backup_seen(folder: Path) -> BackupSeen:
    """Return when the newest file in a folder was written."""
    moments = [path.stat().st_mtime for path in _files(folder)]
    return BackupSeen(folder=str(folder), newest_unix_s=max(moments, default=None))


def _files(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.rglob("*") if path.is_file()]
    except OSError:
        return []


def _sync_times_s(folder: Path) -> tuple[float, ...]:
    """Return how long each of some writes takes until it is on the disk, after a first one that makes the file."""
    times_s = []
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".roadgrip-doctor-") as file:
        for _ in range(SYNCS_COUNT + 1):
            began_s = time.perf_counter()
            os.write(file.fileno(), os.urandom(SYNC_BYTES))
            os.fdatasync(file.fileno())
            times_s.append(time.perf_counter() - began_s)
    return tuple(times_s[1:])


def _mount_of(folder: Path, *, root: Path) -> tuple[str, bool]:
    """Return the type of the file system that holds a folder, and whether it is mounted read-only."""
    try:
        lines = (root / "proc" / "self" / "mountinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return "", False
    there = folder.resolve()
    found, depth_count = ("", False), -1
    for line in lines:
        before, _, after = line.partition(" - ")
        words, kinds = before.split(), after.split()
        if len(words) < 6 or not kinds:
            continue
        # Blanks and the like are written as octal numbers.
        point = Path(words[4].encode().decode("unicode_escape"))
        options = {*words[5].split(","), *(kinds[2].split(",") if len(kinds) > 2 else ())}
        # Of two mounts at one point the later one is seen.
        if there.is_relative_to(point) and len(point.parts) >= depth_count:
            found, depth_count = (kinds[0], "ro" in options), len(point.parts)
    return found


def _kind_of(folder: Path, file_system: str, *, root: Path) -> DiskKind:
    if file_system in _NETWORKS:
        return DiskKind.NETWORK
    if file_system in _IN_MEMORY:
        return DiskKind.MEMORY
    number = folder.stat().st_dev
    device = root / "sys" / "dev" / "block" / f"{os.major(number)}:{os.minor(number)}"
    with suppress(OSError):
        device = device.resolve(strict=True)
        if any(part.startswith("mmcblk") for part in device.parts):
            return DiskKind.CARD
        # A partition has no queue of its own; its disk, the folder above, does.
        for place in (device, device.parent):
            rotational = _number(place / "queue" / "rotational")
            if rotational is not None:
                return DiskKind.ROTATING if rotational else DiskKind.SOLID
    return DiskKind.UNKNOWN


def _number(path: Path) -> float | None:
    try:
        return float(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


def _counted(path: Path) -> dict[str, int]:
    """Return the counters of a control group's file, nothing if it cannot be read."""
    try:
        rows = [line.split() for line in path.read_text(encoding="ascii").splitlines()]
    except OSError:
        return {}
    return {words[0]: int(words[1]) for words in rows if len(words) == 2 and words[1].isdigit()}

"""How the process itself is doing: traffic of the last minute, its clock, its disk, its memory.

`look` is called every few seconds, so that whoever asks afterwards hears of the minute before, and of a clock that was
set meanwhile. Nothing here waits for the database.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from pathlib import Path

from rsu_app.adapters.kernel_clock import kernel_clock
from rsu_app.observability import Metrics
from rsu_app.ports import Clock, WriterPulse
from rsu_app.usecases.readiness import Check, ClockSteps, ClockWatch

LOOK_PERIOD_S = 5.0
MINUTE_S = 60.0
_LOOKS_COUNT = round(MINUTE_S / LOOK_PERIOD_S) + 1
_NO_LIMIT = "max"


@dataclass(frozen=True, slots=True)
class ClockSigns:
    """What is known about both clocks.

    Attributes:
        wall: Whether the wall clock names a possible year and is steady.
        steps: How often it was set since the start.
        synchronised: Whether the kernel says that something keeps it right; None where it does not say.
        max_error_s: How wrong it may be at most by the kernel's account; None unless it is kept right.
    """

    wall: Check
    steps: ClockSteps
    synchronised: bool | None
    max_error_s: float | None


@dataclass(frozen=True, slots=True)
class DiskRoom:
    """Room of the file system that holds the database.

    Attributes:
        free_bytes: What this account may still write.
        size_bytes: All of it.
    """

    free_bytes: int
    size_bytes: int


@dataclass(frozen=True, slots=True)
class ProcessSigns:
    """What the process takes.

    Attributes:
        process_number: Its number.
        up_s: Since its start.
        resident_bytes: Memory it holds.
        peak_bytes: The most it ever held.
        files_count: Open files and sockets.
    """

    process_number: int
    up_s: float
    resident_bytes: int
    peak_bytes: int
    files_count: int


class VitalSigns:
    """Looks at a unit from inside, every few seconds.

    Args:
        clock: Both clocks of the unit.
        metrics: Where outcomes are counted.
        now_s: The machine's monotonic clock, also when the unit's own is accelerated.
    """

    def __init__(self, clock: Clock, metrics: Metrics, *, now_s: Callable[[], float] = time.monotonic) -> None:
        self._metrics = metrics
        self.now_s = now_s
        self._started_at_s = now_s()
        self._turn_at_s: float | None = None
        self._watch = ClockWatch(clock)
        self._looks: deque[tuple[float, dict[str, int]]] = deque([(now_s(), {})], maxlen=_LOOKS_COUNT)

    def look(self) -> None:
        """Take note of what has been counted so far, and of the clock."""
        self._looks.append((self.now_s(), outcome_counts(self._metrics)))
        self._wall()

    def take_turn(self, period_s: float) -> bool:
        """Return whether something that is asked for often is due again, and begin anew to wait if so."""
        now_s = self.now_s()
        if self._turn_at_s is not None and now_s - self._turn_at_s < period_s:
            return False
        self._turn_at_s = now_s
        return True

    def rates_per_s(self) -> dict[str, float]:
        """Return how many passages were answered in a second, by outcome, over the last minute or since the start."""
        began_at_s, before = self._looks[0]
        over_s = max(self.now_s() - began_at_s, LOOK_PERIOD_S)
        counts = outcome_counts(self._metrics)
        return {outcome: (count - before.get(outcome, 0)) / over_s for outcome, count in counts.items()}

    def clock(self) -> ClockSigns:
        """Return what is known about both clocks now."""
        kernel = kernel_clock()
        return ClockSigns(
            wall=self._wall(),
            steps=self._watch.steps,
            synchronised=None if kernel is None else kernel.synchronised,
            max_error_s=kernel.max_error_s if kernel is not None and kernel.synchronised else None,
        )

    def process(self) -> ProcessSigns:
        """Return what the process takes now."""
        memory = status_fields(Path("/proc/self/status"))
        return ProcessSigns(
            process_number=os.getpid(),
            up_s=self.now_s() - self._started_at_s,
            resident_bytes=memory.get("VmRSS", 0),
            peak_bytes=memory.get("VmHWM", 0),
            files_count=len(_entries(Path("/proc/self/fd"))),
        )

    def _wall(self) -> Check:
        before_count = self._watch.steps.steps_count
        check = self._watch.check()
        self._metrics.clock_steps.inc(self._watch.steps.steps_count - before_count)
        return check


def outcome_counts(metrics: Metrics) -> dict[str, int]:
    """Return how many passages were answered since the start, by outcome."""
    counts: dict[str, int] = {}
    for labels, count in metrics.passage_counts():
        counts[labels["outcome"]] = counts.get(labels["outcome"], 0) + count
    return counts


def disk_room(folder: Path) -> DiskRoom | None:
    """Return the room of the file system below a folder, None if that cannot be told."""
    try:
        found = os.statvfs(folder)
    except OSError:
        return None
    return DiskRoom(free_bytes=found.f_bavail * found.f_frsize, size_bytes=found.f_blocks * found.f_frsize)


def status_fields(path: Path) -> dict[str, int]:
    """Return the sizes that a file such as /proc/self/status or /proc/meminfo holds, in bytes; nothing elsewhere."""
    words = (line.replace(":", " ").split() for line in _lines(path))
    return {found[0]: int(found[1]) * 1024 for found in words if len(found) == 3 and found[2] == "kB"}


def kernel_drops_count(process: str = "self", *, root: Path = Path("/")) -> int:
    """Return how many datagrams the kernel dropped since a process opened its UDP sockets, for want of room in them.

    Args:
        process: Its number, or "self".
        root: The file system to read; tests have their own.
    """
    folder = root / "proc" / process
    inodes = _socket_inodes(folder / "fd")
    drops_count = 0
    for name in ("udp", "udp6"):
        rows = _lines(folder / "net" / name)[1:]
        # Columns of /proc/net/udp: the tenth is the socket's inode, the last what was dropped.
        drops_count += sum(int(words[-1]) for words in map(str.split, rows) if len(words) > 12 and words[9] in inodes)
    return drops_count


def memory_limit_bytes(process: str = "self", *, root: Path = Path("/")) -> int | None:
    """Return the tightest bound on memory of a process's control groups (version 2), None without any.

    Args:
        process: Its number, or "self".
        root: The file system to read; tests have their own.
    """
    limits = [limit for folder in control_groups(process, root=root) if (limit := _limit_of(folder / "memory.max"))]
    return min(limits, default=None)


def control_groups(process: str = "self", *, root: Path = Path("/")) -> list[Path]:
    """Return the folders of a process's control groups (version 2), its own first; nothing where there are none."""
    lines = _lines(root / "proc" / process / "cgroup")
    # The one hierarchy of version 2 is written as `0::/path`.
    name = next((line[3:] for line in lines if line.startswith("0::")), None)
    if name is None:
        return []
    top = root / "sys" / "fs" / "cgroup"
    inside = top / name.lstrip("/")
    return [folder for folder in (inside, *inside.parents) if folder.is_relative_to(top)]


def show_vital_signs(
    signs: VitalSigns, pulse: WriterPulse, *, folder: Path, damaged_count: int, metrics: Metrics
) -> None:
    """Bring the gauges of clock, disk and memory up to date.

    Args:
        signs: Of the process.
        pulse: Of the writer.
        folder: Where the database is.
        damaged_count: Damaged databases that lie beside it.
        metrics: Whose gauges.
    """
    clock, room, limit_bytes = signs.clock(), disk_room(folder), memory_limit_bytes()
    # A gauge without a value is NaN: zero would be a clock known to be wrong, a disk without room.
    metrics.clock_synchronised.set(nan if clock.synchronised is None else clock.synchronised)
    metrics.clock_max_error.set(nan if clock.max_error_s is None else clock.max_error_s)
    metrics.disk_free.set(nan if room is None else room.free_bytes)
    metrics.disk_size.set(nan if room is None else room.size_bytes)
    metrics.commit_age.set(nan if pulse.committed_ago_s is None else pulse.committed_ago_s)
    metrics.writer_busy.set(pulse.busy_s)
    metrics.damaged_kept.set(damaged_count)
    metrics.udp_kernel_drops.set(kernel_drops_count())
    metrics.memory_limit.set(nan if limit_bytes is None else limit_bytes)


def _socket_inodes(folder: Path) -> set[str]:
    """Return the inodes of the sockets that a process has open, as the kernel's tables name them."""
    inodes = set()
    for name in _entries(folder):
        try:
            link = os.readlink(folder / name)  # noqa: PTH115 - `socket:[4711]` is no path
        except OSError:  # closed meanwhile, as what the folder itself was read with
            continue
        if link.startswith("socket:["):
            inodes.add(link[len("socket:[") : -1])
    return inodes


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return []


def _limit_of(path: Path) -> int | None:
    try:
        said = path.read_text(encoding="ascii").strip()
    except OSError:
        return None
    return None if said == _NO_LIMIT or not said.isdigit() else int(said)


def _entries(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208 - names, as the kernel writes them
    except OSError:
        return []

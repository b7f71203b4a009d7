"""Summaries that no road side unit has acknowledged yet, on disk, bounded.

One small JSON file per summary. A file appears whole or not at all (written beside, flushed to the disk, renamed), so
that a vehicle switched off at any moment loses at most the summary it was about to keep. When the spool is full the
oldest summary goes.

How old a summary is can be said only by the clock that saw the vehicle leave the section. `boot_clock` gives the
machine's clock since it was switched on together with a name for that stretch of time; a summary from another one
has no known age and is dropped. Whatever is dropped is counted, never silently lost.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from roadgrip.errors import RoadgripError
from roadgrip.records import PASSAGE_ID_BYTES, KinematicSummary, QualityFlag
from vehicle_client.shell.whole_file import PART_SUFFIX, write_whole

FORMAT_VERSION = 1
CAPACITY_COUNT = 100
"""Summaries kept by default: a long day of curves without a unit in reach, some 200 kB."""
ENTRY_LIMIT_BYTES = 16_384
_SUFFIX = ".json"


class SpoolError(RoadgripError):
    """The spool's folder cannot be used; the message says why."""


@dataclass(frozen=True, slots=True)
class SpooledSummary:
    """A summary that waits for a road side unit.

    Attributes:
        passage_id: 16 bytes; with it the unit recognises what it already has.
        section_id: The section that was driven.
        map_version: The map the summary was cut with.
        summary: The statistics of the trace.
        left_at_s: When the vehicle left the section, on the clock that `clock_id` names.
        clock_id: Which clock; another one says nothing about the age.
        frames_spent_count: Frames of the passage's budget that are already used.
    """

    passage_id: bytes
    section_id: str
    map_version: str
    summary: KinematicSummary
    left_at_s: float
    clock_id: str
    frames_spent_count: int


@dataclass(slots=True)
class SpoolCounts:
    """What happened to summaries since the spool was opened.

    Attributes:
        overflowed_count: Oldest ones dropped because the spool was full.
        age_unknown_count: Dropped because the clock that knew their age is gone.
        unreadable_count: Files dropped because they hold no summary.
    """

    overflowed_count: int = 0
    age_unknown_count: int = 0
    unreadable_count: int = 0


def boot_clock() -> tuple[str, float]:
    """Return a name for the time since the machine was switched on, and how many seconds that is.

    Sleep counts. Where the machine does not name its boots, every start of this process is another clock, so that an
    age is never made up.
    """
    boot_id = Path("/proc/sys/kernel/random/boot_id")
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    if clock is None or not boot_id.exists():
        return f"process-{os.getpid()}-{time.time_ns()}", time.monotonic()
    return boot_id.read_text(encoding="ascii").strip(), time.clock_gettime(clock)


class BootClock:
    """The clock of `boot_clock` for everything that a running process counts: exchanges, advice, ages in the spool."""

    def __init__(self) -> None:
        """Read the clock's name once."""
        self.clock_id, _ = boot_clock()
        self._source = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)

    def now_s(self) -> float:
        """Return the seconds."""
        return time.clock_gettime(self._source)

    def wall_s(self, duration_s: float) -> float:
        """Return the duration itself."""
        return duration_s


class Spool:
    """A folder of summaries; only one process may use it."""

    def __init__(self, folder: Path, *, clock_id: str, capacity_count: int = CAPACITY_COUNT) -> None:
        """Open a folder, make it if need be, and drop what has no known age.

        Args:
            folder: Holds one file per summary and nothing else.
            clock_id: The clock that now runs.
            capacity_count: Summaries kept; the oldest goes when one more comes.

        Raises:
            SpoolError: The folder cannot be made or written.
        """
        if capacity_count < 1:
            raise SpoolError(f"a spool keeps at least one summary, not {capacity_count}")
        self._folder = folder
        self._clock_id = clock_id
        self._capacity_count = capacity_count
        self._entries: dict[int, SpooledSummary] = {}
        self._in_delivery: set[int] = set()
        self._next = 0
        self.counts = SpoolCounts()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._load()
        except OSError as error:
            raise SpoolError(f"cannot use {folder} as a spool: {error.strerror}") from error

    def __len__(self) -> int:
        """Return how many summaries wait."""
        return len(self._entries)

    def waiting(self) -> tuple[SpooledSummary, ...]:
        """Return the summaries that wait, oldest first."""
        return tuple(self._entries[number] for number in sorted(self._entries))

    def keep(self, entry: SpooledSummary) -> None:
        """Write a summary so that it outlives this process; replaces an earlier one of the same passage.

        Raises:
            SpoolError: The disk takes nothing; the spool is as it was.
        """
        if entry.clock_id != self._clock_id:
            raise SpoolError(f"the summary's clock is {entry.clock_id}, the spool's {self._clock_id}")
        number = self._number_of(entry.passage_id)
        if number is None:
            number = self._next
        try:
            write_whole(self._path(number), _to_json(entry))
        except OSError as error:
            raise SpoolError(f"cannot keep a summary in {self._folder}: {error.strerror}") from error
        self._next = max(self._next, number + 1)
        self._entries[number] = entry
        self._make_room()

    @contextlib.contextmanager
    def delivering(self, passage_id: bytes) -> Iterator[bool]:
        """Hold on to a summary while it is on its way, and yield whether it is still there.

        A summary that comes meanwhile finds no room at the expense of this one: it would be counted as dropped, and
        then delivered after all. The spool may hold more than its capacity until the delivery has ended.
        """
        number = self._number_of(passage_id)
        if number is None or number in self._in_delivery:
            yield False
            return
        self._in_delivery.add(number)
        try:
            yield True
        finally:
            self._in_delivery.discard(number)
            self._make_room()

    def drop(self, passage_id: bytes) -> None:
        """Forget a summary, because it was delivered or never will be; nothing happens if it is not there."""
        number = self._number_of(passage_id)
        if number is not None:
            self._forget(number)

    def _number_of(self, passage_id: bytes) -> int | None:
        return next((n for n, e in self._entries.items() if e.passage_id == passage_id), None)

    def _path(self, number: int) -> Path:
        return self._folder / f"{number:012d}{_SUFFIX}"

    def _forget(self, number: int) -> None:
        try:
            self._path(number).unlink(missing_ok=True)
        except OSError as error:
            raise SpoolError(f"cannot remove a summary from {self._folder}: {error.strerror}") from error
        self._entries.pop(number, None)

    def _make_room(self) -> None:
        # What is on its way takes no room until it comes back.
        while len(self._entries) > self._capacity_count + len(self._in_delivery):
            self._forget(min(self._entries.keys() - self._in_delivery))
            self.counts.overflowed_count += 1

    def _load(self) -> None:
        for leftover in self._folder.glob(f"*{_SUFFIX}{PART_SUFFIX}"):
            leftover.unlink()
        for path in sorted(self._folder.glob(f"*{_SUFFIX}")):
            entry = _read(path)
            if entry is None or not path.stem.isdecimal():
                path.unlink()
                self.counts.unreadable_count += 1
            elif entry.clock_id != self._clock_id:
                path.unlink()
                self.counts.age_unknown_count += 1
            else:
                self._entries[int(path.stem)] = entry
                self._next = max(self._next, int(path.stem) + 1)
        self._make_room()


def _to_json(entry: SpooledSummary) -> str:
    return json.dumps(
        {
            "format_version": FORMAT_VERSION,
            "passage_id": entry.passage_id.hex(),
            "section_id": entry.section_id,
            "map_version": entry.map_version,
            "values": entry.summary.values,
            "table_digest": entry.summary.table_digest,
            "duration_s": entry.summary.duration_s,
            "quality": int(entry.summary.quality),
            "left_at_s": entry.left_at_s,
            "clock_id": entry.clock_id,
            "frames_spent_count": entry.frames_spent_count,
        }
    )


def _read(path: Path) -> SpooledSummary | None:
    """Return what a file holds, or None if that is no summary."""
    try:
        if path.stat().st_size > ENTRY_LIMIT_BYTES:
            return None
        raw: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if raw["format_version"] != FORMAT_VERSION or len(bytes.fromhex(raw["passage_id"])) != PASSAGE_ID_BYTES:
            return None
        return SpooledSummary(
            passage_id=bytes.fromhex(raw["passage_id"]),
            section_id=str(raw["section_id"]),
            map_version=str(raw["map_version"]),
            summary=KinematicSummary(
                values=tuple(float(v) for v in raw["values"]),
                table_digest=str(raw["table_digest"]),
                duration_s=float(raw["duration_s"]),
                quality=QualityFlag(int(raw["quality"])),
            ),
            left_at_s=float(raw["left_at_s"]),
            clock_id=str(raw["clock_id"]),
            frames_spent_count=int(raw["frames_spent_count"]),
        )
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        return None

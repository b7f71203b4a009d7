"""What is on a disk after a power cut: worked out from a record of everything that was done to its files.

The model is that of Linux without mercy. Each file has pages of 4096 bytes in memory, which alone are read and written.
`fsync` makes the pages that changed lasting. If it fails, they count as clean all the same and are never tried again
unless they change once more. At the cut each page that changed since the last `fsync` has reached the disk, or has not,
or has with some of its sectors. A name lasts after an `fsync` of its folder; at the cut the names given, moved and
taken since then hold up to some moment.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

PAGE_BYTES = 4096
SECTOR_BYTES = 512
_HEAD = struct.Struct("<4q")


@dataclass(frozen=True, slots=True)
class Call:
    """One call that changed files, or made a change last.

    Attributes:
        kind: O opened anew, W written, T cut to a length, S synced, D folder synced, U name taken, R name moved.
        inode: The file.
        offset: Where; for O whether the name is new; for S and D whether it succeeded.
        data: What was written, or the names.
        end: Length of the log with it.
    """

    kind: str
    inode: int
    offset: int
    data: bytes
    end: int


def calls(log: bytes) -> Iterator[Call]:
    """Yield what a log holds; a last record that is cut off is none."""
    at = 0
    while at + _HEAD.size <= len(log):
        kind, inode, offset, length = _HEAD.unpack_from(log, at)
        at += _HEAD.size
        if at + length > len(log):
            return
        yield Call(chr(kind), inode, offset, log[at : at + length], at + length)
        at += length


@dataclass
class _File:
    memory: bytearray = field(default_factory=bytearray)
    lasting: bytearray = field(default_factory=bytearray)
    changed: set[int] = field(default_factory=set)
    length_changed: bool = False

    def write(self, offset: int, data: bytes) -> None:
        if len(self.memory) < offset + len(data):
            self.resize(offset + len(data))
        self.memory[offset : offset + len(data)] = data
        self.changed |= set(range(offset // PAGE_BYTES, (offset + len(data) - 1) // PAGE_BYTES + 1))

    def resize(self, length: int) -> None:
        self.length_changed = True
        if length < len(self.memory):
            del self.memory[length:]
        else:
            self.memory.extend(bytes(length - len(self.memory)))

    def sync(self, *, succeeded: bool) -> None:
        if succeeded:
            self._make_last(self.changed)
            _fit(self.lasting, len(self.memory))
        self.changed.clear()
        self.length_changed = False

    def _make_last(self, pages: Iterable[int]) -> None:
        for page in pages:
            part = slice(page * PAGE_BYTES, (page + 1) * PAGE_BYTES)
            content = self.memory[part]
            if len(self.lasting) < part.start + len(content):
                self.lasting.extend(bytes(part.start + len(content) - len(self.lasting)))
            self.lasting[part.start : part.start + len(content)] = content

    def after_cut(self, chance: random.Random, *, kept_frac: float) -> bytes:
        left = bytearray(self.lasting)
        if self.length_changed and chance.random() < 0.5:
            _fit(left, len(self.memory))
        for page in sorted(self.changed):
            fate = chance.random()
            if fate > kept_frac:
                continue
            content = self.memory[page * PAGE_BYTES : (page + 1) * PAGE_BYTES]
            sectors = range(0, len(content), SECTOR_BYTES)
            # One page in four that arrives is torn: some of its sectors are new.
            arrived = [at for at in sectors if fate > kept_frac / 4 or chance.random() < 0.5]
            for at in arrived:
                piece = content[at : at + SECTOR_BYTES]
                start = page * PAGE_BYTES + at
                if len(left) < start + len(piece):
                    left.extend(bytes(start + len(piece) - len(left)))
                left[start : start + len(piece)] = piece
        return bytes(left)


def _fit(content: bytearray, length: int) -> None:
    if length < len(content):
        del content[length:]
    else:
        content.extend(bytes(length - len(content)))


class Disk:
    """The files below one folder, as a log tells of them from their beginning on."""

    def __init__(self) -> None:
        self._files: dict[int, _File] = {}
        self._names: dict[str, _File] = {}
        self._lasting_names: dict[str, _File] = {}
        self._names_since: list[dict[str, _File]] = []

    def apply(self, call: Call) -> None:
        """Do what was done."""
        file = self._files.get(call.inode)
        match call.kind:
            case "O":
                self._opened(call)
            case "W" if file is not None:
                file.write(call.offset, call.data)
            case "T" if file is not None:
                file.resize(call.offset)
            case "S" if file is not None:
                file.sync(succeeded=bool(call.offset))
            case "D" if call.offset:
                self._lasting_names, self._names_since = dict(self._names), []
            case "U":
                self._names.pop(call.data.decode(), None)
                self._files.pop(call.inode, None)
                self._names_since.append(dict(self._names))
            case "R":
                old, new = call.data.decode().split("\0")
                self._names[new] = self._names.pop(old)
                self._names_since.append(dict(self._names))
            case _:
                pass

    def after_cut(self, chance: random.Random) -> dict[str, bytes]:
        """Return each file's content by its name, as it is found after a power cut now."""
        # Nothing, everything or a part of what did not have to last.
        kept_frac = chance.choice((0.0, 1.0, chance.random()))
        names = chance.choice((self._lasting_names, *self._names_since))
        return {name: file.after_cut(chance, kept_frac=kept_frac) for name, file in names.items()}

    def _opened(self, call: Call) -> None:
        name = call.data.decode()
        if call.offset:
            self._files[call.inode] = self._names[name] = _File()
            self._names_since.append(dict(self._names))
        elif call.inode in self._files:
            self._files[call.inode].resize(0)


def cuts(log: bytes, moments: Iterable[int], *, chance: random.Random) -> Iterator[tuple[int, dict[str, bytes]]]:
    """Yield the files after a power cut at each of the moments, in order, each with its moment.

    Args:
        log: Of a folder that was empty at first.
        moments: Lengths of the log.
        chance: What of the unsynced survives.
    """
    disk, ahead = Disk(), sorted(moments, reverse=True)
    for call in calls(log):
        while ahead and ahead[-1] < call.end:
            yield ahead.pop(), disk.after_cut(chance)
        disk.apply(call)
    while ahead:
        yield ahead.pop(), disk.after_cut(chance)


def boundaries(log: bytes) -> list[int]:
    """Return the moments between two calls."""
    return [0, *(call.end for call in calls(log))]


def within_copying(log: bytes, *, calls_count: int = 40) -> list[int]:
    """Return the moments in which a log was being copied that an `fsync` had failed for not long before.

    These are behind writes to a database, up to so many calls after the `fsync` of another file that succeeded where
    the one before it had failed: there SQLite is in danger of taking for lasting what is not.
    """
    failed: set[int] = set()
    recovered, left_count, moments = 0, 0, []
    for call in calls(log):
        if call.kind == "S":
            if call.offset and call.inode in failed:
                recovered, left_count = call.inode, calls_count
            (failed.discard if call.offset else failed.add)(call.inode)
        if left_count:
            left_count -= 1
            if call.kind == "W" and call.inode != recovered and len(call.data) == PAGE_BYTES:
                moments.append(call.end)
    return moments


def restore(files: dict[str, bytes], *, folder: Path, into: Path, beginning: str) -> None:
    """Write files that a power cut left into another folder; only those whose name begins so, and no shared memory."""
    for name, content in files.items():
        path = Path(name)
        if path.parent == folder and path.name.startswith(beginning) and not path.name.endswith("-shm"):
            (into / path.name).write_bytes(content)

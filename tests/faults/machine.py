"""A machine whose disk and clock do as they are told, for a program in a process of its own. See `machine.c`."""

from __future__ import annotations

import ctypes
import mmap
import os
import shutil
import struct
import subprocess
import time
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import gettempdir

from tests.faults.power_cut import calls

SOURCE = Path(__file__).with_name("machine.c")
FIELDS = (
    "wall_offset_ns",
    "write_errno",
    "sync_errno",
    "read_errno",
    "open_errno",
    "room_bytes",
    "sync_delay_us",
    "recorded_bytes",
    "refused_count",
)
"""Of the control block, 64 bits each, as `struct control` has them."""
NO_LIMIT = -1


class Machine:
    """One disk and one clock.

    Args:
        folder: Whose files fail and are recorded; it exists.
        place: Where the control block and the log lie; not in the folder.
        recorded: Whether everything that happens to the files is written down.
        beginning: Of the names of the files that are meant; all of them if it is empty.
    """

    def __init__(self, folder: Path, place: Path, *, recorded: bool = False, beginning: str = "") -> None:
        self.folder = folder.resolve()
        self._control_path, self.log_path = place / "control", place / "disk.log"
        self._control_path.write_bytes(bytes(8 * len(FIELDS)))
        self.log_path.write_bytes(b"")
        self._recorded = recorded
        self._beginning = beginning
        with self._control_path.open("r+b") as file:
            self._control = mmap.mmap(file.fileno(), 0)
        self.whole()

    def join(self) -> tuple[str, str, str, str]:
        """Return what a process tells `take_over` to live on this machine; the one before it has ended."""
        log = str(self.log_path) if self._recorded else ""
        if log:
            # Who was killed may have left half a record, or a whole one that was not counted any more.
            content = self.log_path.read_bytes()
            whole_bytes = max((call.end for call in calls(content)), default=0)
            os.truncate(self.log_path, whole_bytes)
            self.set(recorded_bytes=whole_bytes)
        return str(self.folder), f"{self.folder}/{self._beginning}", str(self._control_path), log

    def set(self, **values: int) -> None:
        """Change fields of the control block; holds at once, also for files that are open."""
        for name, value in values.items():
            struct.pack_into("<q", self._control, 8 * FIELDS.index(name), value)

    def get(self, name: str) -> int:
        """Return a field of the control block."""
        (value,) = struct.unpack_from("<q", self._control, 8 * FIELDS.index(name))
        return int(value)

    def whole(self) -> None:
        """Let the disk do its work again; the clock stays as it is."""
        self.set(write_errno=0, sync_errno=0, read_errno=0, open_errno=0, room_bytes=NO_LIMIT)

    def now_unix_s(self) -> float:
        """Return what its wall clock says."""
        return time.time() + self.get("wall_offset_ns") / 1e9

    @property
    def refused_count(self) -> int:
        """Calls that were refused since the start."""
        return self.get("refused_count")

    @property
    def recorded_bytes(self) -> int:
        """Length of the log: a moment in the life of the disk."""
        return self.get("recorded_bytes")


def take_over(folder: str, path_beginning: str, control: str, log: str) -> None:
    """Let this process, which was loaded with the library, live on a machine from now on.

    Raises:
        OSError: It was not.
    """
    begin = ctypes.CDLL(None).machine_begin
    begin(*(text.encode() for text in (folder, path_beginning, control, log)))


def can_be_made() -> bool:
    """Return whether this computer has a C compiler."""
    return shutil.which("gcc") is not None


@cache
def shim() -> Path:
    """Return the compiled library. Made once for each version of its source."""
    digest = sha256(SOURCE.read_bytes()).hexdigest()[:16]
    target = Path(gettempdir()) / f"roadgrip-machine-{digest}.so"
    if not target.exists():
        fresh = target.with_suffix(f".{id(target)}")
        command = ["gcc", "-shared", "-fPIC", "-O1", "-Wall", "-o", str(fresh), str(SOURCE), "-ldl", "-lpthread"]
        subprocess.run(command, check=True)
        # Two test workers may make it at one time.
        fresh.replace(target)
    return target

"""A process that is measured, with its children: processor time, memory, and the core it runs on. Linux only."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_BYTES_PER_MB = 1e6
_STOP_S = 15.0


def measured_core() -> set[int]:
    """Return the core that what is measured runs on: the first one that this process may use."""
    return {min(_cores())}


def loading_core() -> set[int]:
    """Return the core that the load comes from; with a single one the two share it, which the figures then show."""
    return {max(_cores())}


def _cores() -> set[int]:
    return set(range(os.cpu_count() or 1)) if not hasattr(os, "sched_getaffinity") else _ALLOWED


_ALLOWED = os.sched_getaffinity(0)


def family_of(process_id: int) -> list[int]:
    """Return a process and all that descend from it."""
    found = [process_id]
    for parent in found:
        for task in Path(f"/proc/{parent}/task").glob("*/children"):
            try:
                found += map(int, task.read_text(encoding="ascii").split())
            except OSError:
                continue  # it ended while it was looked at
    return found


def cpu_s(process_id: int) -> float:
    """Return the processor time of a process, its children and all their threads, in user and kernel mode."""
    ticks = 0
    for member in family_of(process_id):
        fields = _stat(member)
        ticks += int(fields[11]) + int(fields[12]) if fields else 0
    return ticks / _TICKS_PER_S


def resident_mb(process_id: int) -> float:
    """Return the memory that a process and its children have resident; what they share counts for each."""
    pages = 0
    for member in family_of(process_id):
        fields = _stat(member)
        pages += int(fields[21]) if fields else 0
    return pages * _PAGE_BYTES / _BYTES_PER_MB


def _stat(process_id: int) -> list[str]:
    """Return the fields of /proc/PID/stat behind the name, which may hold blanks; none if the process is gone."""
    try:
        return Path(f"/proc/{process_id}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
    except OSError:
        return []


@contextmanager
def running(
    command: Sequence[str | Path], *, log: Path, environment: Mapping[str, str] | None = None, cwd: Path | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Give a process on the measured core, and end it with its children.

    Args:
        command: What to run.
        log: Takes what it writes.
        environment: Variables besides those of this process.
        cwd: Where it runs.
    """
    core = measured_core()
    with log.open("ab") as sink:
        process = subprocess.Popen(
            [str(word) for word in command],
            stdout=sink,
            stderr=subprocess.STDOUT,
            env={**os.environ, **(environment or {})},
            cwd=cwd,
            start_new_session=True,
            preexec_fn=lambda: os.sched_setaffinity(0, core),  # noqa: PLW1509 - this program has one thread here
        )
    try:
        yield process
    finally:
        _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    # The session is the process's own, so its group holds its children and nobody else.
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(process.pid, number)
        except ProcessLookupError:
            break
        try:
            process.wait(timeout=_STOP_S)
            break
        except subprocess.TimeoutExpired:
            continue


def wait_until(
    holds: Callable[[], bool], process: subprocess.Popen[bytes], *, log: Path, limit_s: float, every_s: float = 0.005
) -> None:
    """Return when something holds.

    Args:
        holds: What is waited for.
        process: Must live meanwhile.
        log: What it wrote, for the message.
        limit_s: How long is waited.
        every_s: How often is looked.

    Raises:
        RuntimeError: The process ended or the time is up; the message ends with what it wrote.
    """
    give_up_s = time.monotonic() + limit_s
    while not holds():
        if process.poll() is not None or time.monotonic() > give_up_s:
            told = log.read_text(encoding="utf-8", errors="replace")[-2_000:]
            what = "it ended" if process.poll() is not None else f"nothing within {limit_s:.0f} s"
            raise RuntimeError(f"the server did not start: {what}\n{told}")
        time.sleep(every_s)

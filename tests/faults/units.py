"""Units to be killed by the hundred: the real service, forked from a process that has imported everything already.

What runs in the fork is `rsu_app.service.run` with real sockets and a real disk, as `roadgrip-rsu serve` calls it; only
the two seconds of imports are saved.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.forkserver
import os
import signal
import sys
import time
from collections.abc import Sequence
from functools import cache
from multiprocessing.context import ForkServerContext
from pathlib import Path
from subprocess import TimeoutExpired
from typing import BinaryIO

from tests.faults.machine import Machine, can_be_made, shim, take_over
from tests.faults.sabotage import break_unit
from tests.system.daemons import Daemon, Process

DATABASE_NAME = "rsu.sqlite3"
_IMPORTED = ("tests.faults.units", "rsu_app.service", "rsu_app.adapters.inference", "alembic.command", "uvloop")


class FragileUnit(Daemon):
    """A unit that is quick to start, on a machine that may fail, with code that may be broken on purpose.

    Args:
        folder: As for any daemon.
        settings: More TOML; what stands before its first table belongs to `[udp]`.
        machine: Its disk and clock; None for those of this computer.
        broken: Names what of `tests.faults.sabotage` is broken in it; empty for nothing.
        small_log: Whether the database's log is emptied every few commits.
        time_zone: Of its local time; empty for that of this computer.
        ports: HTTP and UDP.
    """

    def __init__(
        self,
        folder: Path,
        settings: str = "",
        *,
        machine: Machine | None = None,
        broken: str = "",
        small_log: bool = False,
        time_zone: str = "",
        ports: tuple[int, int] = (0, 0),
    ) -> None:
        super().__init__(folder, settings, ports=ports)
        self._machine = machine
        self._time_zone = time_zone
        self._changes = ("small log",) * small_log + (broken,)

    @property
    def database(self) -> Path:
        """Its database."""
        return self.folder / DATABASE_NAME

    def begin(self, sink: BinaryIO) -> Process:
        machine = None if self._machine is None else self._machine.join()
        told = (str(self.config), str(self.log), machine, self._changes, self._time_zone)
        process = fork_context().Process(target=_serve, args=told)
        process.start()
        return _Forked(process)

    def conditions(self) -> dict[str, tuple[bool, str]]:
        """Return what readiness says: for each condition whether it holds, and why not."""
        said = self.client.get("/health/ready").json()["conditions"]
        return {condition["name"]: (condition["ok"], condition["detail"]) for condition in said}

    def stored_ids(self) -> list[bytes]:
        """Return the ids of all passages in the database."""
        return [row[0] for row in self.rows("SELECT passage_id FROM passages")]

    def window_count_once(self, wanted_count: int, *, seconds: float = 30.0) -> int:
        """Return how many vehicles count once so many do, or else in the end: a large window is restored later."""
        until_s = time.monotonic() + seconds
        while (count := self.window_count()) != wanted_count and time.monotonic() < until_s:
            time.sleep(0.05)
        return count


class _Forked:
    """A process of `multiprocessing`, with the face of one of `subprocess`."""

    def __init__(self, process: multiprocessing.process.BaseProcess) -> None:
        self._process = process
        assert process.pid is not None
        self.pid = process.pid

    def poll(self) -> int | None:
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise TimeoutExpired("serve", timeout or 0.0)
        return self._process.exitcode

    def kill(self) -> None:
        self._process.kill()

    def send_signal(self, sig: int, /) -> None:
        os.kill(self.pid, sig)


@cache
def fork_context() -> ForkServerContext:
    """Return where processes are forked that have everything imported already."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(_IMPORTED))
    if can_be_made():
        # The library does nothing until a fork takes over a machine.
        before = os.environ.get("LD_PRELOAD")
        os.environ["LD_PRELOAD"] = str(shim())
        try:
            multiprocessing.forkserver.ensure_running()
        finally:
            if before is None:
                del os.environ["LD_PRELOAD"]
            else:
                os.environ["LD_PRELOAD"] = before
    return context


def _serve(config: str, log: str, machine: Sequence[str] | None, changes: Sequence[str], time_zone: str) -> None:
    if time_zone:
        os.environ["TZ"] = time_zone
        time.tzset()
    sink = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    os.dup2(sink, sys.stdout.fileno())
    os.dup2(sink, sys.stderr.fileno())
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # a plain text stream
    signal.set_wakeup_fd(-1)
    if machine is not None:
        take_over(*machine)
    from rsu_app.service import run
    from rsu_app.settings import load_settings

    for name in changes:
        break_unit(name)
    run(load_settings(Path(config)))

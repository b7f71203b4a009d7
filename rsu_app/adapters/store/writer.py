"""The one thread that writes.

Passages wait in a bounded queue; the thread takes as many as there are, writes them in one transaction, and only after
its commit tells those who wait. One fsync costs milliseconds, so a commit per passage would cap the unit at a few
hundred passages per second; in groups it takes tens of thousands.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import sqlite3
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias, cast

from sqlalchemy import Connection, Engine
from sqlalchemy.exc import DBAPIError

from roadgrip.errors import ConfigurationError, StoreError, StoreFullError
from rsu_app.adapters.store.connection import store_error
from rsu_app.adapters.store.rows import insert_entries
from rsu_app.ports import PassageEntry

Work: TypeAlias = Callable[[Connection], Any]
"""Something to be done in a transaction of its own."""


@dataclass(frozen=True, slots=True)
class WriterLimits:
    """How much waits and how much is committed at once.

    Attributes:
        queue_count: Writes that may wait; the next one is refused.
        group_count: Passages per commit at most.
        linger_s: How long the first passage of a group waits for company. While a commit runs the next group gathers
            by itself, so this matters only under light load; it spares flash memory some commits.
    """

    queue_count: int = 2048
    group_count: int = 256
    linger_s: float = 0.002

    def __post_init__(self) -> None:
        if self.queue_count < 1 or self.group_count < 1 or not 0.0 <= self.linger_s <= 1.0:
            raise ConfigurationError("the writer needs room for a write and must not linger for more than a second")


@dataclass(frozen=True, slots=True)
class _Job:
    task: PassageEntry | Work | str
    future: asyncio.Future[Any]
    loop: asyncio.AbstractEventLoop


class Writer:
    """Owns the only connection that writes.

    Args:
        engine: Makes that connection.
        limits: How much waits and how much is committed at once.
    """

    def __init__(self, engine: Engine, limits: WriterLimits) -> None:
        self._engine = engine
        self._limits = limits
        self._queue: queue.Queue[_Job | None] = queue.Queue(limits.queue_count)
        self._closed = False
        self._committed_at_s: float | None = None
        self._thread = threading.Thread(target=self._run, name="store-writer", daemon=True)
        self._thread.start()

    @property
    def queued_count(self) -> int:
        """Writes that wait."""
        return self._queue.qsize()

    @property
    def committed_ago_s(self) -> float | None:
        """Time since the last commit that reached the disk; None before the first and after a failure."""
        committed_at_s = self._committed_at_s
        return None if committed_at_s is None else time.monotonic() - committed_at_s

    async def submit(self, task: PassageEntry | Work | str) -> Any:
        """Return the result of a task after the commit that holds it.

        Args:
            task: A passage; or work for a transaction of its own; or a script that runs outside of any.

        Raises:
            StoreFullError: Too much waits already, or the disk is full.
            StoreError: The commit failed or the store is closed.
        """
        loop = asyncio.get_running_loop()
        job = _Job(task=task, future=loop.create_future(), loop=loop)
        if self._closed:
            raise StoreError("the store is closed")
        try:
            self._queue.put_nowait(job)
        except queue.Full:
            raise StoreFullError(f"{self._limits.queue_count} writes wait already") from None
        return await job.future

    async def close(self) -> None:
        """Write what waits, then end the thread and release the connection."""
        if not self._closed:
            self._closed = True
            await asyncio.to_thread(self._queue.put, None)
        await asyncio.to_thread(self._thread.join)

    def _run(self) -> None:
        while self._serve():
            pass
        self._engine.dispose()

    def _serve(self) -> bool:
        """Write one group and whatever ended it; return false when told to stop."""
        jobs = self._gather()
        last = jobs[-1]
        group = [job for job in jobs if job is not None and isinstance(job.task, PassageEntry)]
        if group:
            entries = [job.task for job in group if isinstance(job.task, PassageEntry)]
            self._attempt(group, lambda: self._transact(lambda connection: insert_entries(connection, entries)))
        if last is not None and not isinstance(last.task, PassageEntry):
            task = last.task
            self._attempt([last], lambda: [self._run_script(task) if isinstance(task, str) else self._transact(task)])
        return last is not None

    def _gather(self) -> list[_Job | None]:
        """Return passages that wait, at least one job; anything but a passage ends the group."""
        jobs = [self._queue.get()]
        deadline_s = time.monotonic() + self._limits.linger_s
        while len(jobs) < self._limits.group_count:
            last = jobs[-1]
            if last is None or not isinstance(last.task, PassageEntry):
                break
            try:
                jobs.append(self._queue.get(timeout=max(1e-6, deadline_s - time.monotonic())))
            except queue.Empty:
                break
        return jobs

    def _transact(self, work: Work) -> Any:
        with self._engine.begin() as connection:
            return work(connection)

    def _run_script(self, script: str) -> Any:
        with self._engine.connect() as connection:
            raw = connection.connection.driver_connection
            # Stepped to its end, unlike `execute`, with which incremental_vacuum frees a single page.
            return cast("sqlite3.Connection", raw).executescript(script).rowcount

    def _attempt(self, jobs: list[_Job], write: Callable[[], list[Any]]) -> None:
        try:
            results = write()
        except (DBAPIError, sqlite3.Error, OSError) as error:
            self._committed_at_s = None
            # A fresh connection next time: whatever broke this one, a full disk included, may be over by then.
            self._engine.dispose()
            _tell(jobs, error=store_error(error, doing="writing"))
        except Exception as error:  # noqa: BLE001 - whatever it is, somebody waits for an answer and the thread must live
            self._committed_at_s = None
            _tell(jobs, error=StoreError(f"writing: {type(error).__name__}: {error}"))
        else:
            self._committed_at_s = time.monotonic()
            _tell(jobs, results=results)


def _tell(jobs: list[_Job], *, results: list[Any] | None = None, error: StoreError | None = None) -> None:
    """Answer everybody who waits, with one visit to each event loop."""

    def resolve(loop: asyncio.AbstractEventLoop) -> None:
        for position, job in enumerate(jobs):
            if job.loop is not loop or job.future.done():
                continue
            if results is None:
                # One exception object per waiter: each grows its own traceback.
                job.future.set_exception(type(error)(*error.args) if error is not None else StoreError("writing"))
            else:
                job.future.set_result(results[position])

    for loop in {job.loop for job in jobs}:
        # A loop that is closed has nobody waiting any more.
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(resolve, loop)

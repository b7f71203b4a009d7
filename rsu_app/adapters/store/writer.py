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
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from math import inf
from typing import Any, TypeAlias, cast

from sqlalchemy import Connection, Engine
from sqlalchemy.exc import DBAPIError

from roadgrip.errors import ConfigurationError, StoreError, StoreFullError
from rsu_app.adapters.store.connection import store_error
from rsu_app.adapters.store.rows import insert_entries
from rsu_app.ports import PassageEntry

Entries: TypeAlias = Sequence[PassageEntry]
"""Passages that arrived together; they may share their commit with others."""
Work: TypeAlias = Callable[[Connection], Any]
"""Something to be done in a transaction of its own."""


@dataclass(frozen=True, slots=True)
class WriterLimits:
    """How much waits and how much is committed at once.

    Attributes:
        queue_count: Passages and other writes that may wait; what comes then is refused.
        group_count: Passages from which a commit takes no more.
    """

    queue_count: int = 2048
    group_count: int = 256

    def __post_init__(self) -> None:
        if self.queue_count < 1 or self.group_count < 1:
            raise ConfigurationError("the writer needs room for a write")


@dataclass(frozen=True, slots=True)
class _Job:
    task: Entries | Work | str
    future: asyncio.Future[Any]
    loop: asyncio.AbstractEventLoop

    @property
    def entries(self) -> Entries | None:
        """The passages it holds; None when it is something else."""
        return None if isinstance(self.task, str) or callable(self.task) else self.task

    @property
    def size_count(self) -> int:
        """How many writes it is."""
        return 1 if self.entries is None else len(self.entries)


class Writer:
    """Owns the only connection that writes.

    Args:
        engine: Makes that connection.
        limits: How much waits and how much is committed at once.
    """

    def __init__(self, engine: Engine, limits: WriterLimits) -> None:
        self._engine = engine
        self._limits = limits
        self._queue: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        # Each is counted up by one thread only, so that neither waits for the other.
        self._submitted_count = 0
        self._taken_count = 0
        self._closed = False
        self._committed_at_s: float | None = None
        self._began_at_s: float | None = None
        self._thread = threading.Thread(target=self._run, name="store-writer", daemon=True)
        self._thread.start()

    @property
    def queued_count(self) -> int:
        """Passages and other writes that wait."""
        return self._submitted_count - self._taken_count

    @property
    def committed_ago_s(self) -> float | None:
        """Time since the last commit that reached the disk; None before the first and after a failure."""
        committed_at_s = self._committed_at_s
        return None if committed_at_s is None else time.monotonic() - committed_at_s

    @property
    def busy_s(self) -> float:
        """How long the same group of writes has been under way; 0 while there is none, infinity if the thread died."""
        began_at_s = self._began_at_s
        if not self._thread.is_alive():
            return 0.0 if self._closed else inf
        return 0.0 if began_at_s is None else time.monotonic() - began_at_s

    async def submit(self, task: Entries | Work | str) -> Any:
        """Return the result of a task after the commit that holds it. To be called from one event loop only.

        Args:
            task: Passages, at least one, whose result is a list; or work for a transaction of its own; or a script
                that runs outside of any.

        Raises:
            StoreFullError: Too much waits already, or the disk is full.
            StoreError: The commit failed or the store is closed.
        """
        loop = asyncio.get_running_loop()
        job = _Job(task=task, future=loop.create_future(), loop=loop)
        if self._closed:
            raise StoreError("the store is closed")
        # What comes alone is taken while there is any room, so that a large batch is not refused for ever.
        if self.queued_count >= self._limits.queue_count:
            raise StoreFullError(f"{self.queued_count} writes wait already")
        self._submitted_count += job.size_count
        self._queue.put(job)
        return await job.future

    async def close(self) -> None:
        """Write what waits, then end the thread and release the connection."""
        if not self._closed:
            self._closed = True
            self._queue.put(None)
        await asyncio.to_thread(self._thread.join)

    def _run(self) -> None:
        while self._serve():
            pass
        self._engine.dispose()

    def _serve(self) -> bool:
        """Write one group and whatever ended it; return false when told to stop."""
        self._began_at_s = None
        jobs = self._gather()
        self._began_at_s = time.monotonic()
        last = jobs[-1]
        group = [job for job in jobs if job is not None and job.entries is not None]
        if group:
            entries = [entry for job in group for entry in job.entries or ()]
            self._attempt(
                group,
                lambda: _dealt(self._transact(lambda connection: insert_entries(connection, entries)), group),
            )
        if last is not None and last.entries is None:
            task = cast("Work | str", last.task)
            self._attempt([last], lambda: [self._run_script(task) if isinstance(task, str) else self._transact(task)])
        return last is not None

    def _gather(self) -> list[_Job | None]:
        """Return passages that wait, at least one job; anything but passages ends the group.

        Nobody is waited for: what comes during the commit is the next group.
        """
        jobs = [self._take()]
        gathered_count = 0
        while (last := jobs[-1]) is not None and last.entries is not None:
            gathered_count += len(last.entries)
            if gathered_count >= self._limits.group_count or self._queue.empty():
                break
            jobs.append(self._take())
        return jobs

    def _take(self) -> _Job | None:
        job = self._queue.get()
        self._taken_count += 0 if job is None else job.size_count
        return job

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


def _dealt(results: list[Any], jobs: Sequence[_Job]) -> list[list[Any]]:
    """Return the results of passages in the portions in which they came."""
    remaining = iter(results)
    return [list(islice(remaining, job.size_count)) for job in jobs]


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

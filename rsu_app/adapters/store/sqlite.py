"""The passage store: how it is opened, and what may be asked of it."""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar, cast

from sqlalchemy import Connection
from sqlalchemy.exc import DBAPIError

from roadgrip.errors import StoreError
from rsu_app.adapters.store import rows
from rsu_app.adapters.store.connection import reading_engine, store_error, writing_engine
from rsu_app.adapters.store.migration import check, upgrade
from rsu_app.adapters.store.recovery import damage, move_aside
from rsu_app.adapters.store.standby import StandbyStore
from rsu_app.adapters.store.writer import Writer, WriterLimits
from rsu_app.ports import CountablePassage, Event, PassageEntry, PassageStore, StoreCounts, StoredEstimate

PROBE_INTERVAL_S = 5.0
"""A commit within this time proves that writing works; readiness asked every second must not wear out the flash."""
PRUNE_BATCH_COUNT = 500
"""Rows deleted per transaction; passages that wait are written between two batches."""
VACUUM_PAGES_COUNT = 1024
"""Pages given back to the file system after pruning, 4 MiB at a time."""

T = TypeVar("T")


def open_store(database_path: Path, *, limits: WriterLimits | None = None) -> SqlitePassageStore:
    """Return the store in a database file: examined, migrated, with its writer running. The file is made if missing.

    A damaged file is moved aside and a fresh one begun; `notes` of the store says so.

    Raises:
        StoreError: The file can be neither used nor replaced, or it belongs to newer software.
    """
    try:
        return _open(database_path, limits=limits or WriterLimits())
    except OSError as error:
        raise store_error(error, doing=f"opening {database_path}") from error


def open_or_standby(database_path: Path, *, limits: WriterLimits | None = None) -> PassageStore:
    """Return the store, or one that says why it cannot be opened and keeps trying. Never raises for the disk's sake.

    A unit without its memory still sends maps and advises the winter speed; one that does not start does neither.
    """
    open_now = partial(open_store, database_path, limits=limits)
    try:
        return open_now()
    except StoreError as error:
        return StandbyStore(open_now, problem=error)


def newest_received_unix_s(database_path: Path) -> float:
    """Return when the newest stored passage was received; zero if there is none or it cannot be read."""
    engine = reading_engine(database_path)
    try:
        with engine.begin() as connection:
            return rows.newest_received_unix_s(connection)
    except (DBAPIError, sqlite3.Error):
        return 0.0
    finally:
        engine.dispose()


def _open(database_path: Path, *, limits: WriterLimits) -> SqlitePassageStore:
    notes: list[str] = []
    found = damage(database_path)
    if found is not None:
        moved_to = move_aside(database_path, now_unix_s=time.time())
        notes.append(f"the database was damaged ({found}); it lies in {moved_to.name} and a fresh one was begun")
    before = check(database_path)
    if not before.up_to_date:
        after = upgrade(database_path)
        if not after.up_to_date:
            raise StoreError(f"{database_path} is at revision {after.current}, this software needs {after.expected}")
        notes.append(f"the database was migrated from revision {before.current} to {after.current}")
    return SqlitePassageStore(database_path, limits=limits, notes=tuple(notes))


class SqlitePassageStore:
    """Passages in one SQLite file; see `rsu_app.ports.PassageStore` for what each method promises.

    Args:
        database_path: A database at the expected revision.
        limits: How much waits and how much is committed at once.
        notes: What a person should know about how it was opened.
    """

    def __init__(self, database_path: Path, *, limits: WriterLimits, notes: tuple[str, ...] = ()) -> None:
        self._path = database_path
        self._limits = limits
        self._notes = notes
        self._reading = reading_engine(database_path)
        self._writer = Writer(writing_engine(database_path), limits)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about how the store was opened."""
        return self._notes

    async def append(self, entry: PassageEntry) -> StoredEstimate | None:
        """Return after the commit that holds the entry; what was held already instead, if so."""
        return cast("StoredEstimate | None", await self._writer.submit(entry))

    async def load(self, *, since_unix_s: float, limit_count: int) -> Sequence[CountablePassage]:
        """Return what was received at or after a moment, oldest first."""
        return await self._read(
            lambda connection: rows.passages_since(connection, since_unix_s=since_unix_s, limit_count=limit_count)
        )

    async def record_event(self, event: Event) -> None:
        """Return after the commit that holds the event."""
        await self._writer.submit(lambda connection: rows.insert_event(connection, event))

    async def events(self, *, limit_count: int) -> Sequence[Event]:
        """Return the newest events, newest first."""
        return await self._read(lambda connection: rows.newest_events(connection, limit_count=limit_count))

    async def counts(self) -> StoreCounts:
        """Return how full the store is."""
        count = await self._read(rows.passages_count)
        files = (self._path.with_name(self._path.name + suffix) for suffix in ("", "-wal"))
        return StoreCounts(
            passages_count=count,
            database_bytes=sum(path.stat().st_size for path in files if path.exists()),
            queued_count=self._writer.queued_count,
            queue_limit_count=self._limits.queue_count,
        )

    async def probe(self) -> None:
        """Return once a write is known to have reached the disk a short while ago, or now."""
        if not self._path.exists():
            raise StoreError(f"{self._path} is gone; what is written now reaches no file anybody can open")
        committed_ago_s = self._writer.committed_ago_s
        if committed_ago_s is None or committed_ago_s > PROBE_INTERVAL_S:
            unix_s = time.time()
            await self._writer.submit(lambda connection: rows.write_probe(connection, unix_s=unix_s))

    async def prune(self, *, before_unix_s: float | None, rows_limit_count: int) -> int:
        """Delete what is too old, then the oldest beyond the limit, in batches; return how many went."""
        deleted_count = 0
        if before_unix_s is not None:
            delete_old = partial(
                rows.delete_received_before, before_unix_s=before_unix_s, batch_count=PRUNE_BATCH_COUNT
            )
            while gone := await self._writer.submit(delete_old):
                deleted_count += gone
        excess_count = await self._read(rows.passages_count) - rows_limit_count
        while excess_count > 0:
            batch_count = min(excess_count, PRUNE_BATCH_COUNT)
            deleted_count += await self._writer.submit(partial(rows.delete_first, batch_count=batch_count))
            excess_count -= batch_count
        if deleted_count:
            await self._writer.submit(f"PRAGMA incremental_vacuum({VACUUM_PAGES_COUNT})")
        return deleted_count

    async def close(self) -> None:
        """Write what waits, then release the database."""
        await self._writer.close()
        self._reading.dispose()

    async def _read(self, question: Callable[[Connection], T]) -> T:
        return await asyncio.to_thread(self._ask, question)

    def _ask(self, question: Callable[[Connection], T]) -> T:
        try:
            with self._reading.begin() as connection:
                return question(connection)
        except (DBAPIError, sqlite3.Error) as error:
            raise store_error(error, doing=f"reading {self._path}") from error

"""The passage store: how it is opened, and what may be asked of it."""

from __future__ import annotations

import asyncio
import sqlite3
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar, cast

import structlog
from sqlalchemy import Connection
from sqlalchemy.exc import DBAPIError

from roadgrip.errors import StoreError
from roadgrip.ledger import Action, LedgerEntry, LedgerError
from rsu_app.adapters.store import ledger_rows, rows
from rsu_app.adapters.store.connection import only_transaction, reading_engine, store_error, writing_engine
from rsu_app.adapters.store.migration import check, upgrade
from rsu_app.adapters.store.recovery import damage, integrity_problems, keep_damaged_log, move_aside, moved_aside
from rsu_app.adapters.store.standby import StandbyStore
from rsu_app.adapters.store.writer import Writer, WriterLimits
from rsu_app.ports import (
    ArrivalKey,
    CountablePassage,
    PassageEntry,
    PassageStore,
    StoreCounts,
    StoredEstimate,
    WriterPulse,
)

_log = structlog.get_logger("roadgrip")

PROBE_INTERVAL_S = 5.0
"""A commit within this time proves that writing works; readiness asked every second must not wear out the flash."""
PRUNE_BATCH_COUNT = 500
"""Rows deleted per transaction; passages that wait are written between two batches."""
VACUUM_PAGES_COUNT = 1024
"""Pages given back to the file system after pruning, 4 MiB at a time."""

T = TypeVar("T")


def open_store(
    database_path: Path,
    *,
    limits: WriterLimits | None = None,
    size_limit_bytes: int | None = None,
    suspected: bool = False,
) -> SqlitePassageStore:
    """Return the store in a database file: examined, migrated, with its writer running. The file is made if missing.

    A damaged file is moved aside and a fresh one begun; `notes` of the store and the first entry of its ledger say so.
    Of a damaged log a copy is kept, and the database goes on with what could be read if it is whole with that.

    Args:
        database_path: The file.
        limits: How much waits and how much is committed at once.
        size_limit_bytes: What the database may hold after pruning; None leaves that to ages and numbers.
        suspected: Whether to examine everything; takes several times as long.

    Raises:
        StoreError: The file can be neither used nor replaced, or it belongs to newer software.
    """
    try:
        notes = _sound_notes(database_path, suspected=suspected)
        return _open(database_path, notes, limits=limits or WriterLimits(), size_limit_bytes=size_limit_bytes)
    except OSError as error:
        raise store_error(error, doing=f"opening {database_path}") from error


def open_or_standby(
    database_path: Path, *, limits: WriterLimits | None = None, size_limit_bytes: int | None = None
) -> PassageStore:
    """Return the store, which is opened again if its file is damaged, and if it cannot be opened now.

    Never raises for the disk's sake.

    A unit without its memory still sends maps and advises the winter speed; one that does not start does neither.
    """
    open_now = partial(open_store, database_path, limits=limits, size_limit_bytes=size_limit_bytes)
    open_again = partial(open_now, suspected=True)
    try:
        return StandbyStore(open_now(), open_again=open_again)
    except StoreError as error:
        return StandbyStore(error, open_again=open_again)


def newest_received_unix_s(database_path: Path) -> float:
    """Return when the newest stored passage was received; zero if there is none or it cannot be read."""
    try:
        with only_transaction(reading_engine(database_path), doing=f"reading {database_path}") as connection:
            return rows.newest_received_unix_s(connection)
    except StoreError:
        return 0.0


def _sound_notes(database_path: Path, *, suspected: bool) -> tuple[str, ...]:
    """Return what was wrong with the database, after which there is a sound one or none. Empty if nothing was."""
    spoilt_log = keep_damaged_log(database_path, now_unix_s=time.time())
    found = damage(database_path)
    if found is None and (suspected or spoilt_log is not None):
        # Pages that the log held may have reached the database from behind the place where its reading ended.
        found = next(iter(integrity_problems(database_path)), None) if database_path.exists() else None
    notes = []
    if spoilt_log is not None:
        problem, copy = spoilt_log
        notes.append(f"the database was damaged ({problem}); the log lies in {copy.name}, what could be read is kept")
    if found is not None:
        moved_to = move_aside(database_path, now_unix_s=time.time())
        notes.append(f"the database was damaged ({found}); it lies in {moved_to.name} and a fresh one was begun")
    elif spoilt_log is not None:
        # What can be read of the log is worked into the database when this connection is closed. What lies behind it
        # would be found again at the next start.
        with only_transaction(writing_engine(database_path), doing=f"emptying the log of {database_path}"):
            pass
    for note in notes:
        _log.error("database_damaged", note=note)
    return tuple(notes)


def _open(
    database_path: Path, notes: tuple[str, ...], *, limits: WriterLimits, size_limit_bytes: int | None
) -> SqlitePassageStore:
    damage_note = notes[-1] if notes else None
    before = check(database_path)
    if not before.up_to_date:
        after = upgrade(database_path)
        if not after.up_to_date:
            raise StoreError(f"{database_path} is at revision {after.current}, this software needs {after.expected}")
        notes = (*notes, f"the database was migrated from revision {before.current} to {after.current}")
    _begin_ledger(database_path, damage_note=damage_note)
    return SqlitePassageStore(database_path, limits=limits, size_limit_bytes=size_limit_bytes, notes=notes)


def _begin_ledger(database_path: Path, *, damage_note: str | None) -> None:
    """Write the first entry of a ledger that has none: why it begins, and which damaged database lies beside it."""
    with only_transaction(reading_engine(database_path), doing=f"reading {database_path}") as connection:
        if ledger_rows.rows_after(connection, sequence_number=0, limit_count=1):
            return
        reason = "a database without a ledger" if rows.passages_count(connection) else "a new database"
    kept = moved_aside(database_path)
    with only_transaction(
        writing_engine(database_path), doing=f"beginning the ledger of {database_path}"
    ) as connection:
        ledger_rows.append_entry(
            connection,
            at_unix_s=time.time(),
            actor="unit",
            action=Action.LEDGER_BEGUN,
            subject="",
            reason=damage_note or reason,
            evidence={"damaged_database": kept[-1].name} if kept else None,
        )


class SqlitePassageStore:
    """Passages in one SQLite file; see `rsu_app.ports.PassageStore` for what each method promises.

    Args:
        database_path: A database at the expected revision.
        limits: How much waits and how much is committed at once.
        size_limit_bytes: What the database may hold after pruning; None leaves that to ages and numbers.
        notes: What a person should know about how it was opened.
    """

    def __init__(
        self,
        database_path: Path,
        *,
        limits: WriterLimits,
        size_limit_bytes: int | None = None,
        notes: tuple[str, ...] = (),
    ) -> None:
        self._path = database_path
        self._limits = limits
        self._size_limit_bytes = size_limit_bytes
        self._notes = notes
        self._reading = reading_engine(database_path)
        self._writer = Writer(writing_engine(database_path), limits)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a person should know about how the store was opened."""
        return self._notes

    @property
    def pulse(self) -> WriterPulse:
        """What can be seen of the writer right now; never waits."""
        return WriterPulse(
            committed_ago_s=self._writer.committed_ago_s,
            busy_s=self._writer.busy_s,
            queued_count=self._writer.queued_count,
        )

    async def append(self, entries: Sequence[PassageEntry]) -> list[StoredEstimate | None]:
        """Return after the commit that holds the entries; for each what was held already instead, if so."""
        return cast("list[StoredEstimate | None]", await self._writer.submit(entries))

    async def load(
        self, *, since_unix_s: float, limit_count: int, before: ArrivalKey | None = None
    ) -> Sequence[CountablePassage]:
        """Return what was received at or after a moment, oldest first; the newest `limit_count` of it."""
        return await self._read(
            lambda connection: rows.passages_since(
                connection, since_unix_s=since_unix_s, limit_count=limit_count, before=before
            )
        )

    async def load_first(self, *, section_id: str, bundle_id: str, limit_count: int) -> Sequence[CountablePassage]:
        """Return the first passages of a section that a bundle judged and that are still kept, in their order."""
        return await self._read(
            lambda connection: rows.first_passages(
                connection, section_id=section_id, bundle_id=bundle_id, limit_count=limit_count
            )
        )

    async def compared_count(self, *, bundle_id: str, shadow_bundle_id: str) -> int:
        """Return for how many stored passages one bundle was live and another answered beside it."""
        return await self._read(
            lambda connection: rows.compared_count(connection, bundle_id=bundle_id, shadow_bundle_id=shadow_bundle_id)
        )

    async def record(
        self,
        *,
        at_unix_s: float,
        actor: str,
        action: Action,
        subject: str,
        reason: str,
        evidence: Mapping[str, str] | None = None,
    ) -> LedgerEntry:
        """Return the entry that was appended to the ledger, after the commit that holds it."""
        # Made where it is written: only there is it known what it follows.
        append = partial(
            ledger_rows.append_entry,
            at_unix_s=at_unix_s,
            actor=actor,
            action=action,
            subject=subject,
            reason=reason,
            evidence=evidence,
        )
        return cast("LedgerEntry", await self._writer.submit(append))

    async def ledger(self, *, limit_count: int) -> Sequence[LedgerEntry]:
        """Return the newest entries of the ledger, newest first."""
        return await self._read(lambda connection: ledger_rows.newest_entries(connection, limit_count=limit_count))

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
        """Delete what is too old, then the oldest beyond the limits, in batches; return how many went."""
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
        if self._size_limit_bytes is not None:
            delete_beyond = partial(
                rows.delete_first_beyond, size_limit_bytes=self._size_limit_bytes, batch_count=PRUNE_BATCH_COUNT
            )
            while gone := await self._writer.submit(delete_beyond):
                deleted_count += gone
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
        except LedgerError as error:
            raise StoreError(str(error)) from error

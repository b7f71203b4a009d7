"""Connections to the database file: one kind that writes, one kind that can only read."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, nullcontext, suppress
from pathlib import Path
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.exc import DBAPIError
from sqlalchemy.pool import NullPool, Pool, QueuePool

from roadgrip.errors import StoreDamagedError, StoreError, StoreFullError

BUSY_TIMEOUT_MS = 5_000
LOG_LIMIT_BYTES = 16 * 1024 * 1024
_PIECE_BYTES = 1024 * 1024
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def apply_writer_pragmas(connection: sqlite3.Connection) -> None:
    """Set up a connection that writes; the reason stands beside each pragma."""
    if connection.execute("PRAGMA page_count").fetchone() == (0,):
        # Lets pruned pages go back to the file system in small portions. It must come before the first page is
        # written, and would cost a commit at every start if it came again.
        connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
    for pragma in (
        # Readers never wait for the writer, and a commit is one append to one file.
        "journal_mode = WAL",
        # A commit returns after its fsync. With NORMAL a power cut may take acknowledged passages with it.
        "synchronous = FULL",
        # Off by default for the sake of databases from 2009.
        "foreign_keys = ON",
        # `db upgrade` by hand, or a backup, may hold the lock for a moment.
        f"busy_timeout = {BUSY_TIMEOUT_MS}",
        # After a burst the log file shrinks back instead of keeping its largest size for ever.
        f"journal_size_limit = {LOG_LIMIT_BYTES}",
        # A database that somebody else wrote must not run functions in its schema.
        "trusted_schema = OFF",
    ):
        connection.execute(f"PRAGMA {pragma}")
    make_log_last(connection)


def make_log_last(connection: sqlite3.Connection) -> None:
    """Return once the database's log is on the disk as it is read, whatever happened to it before.

    After an fsync that failed, Linux takes the pages for written and never tries them again, so that they are read
    back from memory until the power goes. SQLite does read them back when the database is opened the next time, and
    every commit from then on would build on what is not there. Writing the log over itself makes its pages count as
    changed again. Belongs to every connection that will write, since nobody knows what came before.

    Raises:
        sqlite3.Error: The log belongs to somebody else for too long.
        OSError: The log cannot be written. The connection must not be used.
    """
    database_path = str(connection.execute("PRAGMA database_list").fetchone()[2])
    log_path = _log_path(Path(database_path)) if database_path else None
    if log_path is None:
        return
    # Nobody may append meanwhile. SQLite holds its locks on the other two files, so that closing this one loses none.
    connection.execute("BEGIN IMMEDIATE")
    try:
        with log_path.open("r+b", buffering=0) as log:
            at_bytes = 0
            while piece := os.pread(log.fileno(), _PIECE_BYTES, at_bytes):
                at_bytes += os.pwrite(log.fileno(), piece, at_bytes)
            os.fsync(log.fileno())
    finally:
        connection.execute("ROLLBACK")


@contextmanager
def log_left_alone(database_path: Path) -> Iterator[None]:
    """Keep SQLite from working the log into the database when a connection to it is closed meanwhile.

    The last connection that closes does so, behind an fsync of the log. Where one failed before, this one succeeds
    without doing anything (see `make_log_last`), and a power cut while pages are copied leaves a database that is
    half new and a log that does not hold the other half. Another connection that is open keeps the first from being
    the last; one that can only read copies nothing when it is closed itself.
    """
    with ExitStack() as stack:
        if _log_path(database_path) is not None:
            # One that cannot be read has nothing copied into it, either.
            with suppress(sqlite3.Error):
                guard = stack.enter_context(closing(sqlite3.connect(_address(database_path, mode="ro"), uri=True)))
                guard.execute("SELECT 1 FROM sqlite_schema").fetchone()
        yield


def _log_path(database_path: Path) -> Path | None:
    """Return where the log of a database lies, None if it has none or an empty one."""
    path = database_path.with_name(database_path.name + "-wal")
    return path if path.exists() and path.stat().st_size else None


def apply_reader_pragmas(connection: sqlite3.Connection) -> None:
    """Set up a connection that reads; the reason stands beside each pragma."""
    for pragma in (
        # The file is opened read-only already; this also refuses temporary tables and the like.
        "query_only = ON",
        # Only a checkpoint that starts over can make a reader wait.
        f"busy_timeout = {BUSY_TIMEOUT_MS}",
        "trusted_schema = OFF",
    ):
        connection.execute(f"PRAGMA {pragma}")


def writing_engine(database_path: Path) -> Engine:
    """Return an engine whose transactions take the write lock when they begin. The file is made if missing.

    A transaction that begins as a reader and writes later can fail half way with "database is locked" whatever the
    timeout; hence BEGIN IMMEDIATE.
    """
    engine = _engine(database_path, mode="rwc", prepare=apply_writer_pragmas, poolclass=QueuePool)

    @event.listens_for(engine, "begin")
    def begin_immediate(connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE")

    return engine


def reading_engine(database_path: Path) -> Engine:
    """Return an engine that cannot change the file. It sees every commit that was acknowledged before."""
    engine = _engine(database_path, mode="ro", prepare=apply_reader_pragmas, poolclass=NullPool)

    @event.listens_for(engine, "begin")
    def begin_deferred(connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN")

    return engine


@contextmanager
def only_transaction(engine: Engine, *, doing: str) -> Iterator[Connection]:
    """Give a connection for the one transaction that an engine was made for.

    Raises:
        StoreError: The database refuses.
    """
    try:
        with engine.begin() as connection:
            yield connection
    except (DBAPIError, sqlite3.Error, OSError) as error:
        raise store_error(error, doing=doing) from error
    finally:
        engine.dispose()


def store_error(error: DBAPIError | sqlite3.Error | OSError, *, doing: str) -> StoreError:
    """Return what went wrong in the words of the error tree."""
    origin = error.orig if isinstance(error, DBAPIError) else error
    # Extended codes keep the plain one in their lowest byte.
    code = getattr(origin, "sqlite_errorcode", sqlite3.SQLITE_OK) & 0xFF
    if code == sqlite3.SQLITE_FULL:
        return StoreFullError(f"{doing}: the disk is full")
    if code in _DAMAGED:
        return StoreDamagedError(f"{doing}: {origin}")
    return StoreError(f"{doing}: {origin}")


def _engine(
    database_path: Path, *, mode: str, prepare: Callable[[sqlite3.Connection], None], poolclass: type[Pool]
) -> Engine:
    address = _address(database_path, mode=mode)

    def connect() -> sqlite3.Connection:
        # One that cannot be prepared is closed, and its log may not be on the disk.
        with nullcontext() if mode == "ro" else log_left_alone(database_path):
            # isolation_level None: the module begins no transactions of its own, the events above do.
            connection = sqlite3.connect(address, uri=True, isolation_level=None, check_same_thread=False)
            try:
                prepare(connection)
            except (sqlite3.Error, OSError):
                connection.close()
                raise
            return connection

    return create_engine("sqlite://", creator=connect, poolclass=poolclass)


def _address(database_path: Path, *, mode: str) -> str:
    return f"file:{quote(str(database_path.absolute()))}?mode={mode}"

"""A database as a whole: a copy of one that is in use, and whether anybody uses it."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from roadgrip.errors import StoreError
from roadgrip.ledger import Action
from rsu_app.adapters.store import ledger_rows
from rsu_app.adapters.store.connection import (
    apply_reader_pragmas,
    make_log_last,
    only_transaction,
    store_error,
    writing_engine,
)

COPIED_AT_ONCE_COUNT = 1024
"""Pages between two words about progress, 4 MiB."""


def copy_database(
    source: Path, target: Path, *, on_copied: Callable[[int, int], None] = lambda _done, _of: None
) -> None:
    """Return once a copy of a database is written, as it was at one moment. The unit may write to it meanwhile.

    The copy is one file without a log beside it.

    Args:
        source: The database.
        target: The copy; made anew.
        on_copied: Is told how many bytes were copied so far, and of how many.

    Raises:
        StoreError: There is no database, or it cannot be read, or the copy cannot be written.
    """
    if not source.exists():
        raise StoreError(f"{source} does not exist yet: there is nothing to copy")
    doing = f"copying {source} to {target}"
    try:
        with (
            closing(
                sqlite3.connect(f"file:{quote(str(source.absolute()))}?mode=ro", uri=True, isolation_level=None)
            ) as reading,
            closing(sqlite3.connect(target, isolation_level=None)) as writing,
        ):
            apply_reader_pragmas(reading)
            page_bytes = int(reading.execute("PRAGMA page_size").fetchone()[0])
            # A transaction that has read holds its moment. Without one every commit of the unit would make the copy
            # begin anew, and a busy unit's would never end.
            reading.execute("BEGIN")
            reading.execute("SELECT count(*) FROM sqlite_schema").fetchone()
            reading.backup(
                writing,
                pages=COPIED_AT_ONCE_COUNT,
                progress=lambda _status, remaining, total: on_copied(
                    (total - remaining) * page_bytes, total * page_bytes
                ),
            )
            # One file, for whoever carries it; whoever opens it for a unit turns the log on again.
            writing.execute("PRAGMA journal_mode = DELETE").fetchone()
    except sqlite3.Error as error:
        raise store_error(error, doing=doing) from error


def in_use(database_path: Path) -> bool:
    """Return whether another process has the database open; one that is damaged or missing is used by nobody.

    Raises:
        StoreError: It cannot be told.
    """
    if not database_path.exists():
        return False
    try:
        with closing(
            sqlite3.connect(f"file:{quote(str(database_path.absolute()))}?mode=rw", uri=True, timeout=0.0)
        ) as connection:
            # Readers of a database with a log share it with its writer, unless one wants it for itself.
            connection.execute("PRAGMA locking_mode = EXCLUSIVE").fetchone()
            connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
            # Who has it alone works its log into it when closing.
            make_log_last(connection)
    except OSError as error:
        raise store_error(error, doing=f"looking whether {database_path} is in use") from error
    except sqlite3.DatabaseError as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
            return True
        if code in {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}:
            return False
        raise store_error(error, doing=f"looking whether {database_path} is in use") from error
    return False


def note_restored(database_path: Path, *, at_unix_s: float, actor: str, made_unix_s: float, software: str) -> None:
    """Write into the ledger of a restored database that it is one.

    Args:
        database_path: At this software's revision.
        at_unix_s: The wall clock.
        actor: Who restored it.
        made_unix_s: When the backup was made.
        software: The version that made it.

    Raises:
        StoreError: It cannot be written.
    """
    with only_transaction(writing_engine(database_path), doing=f"writing the ledger of {database_path}") as connection:
        ledger_rows.append_entry(
            connection,
            at_unix_s=at_unix_s,
            actor=actor,
            action=Action.RESTORED,
            subject="",
            reason="what was done after the backup is not in here",
            evidence={"backup_made_unix_s": f"{made_unix_s:.0f}", "backup_software": software},
        )

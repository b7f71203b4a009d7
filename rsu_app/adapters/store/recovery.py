"""What to do with a database file that is damaged: keep it for whoever wants to look, and start afresh.

A road side unit that refuses to start because a power cut spoilt its memory helps nobody on the road.
"""

from __future__ import annotations

import glob
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote

from roadgrip.errors import StoreError
from rsu_app.adapters.store.connection import store_error

KEPT_COUNT = 2
"""Damaged databases that are kept; older ones are deleted, or damage after damage would fill the disk."""
PROBLEMS_COUNT = 10
"""Findings of an examination that are told; the first already says enough."""
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_COMPANIONS = ("-wal", "-shm")


def damage(database_path: Path) -> str | None:
    """Return what is wrong inside the file, or None if it is sound or does not exist.

    Raises:
        StoreError: It cannot be examined, which says nothing about its content.
    """
    if not database_path.exists():
        return None
    try:
        with closing(sqlite3.connect(database_path)) as connection:
            verdict = str(connection.execute("PRAGMA quick_check(1)").fetchone()[0])
    except sqlite3.Error as error:
        # Extended codes keep the plain one in their lowest byte.
        if getattr(error, "sqlite_errorcode", 0) & 0xFF in _DAMAGED:
            return str(error)
        raise store_error(error, doing=f"examining {database_path}") from error
    return None if verdict == "ok" else verdict


def integrity_problems(database_path: Path) -> list[str]:
    """Return what SQLite finds wrong inside the file, at most ten findings; nothing if it is sound.

    Reads all of it, indexes and constraints included, so it takes seconds on a large database; changes nothing, and
    a unit may write meanwhile.

    Raises:
        StoreError: It is no database or cannot be read.
    """
    try:
        address = f"file:{quote(str(database_path.absolute()))}?mode=ro"
        with closing(sqlite3.connect(address, uri=True)) as connection:
            found = [str(row[0]) for row in connection.execute(f"PRAGMA integrity_check({PROBLEMS_COUNT})")]
    except sqlite3.Error as error:
        raise store_error(error, doing=f"examining {database_path}") from error
    return [] if found == ["ok"] else found


def move_aside(database_path: Path, *, now_unix_s: float) -> Path:
    """Return the new place of a damaged database, beside the old one with the time in its name.

    Raises:
        StoreError: It cannot be moved.
    """
    stamp = datetime.fromtimestamp(now_unix_s, tz=UTC).strftime("%Y%m%dT%H%M%SZ")
    target = database_path.with_name(f"{database_path.name}.damaged-{stamp}")
    attempt = 1
    while target.exists():
        attempt += 1
        target = database_path.with_name(f"{database_path.name}.damaged-{stamp}-{attempt}")
    try:
        database_path.rename(target)
        for companion in _COMPANIONS:
            beside = database_path.with_name(database_path.name + companion)
            if beside.exists():
                beside.rename(target.with_name(target.name + companion))
        _drop_oldest(database_path)
    except OSError as error:
        raise StoreError(f"moving the damaged {database_path} aside: {error}") from error
    return target


def moved_aside(database_path: Path) -> list[Path]:
    """Return the damaged databases that are kept, oldest first."""
    kept = [
        path
        for path in database_path.parent.glob(f"{glob.escape(database_path.name)}.damaged-*")
        if not path.name.endswith(_COMPANIONS)
    ]
    # By their own change time: names come from a wall clock that may have been wrong.
    return sorted(kept, key=lambda path: path.stat().st_ctime_ns)


def _drop_oldest(database_path: Path) -> None:
    for old in moved_aside(database_path)[:-KEPT_COUNT]:
        for path in (old, *(old.with_name(old.name + companion) for companion in _COMPANIONS)):
            path.unlink(missing_ok=True)

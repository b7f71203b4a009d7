"""What to do with a database file that is damaged: keep it for whoever wants to look, and start afresh.

A road side unit that refuses to start because a power cut spoilt its memory helps nobody on the road.
"""

from __future__ import annotations

import glob
import sqlite3
import struct
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote

from roadgrip.errors import StoreDamagedError, StoreError
from rsu_app.adapters.store.connection import log_left_alone, store_error

KEPT_COUNT = 2
"""Damaged databases that are kept; older ones are deleted, or damage after damage would fill the disk."""
PROBLEMS_COUNT = 10
"""Findings of an examination that are told; the first already says enough."""
_COMPANIONS = ("-wal", "-shm")
_LOG_MAGIC = 0x377F_0682
_LOG_HEAD = struct.Struct(">8I")
"""Magic, version, page size, checkpoints, two salts, two sums."""
_FRAME_HEAD = struct.Struct(">6I")
"""Page, size of the database after this commit (zero within one), two salts, two sums."""
_INDEX_HEAD_BYTES, _READ_COUNT_AT = 48, 16
_SPOILT_FROM_COUNT = 2


def damage(database_path: Path) -> str | None:
    """Return what is wrong inside the file, or None if it is sound or does not exist.

    Raises:
        StoreError: It cannot be examined, which says nothing about its content.
    """
    if not database_path.exists():
        return None
    try:
        with log_left_alone(database_path), closing(sqlite3.connect(database_path)) as connection:
            verdict = str(connection.execute("PRAGMA quick_check(1)").fetchone()[0])
    except sqlite3.Error as error:
        problem = store_error(error, doing=f"examining {database_path}")
        if isinstance(problem, StoreDamagedError):
            return str(error)
        raise problem from error
    return None if verdict == "ok" else verdict


def keep_damaged_log(database_path: Path, *, now_unix_s: float) -> tuple[str, Path] | None:
    """Return what is wrong with the database's log, and where a copy of it lies; None if it is as SQLite left it.

    SQLite reads a log up to the first thing in it that is not right and forgets the rest without a word: that is how
    it drops a commit that a power cut interrupted. Each commit is on the disk before the next is begun, so that no
    more than one can be interrupted. Where two lie behind the place where reading ends, something else has spoilt the
    log, and commits that were acknowledged are in what is forgotten. To be called before anybody writes.

    Args:
        database_path: The database; it and its log may be missing.
        now_unix_s: The wall clock, for the copy's name.

    Raises:
        StoreError: It cannot be read, or not be copied.
    """
    log_path = database_path.with_name(database_path.name + "-wal")
    if not database_path.exists() or not log_path.exists():
        return None
    try:
        content = log_path.read_bytes()
        with log_left_alone(database_path), closing(sqlite3.connect(database_path)) as connection:
            # Reading makes SQLite look through the log.
            connection.execute("SELECT 1 FROM sqlite_schema").fetchone()
            found = log_problem(content, read_count=_read_frames_count(database_path))
            if found is None:
                return None
            target = _aside(database_path, label="damaged", now_unix_s=now_unix_s, suffix=".wal")
            target.write_bytes(content)
            _drop_oldest(database_path)
    except (sqlite3.Error, OSError) as error:
        problem = store_error(error, doing=f"examining {log_path}")
        if isinstance(problem, StoreDamagedError):
            return None  # the database itself is; whoever examines that finds it, and takes the log along
        raise problem from error
    return found, target


def log_problem(content: bytes, *, read_count: int) -> str | None:
    """Return what is wrong with a log, None if nothing but its last commit can be missing from what is read of it.

    Args:
        content: The file.
        read_count: Frames that SQLite takes from it.

    References:
        SQLite, database file format, section "The write-ahead log".
    """
    if len(content) < _LOG_HEAD.size:
        return None
    page_bytes, first_salt, second_salt = (_LOG_HEAD.unpack_from(content)[i] for i in (2, 4, 5))
    frame_bytes = _FRAME_HEAD.size + page_bytes
    if not _sound_log_head(content):
        return "the head of its log is spoilt" if len(content) > _LOG_HEAD.size else None
    places = range(_LOG_HEAD.size + read_count * frame_bytes, len(content) - frame_bytes + 1, frame_bytes)
    behind_count = 0
    for place in places:
        _, size_after_commit, *salts = _FRAME_HEAD.unpack_from(content, place)[:4]
        behind_count += size_after_commit > 0 and salts == [first_salt, second_salt]
    if behind_count < _SPOILT_FROM_COUNT:
        return None
    return f"its log is spoilt: {behind_count} commits lie behind the place up to which it can be read"


def _sound_log_head(content: bytes) -> bool:
    magic = _LOG_HEAD.unpack_from(content)[0]
    if magic & ~1 != _LOG_MAGIC:
        return False
    # The lowest bit says in which order the bytes of a number are added up.
    words = struct.unpack_from((">" if magic & 1 else "<") + "6I", content)
    first = second = 0
    for at in range(0, len(words), 2):
        first = (first + words[at] + second) & 0xFFFF_FFFF
        second = (second + words[at + 1] + first) & 0xFFFF_FFFF
    return (first, second) == _LOG_HEAD.unpack_from(content)[6:8]


def _read_frames_count(database_path: Path) -> int:
    """Return how many frames of the log SQLite takes, by the index that its connections share."""
    with database_path.with_name(database_path.name + "-shm").open("rb") as index:
        (count,) = struct.unpack_from("=I", index.read(_INDEX_HEAD_BYTES), _READ_COUNT_AT)
    return int(count)


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
    target = set_aside(database_path, label="damaged", now_unix_s=now_unix_s)
    try:
        _drop_oldest(database_path)
    except OSError as error:
        raise StoreError(f"making room for the damaged {database_path}: {error}") from error
    return target


def set_aside(path: Path, *, label: str, now_unix_s: float) -> Path:
    """Return the new name of a file or folder, in the same place; a database takes its log along.

    Args:
        path: What is there.
        label: What has become of it, for its new name.
        now_unix_s: The wall clock, for its new name.

    Raises:
        StoreError: It cannot be moved.
    """
    target = _aside(path, label=label, now_unix_s=now_unix_s)
    try:
        path.rename(target)
        for companion in _COMPANIONS:
            beside = path.with_name(path.name + companion)
            if beside.exists():
                beside.rename(target.with_name(target.name + companion))
    except OSError as error:
        raise StoreError(f"moving the {label} {path} aside: {error}") from error
    return target


def _aside(path: Path, *, label: str, now_unix_s: float, suffix: str = "") -> Path:
    """Return a name beside a file that says what has become of it, and when, and that nothing has yet."""
    stamp = datetime.fromtimestamp(now_unix_s, tz=UTC).strftime("%Y%m%dT%H%M%SZ")
    target = path.with_name(f"{path.name}.{label}-{stamp}{suffix}")
    attempt = 1
    while target.exists():
        attempt += 1
        target = path.with_name(f"{path.name}.{label}-{stamp}-{attempt}{suffix}")
    return target


def moved_aside(database_path: Path) -> list[Path]:
    """Return the damaged databases and logs that are kept, oldest first."""
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

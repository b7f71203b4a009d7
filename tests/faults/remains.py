"""What is left of a database after a fault, looked at in a copy: the unit that starts next finds it untouched."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from tests.faults.scenario import Finding


@dataclass(frozen=True)
class Remains:
    """What is left.

    Attributes:
        ids: Of the passages, one for each row.
        repeated_count: Rows whose id or whose values another row has too.
        problems: What SQLite finds wrong.
    """

    ids: tuple[bytes, ...]
    repeated_count: int
    problems: tuple[str, ...]


def remains_of(database: Path) -> Remains:
    """Return what a copy of the database and its log holds."""
    with tempfile.TemporaryDirectory() as folder:
        for suffix in ("", "-wal", "-journal"):
            path = database.with_name(database.name + suffix)
            if path.exists():
                shutil.copy(path, folder)
        return opened(Path(folder, database.name))


def opened(database: Path) -> Remains:
    """Return what a database holds; its log is worked in."""
    if not database.exists():
        return Remains((), 0, ())
    try:
        with closing(sqlite3.connect(database)) as connection:
            problems = tuple(str(row[0]) for row in connection.execute("PRAGMA integrity_check(5)") if row[0] != "ok")
            if not connection.execute("SELECT 1 FROM sqlite_schema WHERE name = 'passages'").fetchone():
                return Remains((), 0, problems)
            rows = connection.execute("SELECT passage_id, values_digest FROM passages").fetchall()
    except sqlite3.Error as error:
        return Remains((), 0, (str(error),))
    ids, digests = [row[0] for row in rows], [row[1] for row in rows]
    repeated_count = max(len(ids) - len(set(ids)), len(digests) - len(set(digests)))
    return Remains(tuple(ids), repeated_count, problems)


def judge(finding: Finding, left: Remains, acknowledged: Iterable[bytes]) -> None:
    """Add to a finding what is lost, twice there or wrong."""
    finding.lost_count += len(set(acknowledged) - set(left.ids))
    finding.duplicated_count += left.repeated_count
    finding.problems += left.problems

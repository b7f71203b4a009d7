"""Bringing the database to the shape this software expects.

alembic and the migrations cost 10 MB that a running unit would keep for years. So a process of their own runs them,
which is rare: a new database needs none, and an old one needs them once after an update.
"""

from __future__ import annotations

import json
import os
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from sqlalchemy import Connection, text

import rsu_app
from roadgrip.errors import StoreDamagedError, StoreError, StoreFullError
from rsu_app.adapters.store.connection import only_transaction, store_error, writing_engine
from rsu_app.adapters.store.schema import METADATA, REVISION

if TYPE_CHECKING:
    from alembic.config import Config

_VERSION_TABLE = """
CREATE TABLE alembic_version (
\tversion_num VARCHAR(32) NOT NULL,
\tCONSTRAINT alembic_version_pkc PRIMARY KEY (version_num)
)
"""
_FAILURES = {kind.__name__: kind for kind in (StoreError, StoreFullError, StoreDamagedError)}
"""By what the process that migrates calls them."""


@dataclass(frozen=True, slots=True)
class SchemaState:
    """Where a database stands.

    Attributes:
        current: Its revision, or None if it has none yet.
        expected: The revision that this software reads and writes.
    """

    current: str | None
    expected: str

    @property
    def up_to_date(self) -> bool:
        """Whether nothing needs to be done."""
        return self.current == self.expected


def check(database_path: Path) -> SchemaState:
    """Return where the database stands; one that does not exist has no revision. Changes nothing.

    Raises:
        StoreError: The file is no database or cannot be read.
    """
    if not database_path.exists():
        return SchemaState(current=None, expected=REVISION)
    try:
        address = f"file:{quote(str(database_path.absolute()))}?mode=ro"
        with closing(sqlite3.connect(address, uri=True)) as connection:
            known = connection.execute("SELECT 1 FROM sqlite_schema WHERE name = 'alembic_version'").fetchone()
            row = connection.execute("SELECT version_num FROM alembic_version").fetchone() if known else None
    except sqlite3.Error as error:
        raise store_error(error, doing=f"reading the revision of {database_path}") from error
    return SchemaState(current=row[0] if row else None, expected=REVISION)


def upgrade(database_path: Path) -> SchemaState:
    """Return where the database stands after it was brought up to date; makes it, and its folder, if missing.

    An empty one gets the tables as they are described. One of older software is migrated by a process of its own
    (`rsu_app.adapters.store.migrating`), in one transaction: a database is never left between two revisions.

    Raises:
        StoreError: A migration failed, or the database is newer than this software.
    """
    try:
        database_path.parent.mkdir(parents=True, exist_ok=True)
        with only_transaction(writing_engine(database_path), doing=f"migrating {database_path}") as connection:
            if not connection.execute(text("SELECT count(*) FROM sqlite_schema")).scalar():
                _make(connection)
    except OSError as error:
        raise store_error(error, doing=f"migrating {database_path}") from error
    state = check(database_path)
    if state.up_to_date:
        return state
    if state.current is not None and not _is_known(state.current):
        raise StoreError(f"{database_path} is at revision {state.current}, this software knows up to {REVISION}")
    _migrate_apart(database_path)
    return check(database_path)


def _is_known(revision: str) -> bool:
    return any(path.name.startswith(f"{revision}_") for path in (migrations_folder() / "versions").glob("*.py"))


def _make(connection: Connection) -> None:
    """Make what all migrations together make, as a test compares, with the mark that they have run."""
    METADATA.create_all(connection)
    connection.execute(text(_VERSION_TABLE))
    connection.execute(text("INSERT INTO alembic_version (version_num) VALUES (:revision)"), {"revision": REVISION})


def _migrate_apart(database_path: Path) -> None:
    # The child finds what this process found, and nothing beside its own working folder.
    surroundings = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    command = [sys.executable, "-P", "-m", "rsu_app.adapters.store.migrating", str(database_path)]
    try:
        done = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=False)  # noqa: S603 - this Python, a module of ours
    except OSError as error:
        raise store_error(error, doing=f"migrating {database_path}") from error
    if done.returncode == 0:
        return
    try:
        told = json.loads(done.stdout.splitlines()[-1])
        raise _FAILURES[told["kind"]](told["problem"])
    except (ValueError, LookupError) as error:
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise StoreError(f"migrating {database_path}: {last}") from error


def alembic_config() -> Config:
    """Return what alembic needs to know: where the migrations are."""
    from alembic.config import Config

    config = Config()
    # alembic reads its options through a parser to which a per cent sign means something.
    config.set_main_option("script_location", str(migrations_folder()).replace("%", "%%"))
    return config


def migrations_folder() -> Path:
    """Return where the migrations lie: inside the installed package, or at the top of a checkout.

    Raises:
        StoreError: The installation is incomplete.
    """
    package = Path(rsu_app.__file__).parent
    for folder in (package / "migrations", package.parent / "migrations"):
        if (folder / "env.py").is_file():
            return folder
    raise StoreError(f"the migrations are neither in {package} nor beside it; the installation is incomplete")

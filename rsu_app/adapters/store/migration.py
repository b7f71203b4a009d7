"""Bringing the database to the shape this software expects.

alembic is imported only when there is something to migrate: it costs 10 MB and 0.4 s that an ordinary start saves.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from sqlalchemy.exc import DBAPIError

import rsu_app
from roadgrip.errors import StoreError
from rsu_app.adapters.store.connection import store_error, writing_engine
from rsu_app.adapters.store.schema import REVISION

if TYPE_CHECKING:
    from alembic.config import Config


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
    """Return where the database stands after all migrations ran; makes it, and its folder, if missing.

    All of them run in one transaction: a database is never left between two revisions.

    Raises:
        StoreError: A migration failed, or the database is newer than this software.
    """
    from alembic import command
    from alembic.util import CommandError

    try:
        database_path.parent.mkdir(parents=True, exist_ok=True)
        engine = writing_engine(database_path)
        try:
            with engine.begin() as connection:
                config = alembic_config()
                config.attributes["connection"] = connection
                command.upgrade(config, "head")
        finally:
            engine.dispose()
    except CommandError as error:
        state = check(database_path)
        raise StoreError(
            f"{database_path} is at revision {state.current}, this software knows up to {REVISION}: {error}"
        ) from error
    except (DBAPIError, OSError) as error:
        raise store_error(error, doing=f"migrating {database_path}") from error
    return check(database_path)


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

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from roadgrip.errors import StoreError
from rsu_app.adapters.store import check, open_store, upgrade
from rsu_app.adapters.store.connection import writing_engine
from rsu_app.adapters.store.migration import alembic_config, migrations_folder
from rsu_app.adapters.store.schema import METADATA, REVISION


@pytest.fixture
def path(tmp_path):
    return tmp_path / "passages.db"


def schema_of(path):
    """Return each object of the database with the statement that made it, in one way of writing."""
    with closing(sqlite3.connect(path)) as connection:
        rows = connection.execute("SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL").fetchall()
    return {name: re.sub(r"\s+", " ", sql).strip() for name, sql in rows if name != "alembic_version"}


def run(path, step, revision):
    engine = writing_engine(path)
    with engine.begin() as connection:
        config = alembic_config()
        config.attributes["connection"] = connection
        step(config, revision)
    engine.dispose()


def test_the_software_expects_the_newest_revision():
    script = ScriptDirectory.from_config(alembic_config())
    assert script.get_heads() == [REVISION]


def test_migrations_make_the_tables_the_software_describes(path):
    upgrade(path)
    engine = writing_engine(path)
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), METADATA) == []
    engine.dispose()
    described = path.with_name("described.db")
    engine = writing_engine(described)
    with engine.begin() as connection:
        METADATA.create_all(connection)
    engine.dispose()
    assert schema_of(path) == schema_of(described)


def test_every_table_is_strict(path):
    upgrade(path)
    tables = {name: sql for name, sql in schema_of(path).items() if sql.startswith("CREATE TABLE")}
    assert len(tables) == 3
    assert all(sql.endswith("STRICT") for sql in tables.values())


def test_checking_says_where_a_database_stands_and_changes_nothing(path):
    assert check(path).current is None
    assert not check(path).up_to_date
    assert not path.exists()
    assert upgrade(path).up_to_date
    assert check(path).current == REVISION


def test_upgrading_twice_does_nothing(path):
    upgrade(path)
    before = schema_of(path)
    assert upgrade(path).up_to_date
    assert schema_of(path) == before


def test_every_step_down_and_up_again_works(path):
    upgrade(path)
    before = schema_of(path)
    revisions = [script.revision for script in ScriptDirectory.from_config(alembic_config()).walk_revisions()]
    for _ in revisions:
        run(path, command.downgrade, "-1")
    assert schema_of(path) == {}
    for _ in revisions:
        run(path, command.upgrade, "+1")
    assert schema_of(path) == before


def test_a_database_of_newer_software_is_refused_and_left_alone(path):
    upgrade(path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    content = path.read_bytes()
    with pytest.raises(StoreError, match=f"9999, this software knows up to {REVISION}"):
        open_store(path)
    assert check(path).current == "9999"
    assert path.read_bytes() == content


def test_a_migration_that_fails_leaves_the_database_as_it_was(path):
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE events (somebody_elses TEXT)")
    before = schema_of(path)
    with pytest.raises(StoreError, match="migrating"):
        upgrade(path)
    assert schema_of(path) == before
    assert check(path).current is None


def test_a_file_that_is_no_database_cannot_be_checked(path):
    path.write_text("not a database, not even nearly\n" * 100)
    with pytest.raises(StoreError, match="not a database"):
        check(path)


def test_migrations_import_nothing_of_ours():
    for file in migrations_folder().rglob("*.py"):
        assert not re.search(r"^\s*(from|import) (roadgrip|rsu_app)", file.read_text(), re.MULTILINE), file


def test_the_migrations_of_a_checkout_lie_at_its_top(project_root):
    assert migrations_folder() == Path(project_root) / "migrations"

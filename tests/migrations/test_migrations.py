from __future__ import annotations

import json
import re
import sqlite3
import sys
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
from rsu_app.adapters.store.migrating import main, migrate
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
    assert migrate(path).up_to_date
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


def everything_in(path):
    with closing(sqlite3.connect(path)) as connection:
        made = connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_schema ORDER BY name").fetchall()
        version = connection.execute("SELECT version_num FROM alembic_version").fetchall()
        (vacuum,) = connection.execute("PRAGMA auto_vacuum").fetchone()
    return [(*row[:3], re.sub(r"\s+", " ", row[3] or "").strip()) for row in made], version, vacuum


def test_a_new_database_is_made_as_all_migrations_make_it(path):
    migrated = path.with_name("migrated.db")
    migrate(migrated)
    upgrade(path)
    assert everything_in(path) == everything_in(migrated)


def test_a_database_of_older_software_is_migrated_by_a_process_that_ends(path):
    run(path, command.upgrade, "0001")
    assert upgrade(path).up_to_date
    migrated = path.with_name("migrated.db")
    migrate(migrated)
    assert schema_of(path) == schema_of(migrated)


def test_a_failed_migration_is_told_in_the_words_of_the_process_that_tried(path, capsys):
    run(path, command.upgrade, "0001")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE ledger (somebody_elses TEXT)")
    assert main(path) == 1
    told = json.loads(capsys.readouterr().out)
    with pytest.raises(StoreError) as raised:
        upgrade(path)
    assert type(raised.value).__name__ == told["kind"]
    assert str(raised.value) == told["problem"]
    assert "table ledger already exists" in told["problem"]
    assert check(path).current == "0001"


def test_a_process_that_cannot_even_begin_is_told(path, monkeypatch):
    run(path, command.upgrade, "0001")
    monkeypatch.setattr(sys, "executable", str(path.with_name("no-python")))
    with pytest.raises(StoreError, match="No such file"):
        upgrade(path)


def test_a_process_that_dies_without_a_word_is_told(path, monkeypatch):
    run(path, command.upgrade, "0001")
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(StoreError, match="exit code 1"):
        upgrade(path)


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

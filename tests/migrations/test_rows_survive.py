"""Rows that older software wrote, after every migration."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing

import pytest
from alembic import command

from roadgrip.records import NotCounted
from rsu_app.adapters.store import open_store
from rsu_app.adapters.store.connection import writing_engine
from rsu_app.adapters.store.migration import alembic_config
from rsu_app.ports import StoredEstimate

pytestmark = pytest.mark.usefixtures("migrations_run_here")

OLD = {
    "sequence_number": 7,
    "passage_id": b"p" * 16,
    "section_id": "bend",
    "map_version": "0123456789abcdef",
    "table_digest": "1b7bc963ba3dd63c",
    "features": b"\0" * 220,
    "duration_s": 12.5,
    "age_s": 1.0,
    "quality": 4,
    "received_unix_s": 1_767_268_800.0,
    "left_unix_s": 1_767_268_799.0,
    "bundle_id": "dd1ff2271c966bec",
    "mu": 0.42,
    "flags": 2,
    "content_digest": b"c" * 16,
    "values_digest": b"v" * 16,
}


def migrated(path, step, revision):
    engine = writing_engine(path)
    with engine.begin() as connection:
        config = alembic_config()
        config.attributes["connection"] = connection
        step(config, revision)
    engine.dispose()


def filled_at_the_first_revision(path):
    migrated(path, command.upgrade, "0001")
    with closing(sqlite3.connect(path)) as connection, connection:
        names = ", ".join(OLD)
        connection.execute(
            f"INSERT INTO passages ({names}) VALUES ({', '.join('?' * len(OLD))})",  # noqa: S608 - names of our own
            tuple(OLD.values()),
        )


def rows_of(path):
    with closing(sqlite3.connect(path)) as connection:
        connection.row_factory = sqlite3.Row
        return [dict(row) for row in connection.execute("SELECT * FROM passages")]


def test_a_row_from_before_says_nothing_of_its_error(tmp_path):
    path = tmp_path / "passages.db"
    filled_at_the_first_revision(path)

    async def story():
        store = open_store(path)
        found = await store.load(since_unix_s=0.0, limit_count=10)
        await store.close()
        return [passage.estimate for passage in found]

    assert asyncio.run(story()) == [
        StoredEstimate(
            passage_id=b"p" * 16,
            section_id="bend",
            content_digest=b"c" * 16,
            values_digest=b"v" * 16,
            mu=0.42,
            flags=NotCounted.OLDER_THAN_WINDOW,
            left_unix_s=1_767_268_799.0,
            bundle_id="dd1ff2271c966bec",
            expected_error_ratio=None,
            mu_low=None,
            at_least=False,
        )
    ]


def test_the_way_up_and_down_keeps_what_the_first_revision_knew(tmp_path):
    path = tmp_path / "passages.db"
    filled_at_the_first_revision(path)
    migrated(path, command.upgrade, "head")
    assert [{name: row[name] for name in OLD} for row in rows_of(path)] == [OLD]
    migrated(path, command.downgrade, "0001")
    assert rows_of(path) == [OLD]

"""What older software wrote down as events, as a ledger; and the way back."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing

import pytest
from alembic import command

from roadgrip.ledger import TEXT_LIMIT_CHARS, Action, chain_problems, hash_of
from rsu_app.adapters.store import open_store
from tests.migrations.test_rows_survive import migrated

pytestmark = pytest.mark.usefixtures("migrations_run_here")

EVENTS = [
    (17, 1_767_268_800.123456, "model_live", "dd1ff2271c966bec", "roadgrip-global"),
    (18, 1_767_268_801.0, "model_live", "", 'no model is loaded: a "file"\nis missing \\ täglich ☃'),
    (40, 5e-4, "model_live", "0123456789abcdef", "x" * (TEXT_LIMIT_CHARS + 1)),
    (41, -1e-9, "model_live", "0123456789abcdef", ""),
]


@pytest.fixture
def path(tmp_path):
    """A database of the revision before, with events whose oldest are gone."""
    path = tmp_path / "passages.db"
    migrated(path, command.upgrade, "0002")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?)", EVENTS)
    return path


def ledger_of(path):
    async def story():
        store = open_store(path)
        entries = await store.ledger(limit_count=100)
        await store.close()
        return list(entries)[::-1]

    return asyncio.run(story())


def events_in(path):
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute("SELECT * FROM events ORDER BY sequence_number").fetchall()


def test_every_event_becomes_an_entry_in_order(path):
    entries = ledger_of(path)
    assert [entry.sequence_number for entry in entries] == [1, 2, 3, 4]
    assert {(entry.actor, entry.action) for entry in entries} == {("unit", Action.LIVE)}
    assert [entry.subject for entry in entries] == [subject for _, _, _, subject, _ in EVENTS]
    assert [entry.reason for entry in entries] == [detail[:TEXT_LIMIT_CHARS] for *_, detail in EVENTS]
    assert [entry.at_unix_s for entry in entries] == pytest.approx([at for _, at, *_ in EVENTS], abs=5e-4)


def test_the_hashes_a_migration_computes_are_those_of_the_ledger(path):
    entries = ledger_of(path)
    assert [entry.entry_hash for entry in entries] == [hash_of(entry) for entry in entries]
    assert chain_problems(entries) == []


def test_the_chain_goes_on_after_what_was_migrated(path):
    async def story():
        store = open_store(path)
        entry = await store.record(at_unix_s=0.0, actor="unit", action=Action.LIVE, subject="b", reason="")
        await store.close()
        return entry

    assert asyncio.run(story()).sequence_number == len(EVENTS) + 1
    assert chain_problems(ledger_of(path)) == []


def test_a_database_without_events_gets_a_ledger_that_says_when_it_began(tmp_path):
    path = tmp_path / "passages.db"
    migrated(path, command.upgrade, "0002")
    assert [entry.action for entry in ledger_of(path)] == [Action.LEDGER_BEGUN]


def test_on_the_way_down_the_entries_are_events_again(path):
    migrated(path, command.upgrade, "0003")
    migrated(path, command.downgrade, "0002")
    kept = [
        (number, round(at, 3) + 0.0, kind, subject, detail[:TEXT_LIMIT_CHARS])
        for number, (_, at, kind, subject, detail) in enumerate(EVENTS, start=1)
    ]
    assert events_in(path) == kept


def test_actions_that_older_software_does_not_know_survive_the_way_down_and_up(path):
    async def story():
        store = open_store(path)
        await store.record(at_unix_s=0.0, actor="anna", action=Action.ROLLED_BACK, subject="b", reason="slippery")
        await store.close()

    asyncio.run(story())
    migrated(path, command.downgrade, "0002")
    assert events_in(path)[-1] == (5, 0.0, "rolled_back", "b", "slippery")
    last = ledger_of(path)[-1]
    assert (last.action, last.subject, last.reason) == (Action.ROLLED_BACK, "b", "slippery")
    assert chain_problems(ledger_of(path)) == []

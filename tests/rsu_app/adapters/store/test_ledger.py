"""The ledger in its file: what may be done to it, what is noticed, and what its budget takes."""

from __future__ import annotations

import asyncio
import shutil
import sqlite3
import threading
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.errors import StoreError
from roadgrip.ledger import Action, LedgerError, chain_problems
from rsu_app.adapters.store import archive, ledger_verdict, lineage, newest_entries, open_store, upgrade
from rsu_app.adapters.store.connection import only_transaction, writing_engine
from rsu_app.adapters.store.ledger_rows import append_entry
from rsu_app.adapters.store.ledger_rows import newest_entries as newest_rows
from rsu_app.adapters.store.schema import LEDGER_LIMIT_COUNT, LEDGER_TRIGGERS
from tests.rsu_app.adapters.store.stories import make_entry

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "passages.db"


@pytest.fixture(scope="module")
def filled_once(tmp_path_factory):
    path = tmp_path_factory.mktemp("filled") / "passages.db"
    recorded(path)
    return path


@pytest.fixture
def filled_path(path, filled_once):
    """A ledger of six entries, the first of which begins it."""
    return Path(shutil.copy(filled_once, path))


def recorded(path, count=5, *, action=Action.INSTALLED):
    """Record entries and return the whole ledger, oldest first."""

    async def story():
        store = open_store(path)
        for number in range(count):
            await store.record(at_unix_s=1e9 + number, actor="anna", action=action, subject=f"b{number}", reason="why")
        entries = await store.ledger(limit_count=1_000_000)
        await store.close()
        return list(entries)[::-1]

    return asyncio.run(story())


def tamper(path, *statements):
    """Do what a person does who knows how: drop what stands in the way, then act."""
    with closing(sqlite3.connect(path)) as connection, connection:
        for (name,) in connection.execute("SELECT name FROM sqlite_schema WHERE type = 'trigger'").fetchall():
            connection.execute(f"DROP TRIGGER {name}")
        for statement in statements:
            connection.execute(statement)
        for trigger in LEDGER_TRIGGERS:
            connection.execute(trigger)


HEAD = "(SELECT entry_hash FROM ledger ORDER BY sequence_number DESC LIMIT 1)"


def insert(number, previous=HEAD, *, how=""):
    return f"INSERT {how} INTO ledger VALUES ({number}, 0.0, 'x', 'live', 's', 'r', '{{}}', {previous}, 'h')"  # noqa: S608 - of our own


@pytest.mark.parametrize(
    ("statement", "complaint"),
    [
        ("UPDATE ledger SET reason = 'another' WHERE sequence_number = 1", "never changed"),
        ("UPDATE ledger SET sequence_number = 99 WHERE sequence_number = 6", "never changed"),
        ("DELETE FROM ledger WHERE sequence_number = 6", "never deleted"),
        ("DELETE FROM ledger", "never deleted"),
        (insert(8), "follows the newest"),
        (insert(7, "'another hash'"), "follows the newest"),
        (insert(7, "'another hash'", how="OR IGNORE"), "follows the newest"),
        (insert(6, how="OR REPLACE"), "follows the newest"),
        (insert(6) + " ON CONFLICT DO UPDATE SET reason = 'another'", "follows the newest"),
    ],
)
def test_a_slip_does_not_change_the_ledger(filled_path, statement, complaint):
    path, before = filled_path, newest_entries(filled_path, limit_count=100)
    with closing(sqlite3.connect(path)) as connection, pytest.raises(sqlite3.IntegrityError, match=complaint):
        connection.execute(statement)
    assert newest_entries(path, limit_count=100) == before


def test_the_newest_entries_cannot_be_deleted_and_the_budget_takes_the_oldest(path):
    recorded(path, 2)
    head = LEDGER_LIMIT_COUNT + 1
    # Three entries, and one a whole budget later.
    tamper(path, insert(head))
    with closing(sqlite3.connect(path)) as connection, pytest.raises(sqlite3.IntegrityError, match="never deleted"):
        connection.execute("DELETE FROM ledger WHERE sequence_number = 2")
    entries = recorded(path, 1)
    assert [entry.sequence_number for entry in entries] == [3, head, head + 1]


def test_a_ledger_that_nobody_touched_holds_together(path):
    entries = recorded(path)
    verdict = ledger_verdict(path, known_heads=[entry.entry_hash for entry in entries])
    assert (verdict.entries_count, verdict.head_hash, verdict.problems) == (6, entries[-1].entry_hash, ())


@pytest.mark.parametrize(
    ("statement", "problem"),
    [
        ("UPDATE ledger SET reason = 'another' WHERE sequence_number = 3", "entry 3 was changed"),
        ("UPDATE ledger SET at_unix_s = 1e300 WHERE sequence_number = 3", "entry 3 was changed"),
        ("DELETE FROM ledger WHERE sequence_number = 4", "entry 5 follows entry 3"),
        ("UPDATE ledger SET action = 'no such act' WHERE sequence_number = 2", "entry 2 cannot be read"),
        ("UPDATE ledger SET evidence_json = '[' WHERE sequence_number = 2", "entry 2 cannot be read"),
        ("UPDATE ledger SET evidence_json = '[]' WHERE sequence_number = 2", "entry 2 cannot be read"),
        ("DELETE FROM ledger WHERE sequence_number < 3", "entries before 3 are missing"),
        ("DELETE FROM ledger WHERE sequence_number = 6", "that was told elsewhere is missing"),
        ("DELETE FROM ledger", "that was told elsewhere is missing"),
    ],
)
@pytest.mark.parametrize("batch_count", [1, 2, 1000])
def test_whoever_means_it_is_noticed(filled_path, monkeypatch, statement, problem, batch_count):
    monkeypatch.setattr(archive, "ENTRIES_BATCH_COUNT", batch_count)
    head = lineage(filled_path).ledger_hash
    tamper(filled_path, statement)
    problems = ledger_verdict(filled_path, known_heads=[head]).problems
    assert [line for line in problems if problem in line]
    assert len(set(problems)) == len(problems)


def test_what_is_told_of_a_broken_ledger_does_not_depend_on_the_batches(path, monkeypatch):
    recorded(path, 10)
    tamper(
        path,
        "UPDATE ledger SET reason = 'another' WHERE sequence_number IN (2, 5)",
        "DELETE FROM ledger WHERE sequence_number IN (7, 8)",
    )
    found = []
    for batch_count in (1, 3, 1000):
        monkeypatch.setattr(archive, "ENTRIES_BATCH_COUNT", batch_count)
        found.append(sorted(ledger_verdict(path).problems))
    assert found[0] == found[1] == found[2]
    assert len(found[0]) == 3


def test_nothing_is_appended_to_an_entry_that_cannot_be_read_and_the_unit_still_stores(path):
    recorded(path)
    tamper(path, "UPDATE ledger SET action = 'no such act' WHERE sequence_number = 6")

    async def story():
        store = open_store(path)
        with pytest.raises(StoreError, match="entry 6 cannot be read"):
            await store.record(at_unix_s=0.0, actor="unit", action=Action.LIVE, subject="b", reason="")
        with pytest.raises(StoreError, match="entry 6 cannot be read"):
            await store.ledger(limit_count=1)
        assert await store.append([make_entry(1)]) == [None]
        await store.close()

    asyncio.run(story())
    with pytest.raises(LedgerError):
        newest_entries(path, limit_count=1)


def test_two_writers_make_one_chain(path):
    upgrade(path)

    def write(name):
        for number in range(10):
            with only_transaction(writing_engine(path), doing="recording") as connection:
                append_entry(connection, at_unix_s=0.0, actor=name, action=Action.LIVE, subject=str(number), reason="")

    threads = [threading.Thread(target=write, args=(name,)) for name in ("unit", "command")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    verdict = ledger_verdict(path)
    assert (verdict.entries_count, verdict.problems) == (20, ())


def test_the_ledger_can_be_verified_while_a_unit_writes(path):
    async def story():
        store = open_store(path)

        async def record():
            for number in range(30):
                await store.record(at_unix_s=0.0, actor="unit", action=Action.LIVE, subject=f"b{number}", reason="")

        task = asyncio.create_task(record())
        verdicts = []
        while not task.done():
            verdicts.append(await asyncio.to_thread(ledger_verdict, path))
        await task
        await store.close()
        return verdicts

    verdicts = asyncio.run(story())
    assert verdicts
    assert {verdict.problems for verdict in verdicts} == {()}
    assert ledger_verdict(path).entries_count == 31


def test_the_live_bundle_is_the_newest_that_went_live(path):
    recorded(path, 1, action=Action.LIVE)
    recorded(path, 3, action=Action.SWITCHED)
    entries = recorded(path, 5, action=Action.INSTALLED)
    said = lineage(path)
    assert (said.bundle_id, said.ledger_hash, said.newest_received_unix_s) == ("b2", entries[-1].entry_hash, 0.0)


@pytest.mark.parametrize("ask", [ledger_verdict, lineage])
def test_a_database_that_is_not_there_is_not_made_by_asking(path, ask):
    with pytest.raises(StoreError, match="does not exist"):
        ask(path)
    assert not path.exists()


@pytest.mark.parametrize("ask", [ledger_verdict, lineage])
def test_a_database_of_another_schema_is_not_read(path, ask):
    recorded(path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '0002'")
    with pytest.raises(StoreError, match="revision 0002"):
        ask(path)


@pytest.fixture(scope="module")
def shared_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("ledger") / "passages.db"
    upgrade(path)
    return path


@settings(max_examples=40)
@given(
    at_unix_s=st.floats(),
    actor=TEXTS,
    action=st.sampled_from(Action),
    subject=TEXTS,
    reason=TEXTS,
    evidence=st.dictionaries(TEXTS, TEXTS, max_size=3),
)
def test_whatever_is_recorded_comes_back_with_its_hash(shared_path, **said):
    with only_transaction(writing_engine(shared_path), doing="recording") as connection:
        before = newest_rows(connection, limit_count=1)
        entry = append_entry(connection, **said)
        assert newest_rows(connection, limit_count=1) == [entry]
    assert chain_problems([*before, entry]) == []

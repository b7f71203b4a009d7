from __future__ import annotations

import asyncio
import sqlite3
from contextlib import asynccontextmanager, closing
from dataclasses import replace

import numpy as np
import pytest

from roadgrip.errors import ConfigurationError, StoreError
from roadgrip.records import NotCounted
from rsu_app.adapters.store import WriterLimits, open_store, rows
from rsu_app.adapters.store.connection import reading_engine, writing_engine
from rsu_app.adapters.store.schema import REVISION
from rsu_app.adapters.store.sqlite import PRUNE_BATCH_COUNT
from tests.rsu_app.adapters.store.stories import SECTION, make_entry
from tests.rsu_app.fakes import NOON_UNIX_S, make_passage


@pytest.fixture
def path(tmp_path):
    return tmp_path / "passages.db"


@asynccontextmanager
async def opened(path, *, size_limit_bytes=None, **limits):
    store = open_store(path, limits=WriterLimits(**limits), size_limit_bytes=size_limit_bytes)
    try:
        yield store
    finally:
        await store.close()


def query(path, statement):
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(statement).fetchall()


def held_bytes(path):
    [(pages_count,)], [(free_count,)] = query(path, "PRAGMA page_count"), query(path, "PRAGMA freelist_count")
    return 4096 * (pages_count - free_count)


async def load_all(store):
    return [passage.estimate for passage in await store.load(since_unix_s=0.0, limit_count=10_000)]


def test_what_was_acknowledged_is_in_the_file(path):
    async def story():
        async with opened(path) as store:
            for seed in range(3):
                assert await store.append([make_entry(seed)]) == [None]
                assert len(query(path, "SELECT 1 FROM passages")) == seed + 1

    asyncio.run(story())


def test_a_passage_is_kept_as_it_came(path):
    entry = make_entry(passage=make_passage(SECTION, age_s=12.5), mu=0.31, flags=NotCounted.OUT_OF_ENVELOPE)

    async def story():
        async with opened(path) as store:
            await store.append([entry])
        async with opened(path) as store:
            assert await load_all(store) == [entry.estimate]

    asyncio.run(story())
    [(features, duration_s, age_s, received_unix_s)] = query(
        path, "SELECT features, duration_s, age_s, received_unix_s FROM passages"
    )
    assert tuple(np.frombuffer(features, "<f4").astype(float)) == entry.passage.summary.values
    assert (duration_s, age_s) == (entry.passage.summary.duration_s, 12.5)
    assert received_unix_s == entry.received_unix_s


def test_an_estimate_that_is_no_number_is_kept_as_missing(path):
    async def story():
        async with opened(path) as store:
            await store.append([make_entry(mu=None, flags=NotCounted.ESTIMATE_OUT_OF_RANGE)])
            [estimate] = await load_all(store)
            assert estimate.mu is None

    asyncio.run(story())


@pytest.mark.parametrize("said", [(None, None, False), (0.1, 0.4, False), (0.3, 0.25, True)])
def test_what_is_expected_of_the_error_comes_back_as_it_was(path, said):
    error_ratio, mu_low, at_least = said
    entry = make_entry()
    estimate = replace(entry.estimate, expected_error_ratio=error_ratio, mu_low=mu_low, at_least=at_least)

    async def story():
        async with opened(path) as store:
            await store.append([replace(entry, estimate=estimate)])
            return await load_all(store)

    assert asyncio.run(story()) == [estimate]


def test_the_same_id_or_the_same_values_return_what_is_held(path):
    first = make_entry(1)
    same_id = make_entry(passage=make_passage(SECTION, seed=2, passage_id=first.passage.passage_id))
    same_values = make_entry(passage=make_passage(SECTION, seed=1, passage_id=b"z" * 16))

    async def story():
        async with opened(path) as store:
            assert await store.append([first]) == [None]
            assert await store.append([first]) == [first.estimate]
            assert await store.append([same_id]) == [first.estimate]
            assert await store.append([same_values]) == [first.estimate]
        async with opened(path) as store:
            assert await store.append([same_values]) == [first.estimate]
            assert (await store.counts()).passages_count == 1

    asyncio.run(story())


def test_repetitions_meet_within_one_group_too(path):
    entries = [make_entry(seed) for seed in (1, 2, 1, 3, 2, 1)]

    async def story():
        async with opened(path) as store:
            answers = await store.append(entries)
            assert [answer is None for answer in answers] == [True, True, False, True, False, False]
            assert answers[5] == entries[0].estimate

    asyncio.run(story())


def test_many_senders_at_once_share_commits(path):
    async def story():
        async with opened(path, group_count=64) as store:
            await asyncio.gather(*(store.append([make_entry(seed)]) for seed in range(200)))
            assert (await store.counts()).passages_count == 200

    asyncio.run(story())


def test_loading_gives_the_newest_oldest_first(path):
    async def story():
        async with opened(path) as store:
            for seed, minutes in enumerate((5, 1, 3, 2, 4)):
                await store.append([make_entry(seed, received_unix_s=NOON_UNIX_S + 60.0 * minutes)])
            loaded = await store.load(since_unix_s=NOON_UNIX_S + 120.0, limit_count=3)
            assert [passage.estimate.left_unix_s - NOON_UNIX_S for passage in loaded] == [180.0, 240.0, 300.0]

    asyncio.run(story())


def test_a_sender_that_hangs_up_does_not_stop_the_writer(path):
    async def story():
        async with opened(path) as store:
            task = asyncio.create_task(store.append([make_entry(1)]))
            await asyncio.sleep(0)
            task.cancel()
            assert await store.append([make_entry(2)]) == [None]
            assert (await store.counts()).passages_count == 2

    asyncio.run(story())


def test_closing_writes_what_waits_and_then_refuses(path):
    async def story():
        store = open_store(path)
        waiting = [asyncio.create_task(store.append([make_entry(seed)])) for seed in range(20)]
        await asyncio.sleep(0)
        await store.close()
        assert await asyncio.gather(*waiting) == [[None]] * 20
        with pytest.raises(StoreError, match="closed"):
            await store.append([make_entry(99)])
        await store.close()

    asyncio.run(story())
    assert query(path, "SELECT count(*) FROM passages") == [(20,)]


def test_pruning_by_age_then_by_number(path):
    async def story():
        async with opened(path) as store:
            for seed in range(10):
                await store.append([make_entry(seed, received_unix_s=NOON_UNIX_S + seed)])
            assert await store.prune(before_unix_s=NOON_UNIX_S + 3.0, rows_limit_count=100) == 3
            assert await store.prune(before_unix_s=None, rows_limit_count=5) == 2
            assert await store.prune(before_unix_s=None, rows_limit_count=5) == 0
            left = await load_all(store)
            assert [estimate.left_unix_s - NOON_UNIX_S for estimate in left] == [5.0, 6.0, 7.0, 8.0, 9.0]

    asyncio.run(story())


def test_pruning_keeps_what_the_database_holds_below_its_size(path):
    async def story():
        async with opened(path, size_limit_bytes=600_000) as store:
            await asyncio.gather(*(store.append([make_entry(seed)]) for seed in range(1_500)))
            before = await load_all(store)
            deleted_count = await store.prune(before_unix_s=None, rows_limit_count=10_000)
            left = await load_all(store)
            # Whole batches, the first that came; no more of them than the size asks for.
            assert deleted_count % PRUNE_BATCH_COUNT == 0
            assert 0 < deleted_count < 1_500
            assert {e.passage_id for e in left} == {e.passage_id for e in before[deleted_count:]}
            assert held_bytes(path) <= 600_000 < held_bytes(path) * 1_500 / len(left)
            assert await store.prune(before_unix_s=None, rows_limit_count=10_000) == 0

    asyncio.run(story())


def test_free_pages_do_not_count_as_size(path):
    async def story():
        async with opened(path) as store:
            await asyncio.gather(*(store.append([make_entry(seed)]) for seed in range(600)))
        with closing(sqlite3.connect(path)) as connection, connection:
            connection.execute("DELETE FROM passages WHERE sequence_number > 100")
        [(pages_count,)] = query(path, "PRAGMA page_count")
        async with opened(path, size_limit_bytes=300_000) as store:
            assert pages_count * 4096 > 300_000
            assert await store.prune(before_unix_s=None, rows_limit_count=10_000) == 0

    asyncio.run(story())


def test_a_size_that_cannot_be_kept_ends_with_the_last_passage(path):
    async def story():
        async with opened(path, size_limit_bytes=1) as store:
            await store.append([make_entry(1)])
            assert await store.prune(before_unix_s=None, rows_limit_count=10) == 1
            assert len(await store.ledger(limit_count=10)) == 1

    asyncio.run(story())


def test_pruning_gives_pages_back_to_the_file_system(path):
    async def story():
        async with opened(path) as store:
            await asyncio.gather(*(store.append([make_entry(seed)]) for seed in range(600)))
            [(before_count,)] = query(path, "PRAGMA page_count")
            assert await store.prune(before_unix_s=NOON_UNIX_S + 1.0, rows_limit_count=1) == 600
            [(after_count,)] = query(path, "PRAGMA page_count")
            assert after_count < before_count / 3

    asyncio.run(story())


def test_the_probe_writes_only_when_no_commit_is_fresh(path):
    async def story():
        async with opened(path) as store:
            await store.probe()
            assert len(query(path, "SELECT 1 FROM probes")) == 1
        async with opened(path) as store:
            [(first_unix_s,)] = query(path, "SELECT written_unix_s FROM probes")
            await store.append([make_entry(1)])
            await store.probe()
            assert query(path, "SELECT written_unix_s FROM probes") == [(first_unix_s,)]

    asyncio.run(story())


def test_the_probe_notices_that_the_file_is_gone(path):
    async def story():
        async with opened(path) as store:
            await store.append([make_entry(1)])
            path.unlink()
            with pytest.raises(StoreError, match="gone"):
                await store.probe()

    asyncio.run(story())


def test_the_size_on_disk_is_told(path):
    async def story():
        async with opened(path) as store:
            counts = await store.counts()
            assert counts.passages_count == 0
            assert counts.database_bytes > 0
            assert counts.queue_limit_count == WriterLimits().queue_count

    asyncio.run(story())


def test_the_writer_has_the_pragmas_that_durability_needs(path):
    open_and_close(path)
    engine = writing_engine(path)
    with engine.connect() as connection:
        raw = connection.connection.driver_connection
        assert raw is not None
        found = {
            name: raw.execute(f"PRAGMA {name}").fetchone()[0]
            for name in ("journal_mode", "synchronous", "foreign_keys", "auto_vacuum", "busy_timeout", "trusted_schema")
        }
    engine.dispose()
    assert found == {
        "journal_mode": "wal",
        "synchronous": 2,
        "foreign_keys": 1,
        "auto_vacuum": 2,
        "busy_timeout": 5000,
        "trusted_schema": 0,
    }


def test_a_reader_cannot_write(path):
    open_and_close(path)
    engine = reading_engine(path)
    with engine.connect() as connection, pytest.raises(Exception, match="readonly"):
        connection.exec_driver_sql("DELETE FROM passages")
    engine.dispose()


def open_and_close(path):
    async def story():
        async with opened(path) as store:
            return store.notes

    return asyncio.run(story())


@pytest.mark.parametrize("name", ["with space.db", "per%cent.db", "ques?tion.db", "hash#.db", "ünïcode.db"])
def test_any_file_name_will_do(tmp_path, name):
    assert open_and_close(tmp_path / "new folder" / name) == (
        f"the database was migrated from revision None to {REVISION}",
    )
    assert (tmp_path / "new folder" / name).stat().st_size > 0
    assert open_and_close(tmp_path / "new folder" / name) == ()


@pytest.mark.parametrize("limits", [{"queue_count": 0}, {"group_count": 0}])
def test_limits_that_cannot_work_are_refused(limits):
    with pytest.raises(ConfigurationError):
        WriterLimits(**limits)


def test_an_earlier_portion_of_the_window_is_found_without_reading_what_is_newer(path):
    async def story():
        async with opened(path) as store:
            await store.append([make_entry(seed) for seed in range(4)])

    asyncio.run(story())
    asked: list[str] = []
    with reading_engine(path).connect() as connection:
        driver = connection.connection.driver_connection
        assert isinstance(driver, sqlite3.Connection)
        driver.set_trace_callback(asked.append)
        rows.passages_since(connection, since_unix_s=0.0, limit_count=2, before=(NOON_UNIX_S, 3))
    (statement,) = (text for text in asked if text.startswith("SELECT"))
    ((*_, plan),) = query(path, f"EXPLAIN QUERY PLAN {statement}")
    assert "passages_received (received_unix_s>? AND received_unix_s<?)" in plan

from __future__ import annotations

import asyncio
import sqlite3
import threading
from contextlib import asynccontextmanager, closing

import pytest
from sqlalchemy import event, text

from roadgrip.errors import StoreError, StoreFullError
from rsu_app.adapters.store import WriterLimits, upgrade
from rsu_app.adapters.store.connection import writing_engine
from rsu_app.adapters.store.writer import Writer
from tests.rsu_app.adapters.store.stories import SECTION, make_entry
from tests.rsu_app.fakes import make_passage

PATIENCE_S = 60.0


@pytest.fixture
def path(tmp_path):
    upgrade(tmp_path / "passages.db")
    return tmp_path / "passages.db"


@asynccontextmanager
async def writing(path, **limits):
    writer = Writer(writing_engine(path), WriterLimits(**limits))
    try:
        yield writer
    finally:
        await writer.close()


def passages_count(path):
    with closing(sqlite3.connect(path)) as connection:
        [(count,)] = connection.execute("SELECT count(*) FROM passages")
    return count


async def hold_up(writer):
    """Keep the writer busy until the returned event is set; the task ends with its transaction."""
    started, release = threading.Event(), threading.Event()

    def wait(_):
        started.set()
        release.wait(PATIENCE_S)

    task = asyncio.create_task(writer.submit(wait))
    await asyncio.to_thread(started.wait, PATIENCE_S)
    return release, task


def test_a_full_queue_refuses_at_once_and_takes_more_later(path):
    async def story():
        async with writing(path, queue_count=2) as writer:
            release, holding = await hold_up(writer)
            waiting = [asyncio.create_task(writer.submit([make_entry(seed)])) for seed in (1, 2)]
            await asyncio.sleep(0)
            assert writer.queued_count == 2
            with pytest.raises(StoreFullError, match="2 writes wait already"):
                await writer.submit([make_entry(3)])
            release.set()
            await holding
            assert await asyncio.gather(*waiting) == [[None], [None]]
            assert await writer.submit([make_entry(3)]) == [None]

    asyncio.run(story())
    assert passages_count(path) == 3


def test_passages_that_wait_share_a_commit(path):
    commits: list[object] = []

    async def story():
        engine = writing_engine(path)
        event.listen(engine, "commit", commits.append)
        writer = Writer(engine, WriterLimits(group_count=25))
        release, holding = await hold_up(writer)
        waiting = [asyncio.create_task(writer.submit([make_entry(seed)])) for seed in range(50)]
        await asyncio.sleep(0)
        release.set()
        await asyncio.gather(holding, *waiting)
        await writer.close()

    asyncio.run(story())
    # One that held the writer up, two full groups.
    assert len(commits) == 3
    assert passages_count(path) == 50


def test_a_group_that_fails_fails_for_all_of_its_senders(path):
    async def story():
        async with writing(path) as writer:
            broken = make_entry(passage=make_passage(SECTION, seed=9, passage_id=b"short"))
            entries = [make_entry(1), broken, make_entry(2), make_entry(3)]
            release, holding = await hold_up(writer)
            waiting = [asyncio.create_task(writer.submit([entry])) for entry in entries]
            await asyncio.sleep(0)
            release.set()
            await holding
            answers = await asyncio.gather(*waiting, return_exceptions=True)
            assert [type(answer) for answer in answers] == [StoreError] * 4
            assert passages_count(path) == 0
            assert await writer.submit([entries[0]]) == [None]

    asyncio.run(story())


def test_nothing_is_answered_before_its_commit(path):
    async def story():
        async with writing(path) as writer:
            release, holding = await hold_up(writer)
            waiting = asyncio.create_task(writer.submit([make_entry(1)]))
            await asyncio.sleep(0.02)
            assert not waiting.done()
            release.set()
            await asyncio.gather(holding, waiting)
            assert passages_count(path) == 1

    asyncio.run(story())


def test_a_full_disk_refuses_and_its_end_is_noticed(path):
    async def story():
        async with writing(path, group_count=1) as writer:
            await writer.submit([make_entry(0)])
            with closing(sqlite3.connect(path)) as connection:
                [(used_count,)] = connection.execute("PRAGMA page_count")
            await writer.submit(f"PRAGMA max_page_count = {used_count}")
            refused = 0
            for seed in range(1, 100):
                try:
                    await writer.submit([make_entry(seed)])
                except StoreFullError as error:
                    assert "the disk is full" in str(error)  # noqa: PT017 - it is not known which one does not fit
                    refused += 1
                    break
            assert refused == 1
            assert writer.committed_ago_s is None
            # A failed write opens a fresh connection, on which this test's limit is gone: there is room again.
            assert await writer.submit([make_entry(1000)]) == [None]
            assert writer.committed_ago_s is not None

    asyncio.run(story())


def test_work_that_fails_is_answered_and_the_thread_lives(path):
    def fail(_):
        raise ZeroDivisionError("by design")

    async def story():
        async with writing(path) as writer:
            with pytest.raises(StoreError, match="by design"):
                await writer.submit(fail)
            with pytest.raises(StoreError, match="no such table"):
                await writer.submit(lambda connection: connection.execute(text("DELETE FROM nowhere")))
            with pytest.raises(StoreError, match="syntax"):
                await writer.submit("THIS IS NO SQL")
            assert await writer.submit([make_entry(1)]) == [None]

    asyncio.run(story())


def test_work_that_fails_half_way_leaves_nothing_behind(path):
    def half(connection):
        connection.execute(text("INSERT INTO probes VALUES (1, 0.0)"))
        raise ZeroDivisionError("half way")

    async def story():
        async with writing(path) as writer:
            with pytest.raises(StoreError):
                await writer.submit(half)

    asyncio.run(story())
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT count(*) FROM probes").fetchone() == (0,)


def test_a_loop_that_is_gone_does_not_stop_the_writer(path):
    async def story():
        writer = Writer(writing_engine(path), WriterLimits())
        release, holding = await hold_up(writer)
        waiting = asyncio.create_task(writer.submit([make_entry(1)]))
        await asyncio.sleep(0)
        holding.cancel()
        waiting.cancel()
        return writer, release

    async def end(writer):
        assert await writer.submit([make_entry(2)]) == [None]
        await writer.close()

    writer, release = asyncio.run(story())
    release.set()
    asyncio.run(end(writer))
    assert passages_count(path) == 2


def test_a_writer_that_is_stuck_can_be_seen_without_asking_it(path):
    async def story():
        async with writing(path) as writer:
            release, holding = await hold_up(writer)
            began_s = writer.busy_s
            assert began_s > 0.0
            assert writer.busy_s > began_s
            release.set()
            await holding
        assert writer.busy_s == 0.0

    asyncio.run(story())

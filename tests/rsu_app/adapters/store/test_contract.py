"""What the port promises, asked of the real store and of the fake that other tests lean on."""

from __future__ import annotations

import asyncio

import pytest

from rsu_app.adapters.store import open_store
from rsu_app.ports import Event
from tests.rsu_app.adapters.store.stories import SECTION, make_entry
from tests.rsu_app.fakes import NOON_UNIX_S, FakeStore, make_passage


@pytest.fixture(params=["sqlite", "fake"])
def run(request, tmp_path):
    """Return a function that runs a story with a store."""

    def runner(story):
        async def told():
            store = FakeStore() if request.param == "fake" else open_store(tmp_path / "passages.db")
            try:
                await story(store)
            finally:
                await store.close()

        asyncio.run(told())

    return runner


def test_a_repetition_returns_what_is_held_under_the_id_before_what_has_the_values(run):
    first, second = make_entry(1), make_entry(2)
    both = make_entry(passage=make_passage(SECTION, seed=2, passage_id=first.passage.passage_id))

    async def story(store):
        assert await store.append(first) is None
        assert await store.append(second) is None
        assert await store.append(both) == first.estimate
        assert (await store.counts()).passages_count == 2

    run(story)


def test_loading_gives_the_newest_oldest_first(run):
    entries = [make_entry(seed, received_unix_s=NOON_UNIX_S + seed) for seed in range(5)]

    async def story(store):
        for entry in entries:
            await store.append(entry)
        loaded = await store.load(since_unix_s=NOON_UNIX_S + 1.0, limit_count=3)
        assert [passage.estimate for passage in loaded] == [entry.estimate for entry in entries[2:]]
        [newest] = await store.load(since_unix_s=NOON_UNIX_S + 4.0, limit_count=3)
        assert newest.estimate == entries[4].estimate

    run(story)


def test_what_is_loaded_has_the_values_that_were_judged(run):
    entry = make_entry(1)

    async def story(store):
        await store.append(entry)
        [loaded] = await store.load(since_unix_s=0.0, limit_count=1)
        assert loaded.table_digest == entry.passage.summary.table_digest
        assert tuple(loaded.values.tolist()) == entry.passage.summary.values

    run(story)


def test_pruning_forgets_ids_and_values_with_the_passage(run):
    entries = [make_entry(seed, received_unix_s=NOON_UNIX_S + seed) for seed in range(4)]

    async def story(store):
        for entry in entries:
            await store.append(entry)
        assert await store.prune(before_unix_s=NOON_UNIX_S + 1.0, rows_limit_count=2) == 2
        assert await store.append(entries[0]) is None
        assert await store.append(entries[3]) == entries[3].estimate

    run(story)


def test_events_come_newest_first(run):
    async def story(store):
        for number in range(3):
            await store.record_event(Event(NOON_UNIX_S + number, "model_live", f"bundle-{number}", "detail"))
        newest = await store.events(limit_count=1)
        assert list(newest) == [Event(NOON_UNIX_S + 2.0, "model_live", "bundle-2", "detail")]

    run(story)


def test_a_probe_passes_when_writing_works(run):
    async def story(store):
        await store.probe()

    run(story)

from __future__ import annotations

import asyncio

import pytest

from roadgrip.errors import StoreError
from roadgrip.ledger import Action
from roadgrip.records import Accepted
from rsu_app.usecases import UnitLimits, restoring
from tests.rsu_app.fakes import FakeClock, FakeStore, make_passage
from tests.rsu_app.usecases.site import SECTION, Site


@pytest.mark.parametrize("offline_s", [0.0, 600.0])
def test_a_restart_restores_the_window(offline_s):
    async def story():
        site = Site()
        await site.ingest_many(12, mu=0.4)
        await site.unit.ingest_passage(make_passage(SECTION, seed=99, mu=0.4, age_s=3300.0))
        # The machine was off: its monotonic clock starts anew.
        later = FakeClock(monotonic_s=5.0, unix_s=site.clock.now_unix_s + offline_s)
        again = Site(store=site.store, clock=later)
        assert await again.unit.restore() == (13 if offline_s == 0.0 else 12)
        assert again.interval().newest_age_s == pytest.approx(offline_s)
        assert again.interval().median_mu == pytest.approx(0.4, abs=1e-6)

    asyncio.run(story())


def test_restoring_twice_counts_once():
    async def story():
        site = Site()
        await site.ingest_many(3)
        assert await site.unit.restore() == 0
        again = site.restarted()
        assert await again.unit.restore() == 3
        assert await again.unit.restore() == 0
        assert again.interval().passages_count == 3

    asyncio.run(story())


def test_what_did_not_count_does_not_count_after_a_restart():
    async def story():
        site = Site()
        site.model.answer_mu = 5.0
        await site.ingest_many(3)
        site.model.answer_mu = None
        again = site.restarted()
        assert await again.unit.restore() == 0
        assert len(site.store.entries) == 3

    asyncio.run(story())


def test_a_unit_that_boots_in_1970_restores_once_its_clock_is_set():
    async def story():
        site = Site()
        await site.ingest_many(12, mu=0.4)
        clock = FakeClock(monotonic_s=5.0, unix_s=60.0)
        again = Site(store=site.store, clock=clock)
        assert await again.unit.restore() == 0
        await again.ingest_many(1, mu=0.4, first_seed=50)
        assert again.interval().passages_count == 1
        clock.now_unix_s = site.clock.now_unix_s + 30.0
        assert await again.unit.catch_up() == 12
        assert again.interval().passages_count == 13
        assert await again.unit.catch_up() == 0
        assert again.interval().passages_count == 13

    asyncio.run(story())


def test_a_unit_whose_disk_is_full_at_the_start_notes_its_model_later():
    async def story():
        site = Site()
        site.store.error = StoreError("the disk is full")
        await site.unit.catch_up()
        assert [entry.action for entry in site.store.ledger_entries] == [Action.LEDGER_BEGUN]
        site.store.error = None
        for _ in range(2):
            await site.unit.catch_up()
        assert [entry.action for entry in site.store.ledger_entries] == [Action.LEDGER_BEGUN, Action.LIVE]

    asyncio.run(story())


def test_passages_from_the_future_do_not_enter_a_restored_window():
    async def story():
        site = Site()
        await site.ingest_many(3)
        clock = FakeClock(unix_s=site.clock.now_unix_s - 600.0)
        again = Site(store=site.store, clock=clock)
        assert await again.unit.restore() == 0

    asyncio.run(story())


def test_pruning_keeps_the_budget_and_does_not_trust_a_clock_that_just_stepped():
    async def story():
        site = Site(limits=UnitLimits(retention_s=86_400.0, rows_count=5))
        await site.unit.restore()
        await site.ingest_many(7)
        assert await site.unit.prune() == 2
        site.clock.now_unix_s += 10 * 86_400.0
        assert await site.unit.prune() == 0
        site.clock.advance(120.0)
        assert await site.unit.prune() == 5

    asyncio.run(story())


def test_a_passage_that_is_restored_before_its_sender_is_answered_counts_once():
    async def story():
        class SlowAnswer(FakeStore):
            """Commits at once and answers late, as a store on another thread may."""

            async def append(self, entry):
                held = await super().append(entry)
                await answer.wait()
                return held

        answer = asyncio.Event()
        site = Site(store=SlowAnswer())
        task = asyncio.create_task(site.unit.ingest_passage(make_passage(SECTION)))
        await asyncio.sleep(0.01)
        assert await site.unit.restore() == 1
        answer.set()
        assert await task == Accepted()
        assert site.interval().passages_count == 1

    asyncio.run(story())


def test_a_large_window_comes_back_in_portions(monkeypatch):
    monkeypatch.setattr(restoring, "PORTION_COUNT", 4)

    async def story():
        site = Site()
        await site.ingest_many(11)
        again = site.restarted(limits=UnitLimits(recall_count=3))
        assert await again.unit.restore() == 11
        assert again.interval().passages_count == 11
        assert await again.unit.restore() == 0

    asyncio.run(story())


def test_a_start_that_has_no_more_time_restores_the_newest_and_goes_on_with_the_rest_later(monkeypatch):
    monkeypatch.setattr(restoring, "PORTION_COUNT", 4)

    async def story():
        site = Site()
        await site.ingest_many(11)
        again = site.restarted(limits=UnitLimits(recall_count=3))
        assert await again.unit.catch_up(within_s=0.0) == 4
        await again.ingest_many(1, first_seed=50)  # who comes meanwhile counts, too
        assert [await again.unit.catch_up(within_s=0.0) for _ in range(3)] == [4, 3, 0]
        assert again.interval().passages_count == 12

    asyncio.run(story())


def test_restoring_goes_on_where_the_store_failed(monkeypatch):
    monkeypatch.setattr(restoring, "PORTION_COUNT", 4)

    class FailsOnce(FakeStore):
        """Reads two portions, then fails once."""

        portions_count = 0

        async def load(self, *, since_unix_s, limit_count, before=None):
            self.portions_count += 1
            if self.portions_count == 3:
                raise StoreError("the disk is gone")
            return await super().load(since_unix_s=since_unix_s, limit_count=limit_count, before=before)

    async def story():
        site = Site()
        await site.ingest_many(15)
        store = FailsOnce()
        store.entries = site.store.entries
        # A memory that holds less than was restored before the failure cannot tell what counts already.
        again = Site(store=store, clock=site.clock, limits=UnitLimits(recall_count=3))
        with pytest.raises(StoreError):
            await again.unit.restore()
        await again.unit.restore()
        assert again.interval().passages_count == 15

    asyncio.run(story())


def test_of_more_than_can_be_restored_the_newest_are():
    async def story():
        site = Site()
        await site.ingest_many(9, mu=0.3)
        site.clock.now_unix_s += 60.0
        site.clock.now_monotonic_s += 60.0
        await site.ingest_many(5, mu=0.6, first_seed=100)
        again = site.restarted(limits=UnitLimits(restored_count=5))
        assert await again.unit.restore() == 5
        assert again.interval().median_mu == pytest.approx(0.6, abs=1e-6)

    asyncio.run(story())

from __future__ import annotations

import asyncio

from roadgrip.reasons import Reason
from roadgrip.records import Accepted, AdvisoryReason
from rsu_app.usecases import Subscription, UnitLimits
from tests.rsu_app.fakes import make_passage
from tests.rsu_app.usecases.site import OTHER, SECTION, Site, reason_of


def subscribed(site, section=SECTION) -> Subscription:
    subscription = site.unit.subscribe(section.section_id)
    assert isinstance(subscription, Subscription)
    return subscription


def count_in(notice):
    return 0 if notice.advisory.interval is None else notice.advisory.interval.passages_count


async def nothing_comes(subscription):
    try:
        await asyncio.wait_for(anext(subscription), 0.01)
    except TimeoutError:
        return True
    return False


def test_a_listener_gets_what_stands_and_then_every_change():
    async def story():
        site = Site()
        async with subscribed(site) as subscription:
            assert count_in(await anext(subscription)) == 0
            await site.ingest_many(1)
            assert count_in(await anext(subscription)) == 1
            assert await nothing_comes(subscription)
            assert await site.ingest_many(1, section=OTHER, first_seed=1) == [Accepted()]
            assert await nothing_comes(subscription)
            await site.ingest_many(1, first_seed=2)
            assert count_in(await anext(subscription)) == 2

    asyncio.run(story())


def test_a_slow_listener_gets_the_newest_and_nothing_queues_up():
    async def story():
        site = Site()
        async with subscribed(site) as subscription:
            await site.ingest_many(20)
            assert count_in(await anext(subscription)) == 20
            assert await nothing_comes(subscription)

    asyncio.run(story())


def test_a_listener_learns_that_silence_changed_the_advice():
    async def story():
        site = Site()
        await site.ingest_many(60, mu=0.9)
        async with subscribed(site) as subscription:
            assert (await anext(subscription)).advisory.reason is AdvisoryReason.FRICTION_INTERVAL
            site.unit.refresh()
            assert await nothing_comes(subscription)
            site.clock.advance(1801.0)
            site.unit.refresh()
            assert (await anext(subscription)).advisory.reason is AdvisoryReason.WINTER_SPEED_STALE_WINDOW

    asyncio.run(story())


def test_listeners_are_bounded_and_free_their_place():
    async def story():
        site = Site(limits=UnitLimits(subscribers_count=2))
        first = subscribed(site)
        subscribed(site)
        assert reason_of(site.unit.subscribe(SECTION.section_id)) is Reason.BUSY
        first.close()
        first.close()
        subscribed(site)
        assert reason_of(site.unit.subscribe(SECTION.section_id)) is Reason.BUSY

    asyncio.run(story())


def test_closing_ends_subscriptions_and_waits_for_passages_on_their_way():
    async def story():
        site = Site()
        subscription = subscribed(site)
        await anext(subscription)
        waiting = asyncio.create_task(anext(subscription, None))
        site.store.gate = asyncio.Event()
        passage = asyncio.create_task(site.unit.ingest_passage(make_passage(SECTION)))
        await asyncio.sleep(0.01)
        closing = asyncio.create_task(site.unit.close())
        await asyncio.sleep(0.01)
        assert not site.store.closed
        site.store.gate.set()
        await closing
        assert await passage == Accepted()
        assert site.store.closed
        assert await anext(subscription, None) is None
        await waiting

    asyncio.run(story())

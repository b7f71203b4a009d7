from __future__ import annotations

import asyncio

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.bundle import Envelope
from roadgrip.errors import StoreError, StoreFullError
from roadgrip.features import NEWEST_TABLE
from roadgrip.reasons import Reason
from roadgrip.records import Accepted, FrictionInterval, NotCounted, QualityFlag
from rsu_app.usecases import AcceptedAgain, UnitLimits
from tests.bundles import make_manifest
from tests.rsu_app.fakes import FakeModel, make_passage
from tests.rsu_app.usecases.site import MODEL, OTHER, SECTION, Site, flags_of, reason_of


def test_a_passage_is_stored_and_counted():
    site = Site()
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION, mu=0.45)))
    assert outcome == Accepted()
    assert site.interval().median_mu == pytest.approx(0.45, abs=1e-6)
    [entry] = site.store.entries
    assert entry.estimate.mu == pytest.approx(0.45, abs=1e-6)
    assert entry.estimate.bundle_id == site.model.manifest.bundle_id


def test_sections_do_not_mix():
    site = Site()
    asyncio.run(site.unit.ingest_passage(make_passage(OTHER, mu=0.45)))
    assert site.unit.current_interval(SECTION.section_id) is None
    assert site.interval(OTHER).passages_count == 1


def test_nothing_counts_before_the_commit():
    async def story():
        site = Site()
        site.store.gate = asyncio.Event()
        task = asyncio.create_task(site.unit.ingest_passage(make_passage(SECTION)))
        await asyncio.sleep(0.01)
        assert site.unit.current_interval(SECTION.section_id) is None
        assert not task.done()
        site.store.gate.set()
        assert await task == Accepted()
        assert site.interval().passages_count == 1

    asyncio.run(story())


def test_a_sender_that_hangs_up_does_not_lose_its_passage():
    async def story():
        site = Site()
        site.store.gate = asyncio.Event()
        passage = make_passage(SECTION)
        task = asyncio.create_task(site.unit.ingest_passage(passage))
        await asyncio.sleep(0.01)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        site.store.gate.set()
        await asyncio.sleep(0.01)
        assert site.interval().passages_count == 1
        assert await site.unit.ingest_passage(passage) == AcceptedAgain()
        assert site.interval().passages_count == 1
        assert len(site.store.entries) == 1

    asyncio.run(story())


@pytest.mark.parametrize("restart", [False, True])
def test_the_same_passage_again_changes_nothing_and_gets_the_same_answer(restart):
    async def story():
        site = Site()
        passage = make_passage(SECTION, seed=3)
        assert await site.unit.ingest_passage(passage) == Accepted()
        if restart:
            site = site.restarted()
            await site.unit.restore()
        site.clock.advance(60.0)
        again = make_passage(SECTION, seed=3, age_s=60.0)
        assert again.passage_id == passage.passage_id
        assert await site.unit.ingest_passage(again) == AcceptedAgain()
        assert site.interval().passages_count == 1
        assert len(site.store.entries) == 1

    asyncio.run(story())


def test_the_store_recognises_what_memory_has_forgotten():
    async def story():
        site = Site(limits=UnitLimits(recall_count=1))
        first = make_passage(SECTION, seed=1)
        assert await site.unit.ingest_passage(first) == Accepted()
        await site.ingest_many(3, first_seed=10)
        assert await site.unit.ingest_passage(first) == AcceptedAgain()
        copied = make_passage(SECTION, seed=1, passage_id=b"x" * 16)
        assert reason_of(await site.unit.ingest_passage(copied)) is Reason.REPLAYED
        assert site.interval().passages_count == 4

    asyncio.run(story())


def test_a_repetition_is_answered_as_before_even_if_it_would_be_refused_now():
    async def story():
        site = Site()
        passage = make_passage(SECTION, seed=3)
        await site.unit.ingest_passage(passage)
        too_old = make_passage(SECTION, seed=3, age_s=1e6)
        assert await site.unit.ingest_passage(too_old) == AcceptedAgain()
        site.store.error = StoreError("the disk is gone")
        assert await site.unit.ingest_passage(passage) == AcceptedAgain()

    asyncio.run(story())


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize(
    "changes", [{"seed": 2}, {"duration_s": 13.5}, {"quality": QualityFlag.NO_GNSS}], ids=lambda changes: str(*changes)
)
def test_an_id_used_for_another_passage_is_refused(restart, changes):
    async def story():
        site = Site()
        await site.unit.ingest_passage(make_passage(SECTION, seed=1, passage_id=b"a" * 16))
        if restart:
            site = site.restarted()
        other = make_passage(SECTION, **({"seed": 1, "passage_id": b"a" * 16} | changes))
        assert reason_of(await site.unit.ingest_passage(other)) is Reason.PASSAGE_ID_REUSED
        assert len(site.store.entries) == 1

    asyncio.run(story())


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("changes", [{}, {"duration_s": 13.5}])
def test_values_under_another_id_are_a_replay(restart, changes):
    async def story():
        site = Site()
        await site.unit.ingest_passage(make_passage(SECTION, seed=1))
        if restart:
            site = site.restarted()
        copied = make_passage(SECTION, seed=1, passage_id=b"b" * 16, **changes)
        assert reason_of(await site.unit.ingest_passage(copied)) is Reason.REPLAYED

    asyncio.run(story())


def test_duplicates_in_flight_count_once():
    async def story():
        site = Site()
        site.store.gate = asyncio.Event()
        passage = make_passage(SECTION)
        tasks = [asyncio.create_task(site.unit.ingest_passage(passage)) for _ in range(5)]
        await asyncio.sleep(0.01)
        site.store.gate.set()
        assert await asyncio.gather(*tasks) == [Accepted(), *[AcceptedAgain()] * 4]
        assert site.interval().passages_count == 1
        assert len(site.store.entries) == 1

    asyncio.run(story())


def test_a_passage_outside_the_envelope_is_stored_and_not_counted():
    width = len(NEWEST_TABLE)
    narrow = Envelope(lower=(0.0,) * width, upper=(0.0,) * width, outside_allowed_count=3)
    site = Site(model=FakeModel(make_manifest(envelope=narrow)))
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION)))
    assert flags_of(outcome) == NotCounted.OUT_OF_ENVELOPE
    assert site.unit.current_interval(SECTION.section_id) is None
    assert len(site.store.entries) == 1


@pytest.mark.parametrize(("mu", "stored_mu"), [(5.0, 5.0), (-0.2, -0.2), (float("nan"), None), (float("inf"), None)])
def test_an_impossible_estimate_is_stored_and_not_counted(mu, stored_mu):
    site = Site()
    site.model.answer_mu = mu
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION)))
    assert flags_of(outcome) == NotCounted.ESTIMATE_OUT_OF_RANGE
    assert site.store.entries[0].estimate.mu == stored_mu
    assert site.unit.current_interval(SECTION.section_id) is None


def test_a_passage_older_than_the_window_is_stored_and_not_counted():
    site = Site()
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION, age_s=3601.0)))
    assert flags_of(outcome) == NotCounted.OLDER_THAN_WINDOW
    assert len(site.store.entries) == 1
    assert site.unit.current_interval(SECTION.section_id) is None


def test_a_late_passage_counts_for_what_is_left_of_its_hour():
    site = Site()
    asyncio.run(site.unit.ingest_passage(make_passage(SECTION, age_s=3000.0)))
    assert site.interval().newest_age_s == pytest.approx(3000.0)
    site.clock.advance(600.0)
    assert site.interval().passages_count == 1
    site.clock.advance(1.0)
    assert site.unit.current_interval(SECTION.section_id) is None


def test_a_step_of_the_wall_clock_does_not_touch_the_window():
    site = Site()
    asyncio.run(site.unit.ingest_passage(make_passage(SECTION)))
    site.clock.now_unix_s += 7200.0
    assert site.interval().newest_age_s == 0.0


def test_an_unknown_section_is_refused_everywhere():
    site = Site()
    unit = site.unit
    passage = make_passage(SECTION, section_id="nowhere")
    answers = [
        asyncio.run(unit.ingest_passage(passage)),
        unit.current_interval("nowhere"),
        unit.current_advisory("nowhere"),
        unit.advisory_notice("nowhere"),
        unit.map_offer("nowhere"),
        unit.beacon("nowhere"),
        unit.subscribe("nowhere"),
    ]
    assert [reason_of(answer) for answer in answers] == [Reason.UNKNOWN_SECTION] * 7


def test_an_implausible_passage_is_neither_estimated_nor_stored():
    site = Site()
    site.model.error = AssertionError("the model was asked")
    passage = make_passage(SECTION, map_version="old")
    assert reason_of(asyncio.run(site.unit.ingest_passage(passage))) is Reason.STALE_MAP
    assert site.store.entries == []


@given(text=st.text(max_size=20) | st.just("\ud800"), values=st.lists(st.floats(), max_size=60).map(tuple))
def test_nothing_a_sender_writes_crashes_the_unit(text, values):
    site = Site(model=MODEL)
    passage = make_passage(SECTION, map_version=text, values=values, table_digest=text)
    assert reason_of(asyncio.run(site.unit.ingest_passage(passage))) is Reason.WRONG_FEATURE_TABLE
    nowhere = make_passage(SECTION, section_id=text, values=values)
    assert reason_of(asyncio.run(site.unit.ingest_passage(nowhere))) is Reason.UNKNOWN_SECTION


@pytest.mark.parametrize(
    ("error", "reason"),
    [(StoreFullError("2048 writes wait"), Reason.BUSY), (StoreError("disk I/O error"), Reason.STORE_UNAVAILABLE)],
)
def test_what_the_store_cannot_take_is_not_counted_and_may_come_again(error, reason):
    site = Site()
    site.store.error = error
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION)))
    assert reason_of(outcome) is reason
    assert reason.may_retry
    assert site.unit.current_interval(SECTION.section_id) is None
    site.store.error = None
    assert asyncio.run(site.unit.ingest_passage(make_passage(SECTION))) == Accepted()


@settings(max_examples=20)
@given(st.permutations(range(8)), st.lists(st.floats(0.0, 4000.0), min_size=8, max_size=8))
def test_the_interval_does_not_depend_on_the_order_of_arrival(order, ages_s):
    def median_mu(indices):
        site = Site(model=MODEL)
        for i in indices:
            passage = make_passage(SECTION, seed=i, mu=0.3 + 0.05 * i, age_s=ages_s[i])
            asyncio.run(site.unit.ingest_passage(passage))
        interval = site.unit.current_interval(SECTION.section_id)
        return interval.median_mu if isinstance(interval, FrictionInterval) else None

    expected = [0.3 + 0.05 * i for i in range(8) if ages_s[i] <= 3600.0]
    assert median_mu(order) == median_mu(range(8))
    assert median_mu(order) == (pytest.approx(float(np.median(expected)), abs=1e-6) if expected else None)

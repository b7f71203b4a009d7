from __future__ import annotations

import asyncio

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.bundle import Envelope
from roadgrip.errors import BundleError, ConfigurationError, StoreError, StoreFullError
from roadgrip.features import FEATURES, TABLE_DIGEST
from roadgrip.records import (
    Accepted,
    Advisory,
    AdvisoryNotice,
    AdvisoryReason,
    Beacon,
    FrictionInterval,
    MapOffer,
    NotCounted,
    QualityFlag,
    Reason,
    Rejected,
)
from roadgrip.units import kph_to_mps
from rsu_app.domain.advisory import AdvisoryPolicy
from rsu_app.usecases import RoadSideUnit, Subscription, UnitLimits
from tests.bundles import make_manifest
from tests.rsu_app.fakes import FakeClock, FakeModel, FakeStore, make_passage, make_section

SECTION = make_section()
OTHER = make_section("other", radius_m=-60.0)


class Site:
    """A unit on fakes, with the fakes at hand."""

    def __init__(self, *, model=None, store=None, clock=None, limits=None, without_model=False, **options):
        self.clock = clock or FakeClock()
        self.store = store or FakeStore()
        self.model: FakeModel = model or FakeModel()
        self.unit = RoadSideUnit(
            sections=[SECTION, OTHER],
            store=self.store,
            model=None if without_model else self.model,
            clock=self.clock,
            limits=limits or UnitLimits(),
            **options,
        )

    async def ingest_many(self, count, *, mu=0.5, section=SECTION, first_seed=0):
        passages = [make_passage(section, seed=first_seed + i, mu=mu) for i in range(count)]
        return [await self.unit.ingest_passage(passage) for passage in passages]

    def interval(self, section=SECTION) -> FrictionInterval:
        interval = self.unit.current_interval(section.section_id)
        assert isinstance(interval, FrictionInterval)
        return interval

    def advisory(self, section=SECTION) -> Advisory:
        advisory = self.unit.current_advisory(section.section_id)
        assert isinstance(advisory, Advisory)
        return advisory

    def restarted(self):
        return Site(store=self.store, clock=self.clock, model=self.model)


def flags_of(outcome):
    assert isinstance(outcome, Accepted)
    return outcome.flags


def reason_of(outcome):
    assert isinstance(outcome, Rejected)
    return outcome.reason


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
        assert await site.unit.ingest_passage(passage) == Accepted()
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
        assert await site.unit.ingest_passage(again) == Accepted()
        assert site.interval().passages_count == 1
        assert len(site.store.entries) == 1

    asyncio.run(story())


def test_the_store_recognises_what_memory_has_forgotten():
    async def story():
        site = Site(limits=UnitLimits(recall_count=1))
        first = make_passage(SECTION, seed=1)
        assert await site.unit.ingest_passage(first) == Accepted()
        await site.ingest_many(3, first_seed=10)
        assert await site.unit.ingest_passage(first) == Accepted()
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
        assert await site.unit.ingest_passage(too_old) == Accepted()
        site.store.error = StoreError("the disk is gone")
        assert await site.unit.ingest_passage(passage) == Accepted()

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
        assert await asyncio.gather(*tasks) == [Accepted()] * 5
        assert site.interval().passages_count == 1
        assert len(site.store.entries) == 1

    asyncio.run(story())


def test_a_passage_outside_the_envelope_is_stored_and_not_counted():
    width = len(FEATURES)
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


MODEL = FakeModel()


def test_without_a_model_passages_are_refused_and_winter_speed_is_advised():
    site = Site(without_model=True)
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION)))
    assert reason_of(outcome) is Reason.NO_MODEL
    assert reason_of(outcome).may_retry
    assert site.advisory().reason is AdvisoryReason.WINTER_SPEED_NO_MODEL


def test_a_model_that_fails_refuses_the_passage_and_nothing_else():
    site = Site()
    site.model.error = BundleError("the session broke")
    assert reason_of(asyncio.run(site.unit.ingest_passage(make_passage(SECTION)))) is Reason.NO_MODEL
    site.model.error = None
    assert asyncio.run(site.unit.ingest_passage(make_passage(SECTION))) == Accepted()


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


def test_fifty_vehicles_turn_winter_speed_into_advice():
    site = Site(policy=AdvisoryPolicy(winter_speed_mps=kph_to_mps(60.0)))
    reasons = []
    for count in (9, 1, 40):
        asyncio.run(site.ingest_many(count, mu=0.9, first_seed=len(site.store.entries)))
        reasons.append(site.advisory().reason)
    assert reasons == [
        AdvisoryReason.WINTER_SPEED_FEW_VEHICLES,
        AdvisoryReason.WINTER_SPEED_WHILE_PROVISIONAL,
        AdvisoryReason.FRICTION_INTERVAL,
    ]


def test_a_road_that_turns_icy_lowers_the_advice_and_silence_ends_it():
    site = Site(policy=AdvisoryPolicy(winter_speed_mps=kph_to_mps(60.0)))
    asyncio.run(site.ingest_many(60, mu=0.6))
    dry_mps = site.advisory().speed_mps
    asyncio.run(site.ingest_many(80, mu=0.2, first_seed=100))
    assert site.advisory().speed_mps < dry_mps
    site.clock.advance(1800.0)
    assert site.advisory().reason is AdvisoryReason.WINTER_SPEED_STALE_WINDOW
    site.clock.advance(1801.0)
    assert site.advisory().reason is AdvisoryReason.WINTER_SPEED_FEW_VEHICLES


def test_a_section_may_have_a_policy_of_its_own():
    site = Site(section_policies={OTHER.section_id: AdvisoryPolicy(winter_speed_mps=kph_to_mps(30.0))})
    assert site.advisory(OTHER).speed_mps == pytest.approx(kph_to_mps(30.0))
    assert site.advisory(SECTION).speed_mps == pytest.approx(kph_to_mps(60.0))


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
        await again.unit.prune()
        assert again.interval().passages_count == 13
        await again.unit.prune()
        assert again.interval().passages_count == 13

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


def test_switching_the_model_changes_the_bundle_behind_new_estimates_and_is_written_down():
    async def story():
        site = Site()
        await site.ingest_many(2)
        candidate = FakeModel(make_manifest(name="newer", weights={"sideslip_mean_rad": 1.0, "steer_mean_rad": 1e-9}))
        await site.unit.switch_model(candidate)
        await site.ingest_many(1, first_seed=10)
        assert site.unit.model_manifest == candidate.manifest
        assert site.store.entries[-1].estimate.bundle_id == candidate.manifest.bundle_id
        assert site.interval().passages_count == 3
        assert [(event.kind, event.subject) for event in site.store.ledger] == [
            ("model_live", candidate.manifest.bundle_id)
        ]

    asyncio.run(story())


def test_a_candidate_that_misses_its_golden_vectors_leaves_the_incumbent_alone():
    site = Site()
    candidate = FakeModel()
    candidate.answer_mu = 0.3
    with pytest.raises(BundleError, match="golden"):
        asyncio.run(site.unit.switch_model(candidate))
    assert asyncio.run(site.unit.ingest_passage(make_passage(SECTION))) == Accepted()
    assert asyncio.run(site.unit.readiness()).ready


def test_a_ledger_that_cannot_be_written_does_not_stop_a_model():
    site = Site(without_model=True)
    site.store.error = StoreFullError("the disk is full")
    asyncio.run(site.unit.switch_model(FakeModel()))
    assert site.unit.model_manifest is not None


def checks(site):
    readiness = asyncio.run(site.unit.readiness())
    return readiness.ready, {check.name: check.ok for check in readiness.checks}, readiness


def test_a_unit_in_order_is_ready_and_its_empty_window_is_only_information():
    ready, by_name, _ = checks(Site())
    assert ready
    assert by_name == {"model": True, "store": True, "clock": True, "window": False}


def test_a_unit_without_a_model_is_never_ready():
    ready, by_name, _ = checks(Site(without_model=True))
    assert not ready
    assert not by_name["model"]


def test_a_model_that_answers_differently_today_makes_the_unit_unready():
    site = Site()
    site.model.answer_mu = 0.42
    ready, by_name, readiness = checks(site)
    assert not ready
    assert not by_name["model"]
    assert "golden" in readiness.checks[0].detail


def test_a_store_that_cannot_write_makes_the_unit_unready_and_says_why():
    site = Site()
    site.store.error = StoreFullError("the disk is full")
    ready, by_name, readiness = checks(site)
    assert not ready
    assert not by_name["store"]
    assert "full" in readiness.checks[1].detail


def test_a_clock_in_1970_is_said_and_does_not_stop_the_work():
    site = Site(clock=FakeClock(unix_s=100.0))
    assert asyncio.run(site.unit.ingest_passage(make_passage(SECTION))) == Accepted()
    ready, by_name, _ = checks(site)
    assert not ready
    assert not by_name["clock"]
    notice = site.unit.advisory_notice(SECTION.section_id)
    assert isinstance(notice, AdvisoryNotice)
    assert notice.issued_unix_s == 0


def test_a_clock_that_was_set_is_trusted_again_after_a_minute():
    site = Site()
    site.clock.now_unix_s -= 4000.0
    assert not checks(site)[0]
    site.clock.advance(61.0)
    assert checks(site)[0]


def test_a_fresh_window_is_said():
    site = Site()
    asyncio.run(site.ingest_many(1))
    asyncio.run(site.ingest_many(1, section=OTHER, first_seed=1))
    assert all(check.ok for check in asyncio.run(site.unit.readiness()).checks)


def test_the_map_comes_with_the_table_that_is_served():
    assert Site().unit.map_offer(SECTION.section_id) == MapOffer(section=SECTION, table_digests=(TABLE_DIGEST,))


def test_beacon_and_notice_say_what_the_advisory_says():
    site = Site()
    asyncio.run(site.ingest_many(55, mu=0.5))
    advisory = site.advisory()
    notice, beacon = site.unit.advisory_notice(SECTION.section_id), site.unit.beacon(SECTION.section_id)
    assert notice == AdvisoryNotice(SECTION.section_id, SECTION.version, advisory, int(site.clock.now_unix_s))
    assert beacon == Beacon(
        section_id=SECTION.section_id,
        map_version=SECTION.version,
        speed_mps=advisory.speed_mps,
        reason=advisory.reason,
        confidence=advisory.confidence,
        valid_for_s=advisory.valid_for_s,
    )


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


@pytest.mark.parametrize(
    "options",
    [
        {"sections": []},
        {"sections": [SECTION, SECTION]},
        {"section_policies": {"nowhere": AdvisoryPolicy()}},
    ],
)
def test_a_unit_that_contradicts_itself_is_not_built(options):
    with pytest.raises(ConfigurationError):
        RoadSideUnit(**({"sections": [SECTION], "store": FakeStore(), "model": None, "clock": FakeClock()} | options))


@pytest.mark.parametrize("limits", [{"recall_count": 0}, {"window_s": 0.0}, {"retention_s": 60.0}])
def test_limits_that_cannot_be_kept_are_refused(limits):
    with pytest.raises(ConfigurationError):
        UnitLimits(**limits)


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

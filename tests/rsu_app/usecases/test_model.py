from __future__ import annotations

import asyncio

import pytest

from roadgrip.errors import BundleError, StoreFullError
from roadgrip.ledger import Action
from roadgrip.reasons import Reason
from roadgrip.records import Accepted, AdvisoryReason
from tests.bundles import make_manifest
from tests.rsu_app.fakes import FakeModel, make_passage
from tests.rsu_app.usecases.site import SECTION, Site, reason_of


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


def test_switching_the_model_changes_the_bundle_behind_new_estimates_and_is_written_down():
    async def story():
        site = Site()
        await site.ingest_many(2)
        candidate = FakeModel(make_manifest(name="newer", weights={"sideslip_mean_rad": 1.0, "steer_mean_rad": 1e-9}))
        site.unit.switch_model(candidate)
        await site.ingest_many(1, first_seed=10)
        assert site.unit.model_manifest == candidate.manifest
        assert site.store.entries[-1].estimate.bundle_id == candidate.manifest.bundle_id
        assert site.interval().passages_count == 3
        await site.unit.catch_up()
        newest = site.store.ledger_entries[-1]
        assert (newest.actor, newest.action) == ("unit", Action.LIVE)
        assert (newest.subject, newest.reason) == (candidate.manifest.bundle_id, "newer")

    asyncio.run(story())


def test_a_candidate_that_misses_its_golden_vectors_leaves_the_incumbent_alone():
    site = Site()
    candidate = FakeModel()
    candidate.answer_mu = 0.3
    with pytest.raises(BundleError, match="golden"):
        site.unit.switch_model(candidate)
    assert asyncio.run(site.unit.ingest_passage(make_passage(SECTION))) == Accepted()
    assert asyncio.run(site.unit.readiness()).ready


def test_a_ledger_that_cannot_be_written_does_not_stop_a_model():
    site = Site(without_model=True)
    site.store.error = StoreFullError("the disk is full")
    site.unit.switch_model(FakeModel())
    asyncio.run(site.unit.catch_up())
    assert site.unit.model_manifest is not None


def told_live(site):
    return [entry.subject for entry in site.store.ledger_entries if entry.action is Action.LIVE]


def test_a_unit_that_restarts_often_says_once_which_model_is_live():
    async def story():
        site = Site()
        for _ in range(5):
            site = site.restarted()
            await site.unit.catch_up()
        assert told_live(site) == [site.model.manifest.bundle_id]

    asyncio.run(story())


def test_a_ledger_that_was_begun_anew_after_damage_is_told_which_model_is_live():
    async def story():
        site = Site()
        await site.unit.catch_up()
        del site.store.ledger_entries[1:]
        site.store.notes = ("the database was damaged; a fresh one was begun",)
        for _ in range(3):
            await site.unit.catch_up()
        assert told_live(site) == [site.model.manifest.bundle_id]

    asyncio.run(story())


@pytest.mark.parametrize("action", [Action.SWITCHED, Action.ROLLED_BACK])
def test_a_model_whose_going_live_was_recorded_as_a_step_is_not_told_again(action):
    async def story():
        site = Site()
        live_id = site.model.manifest.bundle_id
        await site.store.record(at_unix_s=0.0, actor="anna", action=Action.LIVE, subject="another", reason="")
        await site.store.record(at_unix_s=0.0, actor="anna", action=action, subject=live_id, reason="")
        await site.store.record(at_unix_s=0.0, actor="unit", action=Action.INSTALLED, subject="a third", reason="")
        await site.unit.catch_up()
        assert told_live(site) == ["another"]

    asyncio.run(story())


def test_a_model_that_is_gone_is_told_with_its_reason_and_told_again_when_it_is_back():
    async def story():
        site = Site()
        live_id = site.model.manifest.bundle_id
        await site.unit.catch_up()
        without = Site(store=site.store, without_model=True)
        await without.unit.catch_up()
        assert "no model" in site.store.ledger_entries[-1].reason
        await site.restarted().unit.catch_up()
        assert told_live(site) == [live_id, "", live_id]

    asyncio.run(story())

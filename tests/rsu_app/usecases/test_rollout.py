from __future__ import annotations

import asyncio
import threading
from dataclasses import replace

import pytest

from roadgrip.errors import BundleError, StoreError
from roadgrip.ledger import Action
from roadgrip.records import Accepted
from roadgrip.release import Release
from rsu_app.domain.rollout import FACTORY, Stage
from rsu_app.rollout_ports import UpdateReason, UpdateRefusal
from rsu_app.usecases.rollout import PROBE_PERIOD_S, Rollout
from tests.rsu_app.fakes import release_of
from tests.rsu_app.usecases.depot import GOOD, GOOD_ID, OTHER, OTHER_ID, POLICY, BiasedModel, Depot, SlowSource


def test_a_release_is_shadowed_then_live_then_settled_and_no_passage_is_lost():
    async def story():
        depot = Depot()
        factory_id = depot.live_id
        release = depot.release(1, GOOD)
        assert await depot.rollout.look() == release
        assert (depot.stage, depot.live_id) == (Stage.SHADOW, factory_id)
        outcomes = await depot.drive(POLICY.shadow_count)
        assert (depot.stage, depot.live_id) == (Stage.PROBATION, GOOD_ID)
        outcomes += await depot.drive(POLICY.probation_count)
        assert (depot.stage, depot.live_id) == (Stage.SETTLED, GOOD_ID)
        assert outcomes == [Accepted()] * len(outcomes)
        assert depot.told == [
            (Action.INSTALLED, GOOD_ID),
            (Action.SHADOWING, GOOD_ID),
            (Action.SWITCHED, GOOD_ID),
            (Action.CONFIRMED, GOOD_ID),
        ]

    asyncio.run(story())


def test_both_estimates_are_stored_while_two_bundles_are_asked():
    async def story():
        depot = Depot()
        depot.release(1, BiasedModel(1e-3, factor=1.05))
        await depot.drive(1)
        await depot.rollout.look()
        await depot.drive(POLICY.shadow_count + POLICY.probation_count + 1)
        estimates = [entry.estimate for entry in depot.site.store.entries]
        candidate_id, factory_id = depot.live_id, estimates[0].bundle_id
        asked = [(e.bundle_id, e.shadow_bundle_id) for e in estimates]
        assert asked == [
            (factory_id, None),
            *[(factory_id, candidate_id)] * POLICY.shadow_count,
            *[(candidate_id, factory_id)] * POLICY.probation_count,
            (candidate_id, None),
        ]
        shadowed = [(e.mu, e.shadow_mu) for e in estimates[1 : 1 + POLICY.shadow_count]]
        assert all(mu and beside == pytest.approx(1.05 * mu) for mu, beside in shadowed)

    asyncio.run(story())


def test_a_candidate_that_says_something_quite_different_never_becomes_live():
    async def story():
        depot = Depot()
        factory_id = depot.live_id
        bad = BiasedModel(3e-3, factor=1.5)
        depot.release(1, bad)
        await depot.rollout.look()
        await depot.drive(POLICY.judged_from_count)
        assert (depot.stage, depot.live_id) == (Stage.SETTLED, factory_id)
        assert depot.told[-1] == (Action.REJECTED, bad.manifest.bundle_id)
        assert await depot.rollout.look() is None

    asyncio.run(story())


def test_a_full_disk_keeps_no_failed_candidate_in_the_shadow():
    async def story():
        depot = Depot()
        depot.release(1, BiasedModel(3e-3, factor=1.5))
        await depot.rollout.look()
        depot.shelf.error = StoreError("the disk is full")
        await depot.drive(POLICY.judged_from_count)
        assert depot.stage is Stage.SETTLED
        assert "could not be written down" in depot.site.store.ledger_entries[-1].reason

    asyncio.run(story())


def test_a_candidate_that_fails_to_answer_costs_no_passage():
    async def story():
        depot = Depot()
        depot.release(1, GOOD)
        await depot.rollout.look()
        failing = BiasedModel(1e-3)
        depot.site.unit.begin_shadow(failing, newer=True)
        failing.error = BundleError("the session broke")
        assert await depot.drive(1) == [Accepted()]
        assert depot.told[-1] == (Action.REJECTED, GOOD_ID)

    asyncio.run(story())


def test_a_bundle_that_goes_wrong_on_probation_is_rolled_back_by_itself():
    async def story():
        depot = Depot()
        factory_id, bad = depot.live_id, BiasedModel(3e-3)
        depot.release(1, bad)
        await depot.rollout.look()
        await depot.drive(POLICY.shadow_count)
        assert depot.live_id == bad.manifest.bundle_id
        bad.factor = 1.5  # the road turns icy, and it does not know ice
        outcomes = await depot.drive(POLICY.judged_from_count)
        assert depot.live_id == factory_id
        assert outcomes == [Accepted()] * len(outcomes)
        entry = depot.site.store.ledger_entries[-1]
        assert (entry.action, entry.subject) == (Action.ROLLED_BACK, factory_id)
        assert entry.evidence["failed_bundle_id"] == bad.manifest.bundle_id
        assert depot.shelf.kept.live == FACTORY

    asyncio.run(story())


def test_a_slow_line_keeps_no_misleading_model_in_its_place():
    async def story():
        depot = Depot()
        factory_id, bad = depot.live_id, BiasedModel(3e-3)
        depot.release(1, bad)
        await depot.rollout.look()
        await depot.drive(POLICY.shadow_count)
        arrived = threading.Event()
        looking = asyncio.create_task(depot.rollout.update_from(SlowSource(arrived), actor="ann"))
        bad.factor = 1.5
        await depot.drive(POLICY.judged_from_count)
        assert depot.live_id == factory_id
        assert not looking.done()
        arrived.set()
        assert await looking is None

    asyncio.run(story())


def test_a_live_model_that_fails_its_probe_is_rolled_back_even_when_settled():
    async def story():
        depot = Depot()
        factory_id, good = depot.live_id, BiasedModel(1e-3)
        await depot.settle(1, good)
        good.error = BundleError("memory went bad")
        depot.site.clock.advance(PROBE_PERIOD_S + 1.0)
        await depot.rollout.watch()
        assert depot.live_id == factory_id
        assert "fails its probe" in depot.site.store.ledger_entries[-1].reason

    asyncio.run(story())


def test_an_operator_steps_back_at_once_and_the_release_does_not_come_again():
    async def story():
        depot = Depot()
        factory_id = depot.live_id
        await depot.settle(1, GOOD)
        assert await depot.rollout.roll_back("drivers complain", actor="ann") is None
        assert depot.live_id == factory_id
        entry = depot.site.store.ledger_entries[-1]
        assert (entry.actor, entry.reason) == ("ann", "drivers complain")
        assert await depot.rollout.look() is None

    asyncio.run(story())


def test_an_operator_takes_a_candidate_off_before_it_was_ever_live():
    async def story():
        depot = Depot()
        depot.release(1, GOOD)
        await depot.rollout.look()
        assert await depot.rollout.roll_back("not today", actor="ann") is None
        assert (depot.stage, depot.rollout.status.state.candidate) == (Stage.SETTLED, None)

    asyncio.run(story())


def test_without_a_bundle_before_there_is_nothing_to_go_back_to():
    async def story():
        refusal = await Depot().rollout.roll_back("why not", actor="ann")
        assert refusal is not None
        assert refusal.reason is UpdateReason.NO_RELEASE

    asyncio.run(story())


def test_an_operator_need_not_wait_for_the_shadow_to_end():
    async def story():
        depot = Depot()
        depot.release(1, GOOD)
        await depot.rollout.look()
        assert await depot.rollout.switch_now("a quiet road", actor="ann") is None
        assert (depot.stage, depot.live_id) == (Stage.PROBATION, GOOD_ID)

    asyncio.run(story())


def test_a_refused_release_leaves_everything_as_it_was_and_is_told_once():
    async def story():
        depot = Depot()
        factory_id = depot.live_id
        depot.source.refusal = UpdateRefusal(UpdateReason.EXPIRED, "the timestamp expired")
        for _ in range(3):
            assert await depot.rollout.look() == depot.source.refusal
        assert (depot.stage, depot.live_id) == (Stage.SETTLED, factory_id)
        assert len(depot.refusals) == 3
        assert [action for action, _ in depot.told] == [Action.REFUSED]
        assert await depot.drive(1) == [Accepted()]

    asyncio.run(story())


def test_a_bundle_that_this_machine_cannot_run_is_refused():
    async def story():
        depot = Depot()
        depot.source.release = release_of(1, "f" * 16)
        refusal = await depot.rollout.look()
        assert isinstance(refusal, UpdateRefusal)
        assert refusal.reason is UpdateReason.UNUSABLE_BUNDLE
        assert depot.shelf.states == []

    asyncio.run(story())


def test_a_full_disk_refuses_a_release_and_stops_no_step_back():
    async def story():
        depot = Depot()
        factory_id = depot.live_id
        await depot.settle(1, GOOD)
        depot.shelf.error = StoreError("the disk is full")
        depot.release(2, OTHER)
        refusal = await depot.rollout.look()
        assert isinstance(refusal, UpdateRefusal)
        assert refusal.reason is UpdateReason.NO_ROOM
        assert await depot.rollout.roll_back("it misleads", actor="ann") is None
        assert depot.live_id == factory_id

    asyncio.run(story())


def test_a_full_disk_puts_the_switch_off_and_the_candidate_stays():
    async def story():
        depot = Depot()
        factory_id = depot.live_id
        depot.release(1, GOOD)
        await depot.rollout.look()
        depot.shelf.error = StoreError("the disk is full")
        await depot.drive(POLICY.shadow_count)
        assert (depot.stage, depot.live_id) == (Stage.SHADOW, factory_id)
        depot.shelf.error = None
        await depot.drive(1)
        assert depot.live_id == GOOD_ID

    asyncio.run(story())


@pytest.mark.parametrize("passages_count", [0, POLICY.shadow_count])
def test_a_restart_goes_on_where_the_unit_stood(passages_count):
    async def story():
        depot = Depot()
        depot.release(1, GOOD)
        await depot.rollout.look()
        await depot.drive(passages_count)
        before = depot.stage
        again = depot.restarted()
        await again.rollout.resume()
        assert (again.stage, again.live_id) == (before, depot.live_id)
        assert again.site.unit.shadow is not None
        await again.drive(POLICY.shadow_count + POLICY.probation_count)
        assert (again.stage, again.live_id) == (Stage.SETTLED, GOOD_ID)

    asyncio.run(story())


def test_restarts_do_not_make_the_shadow_longer_than_it_shall_be():
    async def story():
        depot = Depot(policy=replace(POLICY, shadow_count=10))
        depot.release(1, GOOD)
        await depot.rollout.look()
        await depot.drive(6)
        again = Depot(shelf=depot.shelf, site=depot.site, models=depot.models, policy=replace(POLICY, shadow_count=10))
        again.seed = 500
        await again.rollout.resume()
        await again.drive(POLICY.judged_from_count)
        assert again.stage is Stage.SHADOW
        await again.drive(1)
        assert again.live_id == GOOD_ID

    asyncio.run(story())


def test_after_a_restart_limits_are_judged_by_fresh_passages():
    async def story():
        depot = Depot()
        depot.release(1, GOOD)
        await depot.rollout.look()
        await depot.drive(POLICY.shadow_count - 1)
        again = depot.restarted()
        await again.rollout.resume()
        await again.drive(POLICY.judged_from_count - 1)
        assert again.live_id != GOOD_ID
        await again.drive(1)
        assert again.live_id == GOOD_ID

    asyncio.run(story())


def test_a_live_bundle_that_was_damaged_on_the_disk_gives_way_to_the_one_before():
    async def story():
        depot = Depot()
        await depot.settle(1, GOOD)
        await depot.settle(2, OTHER)
        depot.shelf.damaged_ids = {OTHER_ID}
        again = depot.restarted()
        await again.rollout.resume()
        assert again.live_id == GOOD_ID
        assert again.shelf.kept.live.bundle_id == GOOD_ID
        entry = again.site.store.ledger_entries[-1]
        assert entry.action is Action.ROLLED_BACK
        assert "differs from its digest" in entry.reason

    asyncio.run(story())


def test_when_every_bundle_on_the_shelf_is_damaged_the_factory_s_answers():
    async def story():
        depot = Depot()
        factory_id = depot.live_id
        await depot.settle(1, GOOD)
        await depot.settle(2, OTHER)
        depot.shelf.damaged_ids = {GOOD_ID, OTHER_ID}
        again = depot.restarted()
        await again.rollout.resume()
        assert again.live_id == factory_id
        assert again.shelf.kept.newest_sequence_number == 2

    asyncio.run(story())


def test_a_shelf_whose_state_was_damaged_begins_with_the_factory_s_and_the_ledger_says_so():
    async def story():
        depot = Depot()
        factory_id = depot.live_id
        await depot.settle(1, GOOD)
        depot.shelf.damaged = True
        again = depot.restarted()
        await again.rollout.resume()
        assert again.live_id == factory_id
        assert "damaged" in again.site.store.ledger_entries[-1].reason

    asyncio.run(story())


def test_a_disk_that_cannot_be_written_is_no_reason_not_to_start():
    async def story():
        depot = Depot()
        factory_id = depot.live_id
        await depot.settle(1, GOOD)
        depot.shelf.damaged_ids = {GOOD_ID}
        depot.shelf.error = StoreError("read-only")
        again = depot.restarted()
        await again.rollout.resume()
        assert again.live_id == factory_id
        assert await again.drive(1) == [Accepted()]

    asyncio.run(story())


def test_a_unit_that_never_had_a_usable_bundle_does_not_say_so_at_every_start():
    async def story():
        depot = Depot(factory=False)
        before = len(depot.site.store.ledger_entries)
        await depot.rollout.resume()
        assert len(depot.site.store.ledger_entries) == before

    asyncio.run(story())


def test_a_candidate_that_was_damaged_on_the_disk_is_taken_off():
    async def story():
        depot = Depot()
        depot.release(1, GOOD)
        await depot.rollout.look()
        depot.shelf.damaged_ids = {GOOD_ID}
        again = depot.restarted()
        await again.rollout.resume()
        assert again.stage is Stage.SETTLED
        assert again.told[-1][0] is Action.REJECTED

    asyncio.run(story())


def test_a_unit_without_any_model_takes_the_first_release_at_once():
    async def story():
        depot = Depot(factory=False)
        assert depot.site.unit.model_manifest is None
        depot.release(1, GOOD)
        assert isinstance(await depot.rollout.look(), Release)
        assert (depot.stage, depot.live_id) == (Stage.SETTLED, GOOD_ID)
        assert await depot.drive(1) == [Accepted()]

    asyncio.run(story())


def test_a_newer_release_of_the_live_bundle_starts_no_shadow():
    async def story():
        depot = Depot()
        await depot.settle(1, GOOD)
        depot.release(2, GOOD)
        assert isinstance(await depot.rollout.look(), Release)
        assert depot.site.unit.shadow is None
        assert depot.rollout.status.state.newest_sequence_number == 2

    asyncio.run(story())


def test_a_ledger_that_cannot_be_written_stops_no_rollout():
    async def story():
        depot = Depot()
        depot.release(1, GOOD)
        depot.site.store.error = StoreError("the disk is full")
        assert isinstance(await depot.rollout.look(), Release)
        assert depot.stage is Stage.SHADOW
        assert {refusal.reason for refusal in depot.refusals} == {UpdateReason.NO_ROOM}

    asyncio.run(story())


def test_without_a_source_an_order_to_look_says_what_is_missing():
    async def story():
        depot = Depot()
        rollout = Rollout(
            unit=depot.site.unit,
            store=depot.site.store,
            shelf=depot.shelf,
            loading=depot.loading,
            source=None,
            ring="all",
            policy=POLICY,
            clock=depot.site.clock,
            started=depot.started,
        )
        refusal = await rollout.look()
        assert isinstance(refusal, UpdateRefusal)
        assert refusal.reason is UpdateReason.NOT_CONFIGURED

    asyncio.run(story())

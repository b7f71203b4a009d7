"""What stands beside the published interval, and the interval of a window that is cut where friction changed."""

from __future__ import annotations

import asyncio
import tracemalloc
from dataclasses import replace
from math import inf

import numpy as np
import pytest

from roadgrip.features import NEWEST_TABLE, PROFILE_FLOOR, PROFILE_FRICTIONS_MU
from roadgrip.reasons import Reason
from roadgrip.records import AdvisoryReason, Confidence, NotCounted
from roadgrip.units import kph_to_mps
from rsu_app.domain.advisory import STEP_KPH, AdvisoryPolicy, curve_speed_mps
from rsu_app.domain.change import ChangePolicy
from rsu_app.usecases import FrictionPolicies, SectionFriction, UnitLimits
from rsu_app.usecases.section_friction import NEWEST_COUNT
from tests.rsu_app.fakes import FakeClock, FakeStore, WaveringModel, make_passage
from tests.rsu_app.usecases.site import SECTION, Site, flags_of, reason_of

GRIP_PROFILE_PLACES = [place for place, name in enumerate(NEWEST_TABLE.names) if name.startswith("grip_profile_")]
WATCHED = FrictionPolicies(change=ChangePolicy())


def friction_of(site) -> SectionFriction:
    friction = site.unit.current_friction(SECTION.section_id)
    assert isinstance(friction, SectionFriction)
    return friction


async def traffic(site, *, mu_new, count, every_s=60.0, first_seed):
    """Vehicles of unknown wear, one after the other."""
    rng = np.random.default_rng(first_seed)
    for i in range(count):
        site.clock.advance(every_s)
        mu = mu_new * rng.uniform(0.8, 1.0)
        await site.unit.ingest_passage(make_passage(SECTION, seed=first_seed + i, mu=mu))


def test_without_vehicles_there_is_no_friction():
    assert Site().unit.current_friction(SECTION.section_id) is None


def test_friction_of_a_section_that_is_not_served_is_refused():
    assert reason_of(Site().unit.current_friction("nowhere")) is Reason.UNKNOWN_SECTION


def test_the_refined_interval_stands_near_the_published_one():
    site = Site()
    asyncio.run(traffic(site, mu_new=0.5, count=40, first_seed=100))
    friction = friction_of(site)
    assert friction.interval == site.interval()
    assert friction.refined.mu_new == pytest.approx(friction.interval.mu_new, rel=0.021)
    assert friction.refined.informative_count == 40
    assert not friction.at_least
    assert friction.since_change_s is None


def test_where_hardly_anybody_names_a_friction_the_interval_is_marked():
    model = WaveringModel()
    site = Site(model=model)

    async def story():
        await traffic(site, mu_new=0.5, count=3, first_seed=100)
        model.wavers = True
        await traffic(site, mu_new=0.5, count=12, first_seed=200)

    asyncio.run(story())
    friction = friction_of(site)
    assert friction.at_least
    assert friction.refined.half_width_mu == inf
    assert (friction.refined.informative_count, friction.refined.censored_count) == (3, 12)
    assert friction.interval.passages_count == 15


@pytest.mark.parametrize("change_policy", [None, ChangePolicy()])
def test_a_drop_is_published_at_once_only_where_that_is_wanted(change_policy):
    site = Site(friction_policies=FrictionPolicies(change=change_policy))

    async def story():
        await traffic(site, mu_new=0.6, count=50, first_seed=100)
        await traffic(site, mu_new=0.2, count=12, first_seed=200)

    asyncio.run(story())
    friction = friction_of(site)
    assert friction.interval == site.interval()
    if change_policy is None:
        assert friction.interval.mu_new > 0.5
        assert friction.since_change_s is None
    else:
        assert friction.interval.mu_new == pytest.approx(0.2, rel=0.1)
        assert friction.refined.mu_new == pytest.approx(0.2, rel=0.1)
        assert friction.interval.passages_count == 12
        assert friction.since_change_s == pytest.approx(11 * 60.0)
        assert friction.interval.confidence is Confidence.PROVISIONAL


def test_few_vehicles_an_hour_still_tell_of_a_change_and_ten_stay():
    site = Site(friction_policies=WATCHED)

    async def story():
        await traffic(site, mu_new=0.6, count=30, every_s=240.0, first_seed=100)
        await traffic(site, mu_new=0.2, count=8, every_s=240.0, first_seed=200)

    asyncio.run(story())
    assert site.interval().passages_count == 10
    assert site.interval().mu_new < 0.3


def test_a_restart_keeps_the_change_though_the_window_alone_does_not_show_it():
    site = Site(friction_policies=WATCHED)

    async def story():
        await traffic(site, mu_new=0.6, count=40, every_s=120.0, first_seed=100)
        await traffic(site, mu_new=0.2, count=20, every_s=120.0, first_seed=200)
        clock = FakeClock(monotonic_s=5.0, unix_s=site.clock.now_unix_s)
        again = Site(store=site.store, clock=clock, friction_policies=WATCHED)
        # What is counted again are those of the window.
        assert await again.unit.restore() == 31
        return again

    again = asyncio.run(story())
    assert again.interval() == replace(site.interval(), newest_age_s=again.interval().newest_age_s)
    assert again.interval().passages_count == 20


def test_vehicles_that_only_know_a_bound_are_no_change():
    model = WaveringModel()
    site = Site(model=model, friction_policies=WATCHED)

    async def story():
        await traffic(site, mu_new=0.6, count=40, first_seed=100)
        model.wavers = True
        await traffic(site, mu_new=0.2, count=12, first_seed=200)

    asyncio.run(story())
    assert friction_of(site).since_change_s is None
    assert site.interval().passages_count == 52


def crowded(count, *, change_policy=None):
    """A unit whose window holds many vehicles of the same minute."""
    site = Site(
        friction_policies=FrictionPolicies(change=change_policy), limits=UnitLimits(window_capacity_count=20_000)
    )
    state = site.state()  # a store of this size would take its time
    rng = np.random.default_rng(1)
    now_s = site.clock.monotonic_s()
    for at_s, mu in zip(np.linspace(now_s - 3000.0, now_s, count), rng.uniform(0.4, 0.5, count), strict=True):
        state.window.add(left_at_s=float(at_s), mu=float(mu), expected_error_ratio=0.05)
        if state.watch is not None:
            state.watch.add(left_at_s=float(at_s), mu=float(mu))
    return site, state


def peak_bytes(question):
    """Return the most memory that answering takes at a time; unlike time, the same at each attempt."""
    tracemalloc.start()
    try:
        question()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("change_policy", [None, ChangePolicy()])
def test_the_cost_of_a_question_does_not_grow_with_a_window_beyond_the_newest_thousand(change_policy):
    costs = []
    for count in (NEWEST_COUNT, 10 * NEWEST_COUNT):
        site, state = crowded(count, change_policy=change_policy)
        friction_of(site)  # tables are made once
        state.window.add(left_at_s=site.clock.monotonic_s(), mu=0.45)
        costs.append(peak_bytes(lambda site=site: friction_of(site)))
    assert costs[1] < 1.1 * costs[0]


def test_asked_twice_the_refined_interval_is_made_once():
    site, _ = crowded(50)
    assert friction_of(site).refined is friction_of(site).refined


def test_the_refined_interval_is_that_of_the_newest_thousand():
    site, state = crowded(NEWEST_COUNT)
    before = friction_of(site).refined
    state.window.add(left_at_s=site.clock.monotonic_s() - 3500.0, mu=0.1, expected_error_ratio=0.01)
    assert friction_of(site).refined == before


def test_what_hardly_anybody_supports_is_provisional_and_its_advice_is_held():
    model = WaveringModel()
    site = Site(model=model)

    async def story():
        await traffic(site, mu_new=0.6, count=60, every_s=30.0, first_seed=100)
        before = site.advisory()
        model.wavers = True
        await traffic(site, mu_new=0.1, count=120, every_s=30.0, first_seed=300)
        return before

    before = asyncio.run(story())
    assert before.confidence is Confidence.RECOMMENDED
    after = site.advisory()
    assert friction_of(site).at_least
    assert site.interval().confidence is Confidence.PROVISIONAL
    assert after.interval == site.interval()
    assert after.reason is AdvisoryReason.LOWER_CONFIDENCE_BOUND
    assert after.speed_mps == before.speed_mps


def with_likelihoods_of_ice(passage):
    """The passage, with a likelihood that peaks on ice."""
    profile_ratio = -np.square(np.log(np.array(PROFILE_FRICTIONS_MU) / 0.12)) / (2.0 * 0.3**2)
    values = list(passage.summary.values)
    for place, ratio in zip(GRIP_PROFILE_PLACES, np.maximum(profile_ratio, PROFILE_FLOOR).tolist(), strict=True):
        values[place] = float(np.float32(ratio))
    return replace(passage, summary=replace(passage.summary, values=tuple(values)))


def test_likelihoods_from_before_a_change_do_not_bound_the_advice_after_it():
    model = WaveringModel()
    site = Site(model=model, friction_policies=WATCHED)

    async def story():
        for seed in range(40):
            site.clock.advance(30.0)
            passage = make_passage(SECTION, seed=seed, mu=0.2)
            await site.unit.ingest_passage(with_likelihoods_of_ice(passage))
        await traffic(site, mu_new=0.6, count=20, every_s=30.0, first_seed=100)
        model.wavers = True
        await traffic(site, mu_new=0.6, count=35, every_s=30.0, first_seed=200)

    asyncio.run(story())
    friction = friction_of(site)
    assert friction.at_least
    assert friction.since_change_s is not None
    of_all = site.state().likelihoods.placed(now_s=site.clock.monotonic_s())
    assert of_all is not None
    assert not of_all.at_least
    on_ice_mps = curve_speed_mps(SECTION, mu=of_all.mu_low, utilisation_frac=AdvisoryPolicy().utilisation_frac)
    assert site.advisory().speed_mps > on_ice_mps + kph_to_mps(STEP_KPH)


def test_a_change_that_nothing_tells_of_any_more_no_longer_cuts_what_stands_beside_the_interval():
    site = Site(friction_policies=WATCHED)

    async def story():
        await traffic(site, mu_new=0.6, count=14, every_s=1.0, first_seed=100)
        site.clock.advance(10_000.0)
        await traffic(site, mu_new=0.6, count=4, every_s=1.0, first_seed=200)
        await traffic(site, mu_new=0.2, count=8, every_s=1.0, first_seed=300)

    asyncio.run(story())
    cut = friction_of(site)
    assert cut.interval.passages_count == cut.refined.informative_count == 10
    site.clock.advance(1_000.0)
    whole = friction_of(site)
    assert whole.interval.passages_count == whole.refined.informative_count == 12


class OldTableStore(FakeStore):
    """Holds passages of a feature table that this software has never heard of."""

    async def load(self, *, since_unix_s, limit_count, before=None):
        loaded = await super().load(since_unix_s=since_unix_s, limit_count=limit_count, before=before)
        return [replace(passage, table_digest="0" * 16, values=passage.values[:7]) for passage in loaded]


def test_after_a_restart_likelihoods_still_tell_of_ice():
    model = WaveringModel()
    site = Site(model=model)

    async def story():
        model.wavers = True
        for seed in range(30):
            site.clock.advance(30.0)
            passage = make_passage(SECTION, seed=seed, mu=0.6)
            outcome = await site.unit.ingest_passage(with_likelihoods_of_ice(passage))
            assert flags_of(outcome) == NotCounted.NONE
        model.wavers = False  # or it would not start
        old_store = OldTableStore()
        old_store.entries = site.store.entries
        again, without = site.restarted(), Site(store=old_store, clock=site.clock)
        assert [await one.unit.restore() for one in (again, without)] == [30, 30]
        return again, without

    again, without = asyncio.run(story())
    state, restored = site.state(), again.state()
    now_s = site.clock.monotonic_s()
    assert restored.likelihoods.placed(now_s=now_s) == state.likelihoods.placed(now_s=now_s)
    assert restored.window.rows.slowest_mps.tolist() == state.window.rows.slowest_mps.tolist()
    before, after = site.advisory(), again.advisory()
    assert before.reason is AdvisoryReason.LOWER_CONFIDENCE_BOUND
    assert after.speed_mps == before.speed_mps
    assert after.speed_mps < without.advisory().speed_mps


def test_after_a_restart_estimates_of_a_forgotten_feature_table_count_without_their_likelihoods():
    site = Site(store=OldTableStore())

    async def story():
        await traffic(site, mu_new=0.5, count=5, first_seed=100)
        again = site.restarted()
        assert await again.unit.restore() == 5
        return again

    restored = asyncio.run(story()).state()
    assert len(restored.likelihoods) == 0
    assert np.isnan(restored.window.rows.slowest_mps).all()

"""What the port promises, asked of the real store and of the fake that other tests lean on."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from roadgrip.ledger import Action, chain_problems
from rsu_app.adapters.store import open_store
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
        assert await store.append([first]) == [None]
        assert await store.append([second]) == [None]
        assert await store.append([both]) == [first.estimate]
        assert (await store.counts()).passages_count == 2

    run(story)


def test_loading_gives_the_newest_oldest_first(run):
    entries = [make_entry(seed, received_unix_s=NOON_UNIX_S + seed) for seed in range(5)]

    async def story(store):
        for entry in entries:
            await store.append([entry])
        loaded = await store.load(since_unix_s=NOON_UNIX_S + 1.0, limit_count=3)
        assert [passage.estimate for passage in loaded] == [entry.estimate for entry in entries[2:]]
        [newest] = await store.load(since_unix_s=NOON_UNIX_S + 4.0, limit_count=3)
        assert newest.estimate == entries[4].estimate

    run(story)


def test_what_is_loaded_has_the_values_that_were_judged(run):
    entry = make_entry(1)

    async def story(store):
        await store.append([entry])
        [loaded] = await store.load(since_unix_s=0.0, limit_count=1)
        assert loaded.table_digest == entry.passage.summary.table_digest
        assert tuple(loaded.values.tolist()) == entry.passage.summary.values

    run(story)


def judged(seed, *, bundle_id, left_unix_s=NOON_UNIX_S, shadow_bundle_id=None, shadow_mu=None):
    entry = make_entry(seed)
    changes = {
        "bundle_id": bundle_id,
        "left_unix_s": left_unix_s,
        "shadow_bundle_id": shadow_bundle_id,
        "shadow_mu": shadow_mu,
    }
    return replace(entry, estimate=replace(entry.estimate, **changes))


def test_the_first_passages_under_a_bundle_are_given_in_the_order_in_which_vehicles_left(run):
    late, early, middle = (
        judged(seed, bundle_id="a", left_unix_s=NOON_UNIX_S + s) for seed, s in ((1, 9), (2, 1), (3, 5))
    )

    async def story(store):
        for entry in (late, early, middle, judged(4, bundle_id="b")):
            await store.append([entry])
        first = await store.load_first(section_id=SECTION.section_id, bundle_id="a", limit_count=2)
        assert [passage.estimate for passage in first] == [early.estimate, middle.estimate]
        assert await store.load_first(section_id="elsewhere", bundle_id="a", limit_count=2) == []

    run(story)


def test_passages_that_two_bundles_answered_are_counted(run):
    entries = [
        judged(1, bundle_id="a", shadow_bundle_id="b", shadow_mu=0.4),
        judged(2, bundle_id="a", shadow_bundle_id="b", shadow_mu=0.5),
        judged(3, bundle_id="a", shadow_bundle_id="b"),
        judged(4, bundle_id="b", shadow_bundle_id="a", shadow_mu=0.5),
        judged(5, bundle_id="a"),
    ]

    async def story(store):
        for entry in entries:
            await store.append([entry])
        assert await store.compared_count(bundle_id="a", shadow_bundle_id="b") == 2
        assert await store.compared_count(bundle_id="b", shadow_bundle_id="a") == 1

    run(story)


def test_pruning_forgets_ids_and_values_with_the_passage(run):
    entries = [make_entry(seed, received_unix_s=NOON_UNIX_S + seed) for seed in range(4)]

    async def story(store):
        for entry in entries:
            await store.append([entry])
        assert await store.prune(before_unix_s=NOON_UNIX_S + 1.0, rows_limit_count=2) == 2
        assert await store.append([entries[0]]) == [None]
        assert await store.append([entries[3]]) == [entries[3].estimate]

    run(story)


def test_a_new_ledger_says_that_it_is_new(run):
    async def story(store):
        [entry] = await store.ledger(limit_count=10)
        assert (entry.sequence_number, entry.actor, entry.action) == (1, "unit", Action.LEDGER_BEGUN)
        assert (entry.reason, entry.evidence) == ("a new database", {})

    run(story)


def test_the_ledger_comes_newest_first_and_as_it_was_recorded(run):
    async def story(store):
        recorded = [
            await store.record(
                at_unix_s=NOON_UNIX_S + number / 3.0,
                actor="anna",
                action=Action.INSTALLED,
                subject=f"bundle-{number}",
                reason='wrong in "snow" ☃',
                evidence={"ring": "canary", "gate": "passed"},
            )
            for number in range(3)
        ]
        assert list(await store.ledger(limit_count=2)) == recorded[:0:-1]
        assert chain_problems((await store.ledger(limit_count=10))[::-1]) == []

    run(story)


def test_what_is_recorded_at_once_makes_one_chain(run):
    async def story(store):
        numbers = range(20)
        await asyncio.gather(
            *(
                store.record(at_unix_s=0.0, actor="unit", action=Action.LIVE, subject=str(number), reason="")
                for number in numbers
            )
        )
        entries = await store.ledger(limit_count=100)
        assert {entry.subject for entry in entries[:-1]} == set(map(str, numbers))
        assert chain_problems(entries[::-1]) == []

    run(story)


@pytest.mark.parametrize("beside", [(None, None), ("fedcba9876543210", None), ("fedcba9876543210", 0.37)])
def test_what_a_second_bundle_said_is_kept(run, beside):
    bundle_id, mu = beside
    entry = make_entry(1)
    entry = replace(entry, estimate=replace(entry.estimate, shadow_bundle_id=bundle_id, shadow_mu=mu))

    async def story(store):
        await store.append([entry])
        [loaded] = await store.load(since_unix_s=0.0, limit_count=1)
        assert loaded.estimate == entry.estimate

    run(story)


def test_a_probe_passes_when_writing_works(run):
    async def story(store):
        await store.probe()

    run(story)

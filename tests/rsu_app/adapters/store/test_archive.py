"""Passages as they are read for an export."""

from __future__ import annotations

import asyncio
from dataclasses import fields, replace

import numpy as np
import pytest

from roadgrip.errors import StoreError
from roadgrip.passage_export import ExportedPassage
from roadgrip.records import NotCounted
from rsu_app.adapters.store import Wanted, archive, exported_passages, open_store, wanted_count
from tests.rsu_app.adapters.store.stories import make_entry
from tests.rsu_app.fakes import NOON_UNIX_S, make_passage, make_section

ALWAYS = Wanted(since_unix_s=0.0, until_unix_s=1e12)
OTHER = make_section("another", radius_m=-60.0)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "passages.db"


def keep(path, *entries):
    async def story():
        store = open_store(path)
        await asyncio.gather(*(store.append([entry]) for entry in entries))
        await store.close()

    asyncio.run(story())


def numbers_of(path, wanted=ALWAYS):
    """Tell passages apart by an estimate that `numbered` gave them."""
    return [round(passage.mu * 1000) for passage in exported_passages(path, wanted) if passage.mu is not None]


def numbered(number, *, minutes=0.0, section=None, age_s=0.0):
    passage = None if section is None else make_passage(section, seed=number, age_s=age_s)
    if passage is None and age_s:
        passage = replace(make_entry(number).passage, age_s=age_s)
    return make_entry(number, received_unix_s=NOON_UNIX_S + 60.0 * minutes, mu=number / 1000, passage=passage)


def test_a_passage_is_told_as_it_was_stored(path):
    entry = make_entry(1, mu=0.31, flags=NotCounted.OUT_OF_ENVELOPE, received_unix_s=NOON_UNIX_S + 7.0)
    estimate = replace(
        entry.estimate,
        expected_error_ratio=0.2,
        mu_low=0.25,
        at_least=True,
        shadow_bundle_id="fedcba9876543210",
        shadow_mu=0.4,
    )
    keep(path, replace(entry, estimate=estimate))
    [told] = exported_passages(path, ALWAYS)
    summary = entry.passage.summary
    assert np.array_equal(told.values, np.asarray(summary.values, np.float32))
    said = {field.name: getattr(told, field.name) for field in fields(ExportedPassage) if field.name != "values"}
    assert said == {
        "section_id": "bend",
        "map_version": entry.passage.map_version,
        "table_digest": summary.table_digest,
        "duration_s": summary.duration_s,
        "quality": int(summary.quality),
        "left_unix_s": NOON_UNIX_S + 10.0,
        "bundle_id": "0123456789abcdef",
        "mu": 0.31,
        "flags": int(NotCounted.OUT_OF_ENVELOPE),
        "expected_error_ratio": 0.2,
        "mu_low": 0.25,
        "at_least": True,
        "shadow_bundle_id": "fedcba9876543210",
        "shadow_mu": 0.4,
    }


def test_what_a_bundle_did_not_say_is_told_as_missing(path):
    keep(path, make_entry(1, mu=None, flags=NotCounted.ESTIMATE_OUT_OF_RANGE))
    [told] = exported_passages(path, ALWAYS)
    assert (told.mu, told.expected_error_ratio, told.mu_low, told.at_least) == (None, None, None, False)
    assert (told.shadow_bundle_id, told.shadow_mu) == (None, None)


@pytest.mark.parametrize("batch_count", [1, 3, 500])
def test_passages_come_by_section_and_leaving_and_not_by_arrival(path, monkeypatch, batch_count):
    monkeypatch.setattr(archive, "PASSAGES_BATCH_COUNT", batch_count)
    late = numbered(1, minutes=9.0, age_s=540.0)  # left first, came last: kept in the vehicle's spool
    keep(
        path,
        numbered(2, minutes=1.0),
        numbered(3, minutes=2.0, section=OTHER),
        numbered(4, minutes=2.0),
        numbered(5, minutes=2.0),
        numbered(6, minutes=0.5, section=OTHER),
        late,
    )
    assert numbers_of(path) == [6, 3, 1, 2, 4, 5]
    assert numbers_of(path, replace(ALWAYS, section_id="bend")) == [1, 2, 4, 5]
    assert wanted_count(path, replace(ALWAYS, section_id="bend")) == 4


def test_bounds_go_by_when_a_passage_was_received(path):
    keep(path, *(numbered(number, minutes=number) for number in range(1, 6)), numbered(9, minutes=9.0, age_s=480.0))
    some = Wanted(since_unix_s=NOON_UNIX_S + 120.0, until_unix_s=NOON_UNIX_S + 240.0)
    assert numbers_of(path, some) == [2, 3]
    assert wanted_count(path, some) == 2
    assert numbers_of(path, replace(some, until_unix_s=1e12)) == [9, 2, 3, 4, 5]


def test_passages_can_be_read_while_a_unit_writes(path, monkeypatch):
    monkeypatch.setattr(archive, "PASSAGES_BATCH_COUNT", 7)
    keep(path, *(numbered(number, minutes=number) for number in range(1, 51)))
    before = replace(ALWAYS, until_unix_s=NOON_UNIX_S + 60.0 * 51)

    async def story():
        store = open_store(path)
        reading = asyncio.create_task(asyncio.to_thread(numbers_of, path, before))
        written_count = 0
        while not reading.done():
            await store.append([numbered(100 + written_count, minutes=60.0)])
            written_count += 1
        await store.close()
        return await reading, written_count

    found, written_count = asyncio.run(story())
    assert found == list(range(1, 51))
    assert wanted_count(path, ALWAYS) == 50 + written_count


def test_a_file_that_is_no_database_is_named(path):
    path.write_text("this was a database once\n" * 1000)
    with pytest.raises(StoreError, match=r"passages\.db"):
        list(exported_passages(path, ALWAYS))

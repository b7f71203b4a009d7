"""The unit with nothing faked but time: a bundle, a database, a restart."""

from __future__ import annotations

import asyncio

import pytest

from roadgrip.reasons import Reason
from roadgrip.records import Accepted, FrictionInterval, Rejected
from rsu_app.adapters.inference import load_bundle
from rsu_app.adapters.store import open_store
from rsu_app.usecases import AcceptedAgain, RoadSideUnit
from tests.bundles import make_bundle
from tests.rsu_app.fakes import FakeClock, make_passage
from tests.rsu_app.usecases.site import SECTION


def test_a_power_cut_between_two_passages_changes_nothing_for_either(tmp_path):
    make_bundle(tmp_path / "bundle")
    passages = [make_passage(SECTION, seed=seed, mu=0.3 + 0.01 * seed) for seed in range(11)]
    copied = make_passage(SECTION, seed=3, mu=0.3 + 0.01 * 3, passage_id=b"c" * 16)

    def new_unit(clock):
        return RoadSideUnit(
            sections=[SECTION],
            store=open_store(tmp_path / "passages.db"),
            model=load_bundle(tmp_path / "bundle"),
            clock=clock,
        )

    async def before():
        unit = new_unit(FakeClock())
        await unit.catch_up()
        assert await asyncio.gather(*map(unit.ingest_passage, passages)) == [Accepted()] * 11
        interval = unit.current_interval(SECTION.section_id)
        await unit.close()
        return interval

    async def after():
        clock = FakeClock(monotonic_s=3.0)
        clock.now_unix_s += 60.0
        unit = new_unit(clock)
        assert await unit.restore() == 11
        assert await unit.ingest_passage(passages[5]) == AcceptedAgain()
        refusal = await unit.ingest_passage(copied)
        assert isinstance(refusal, Rejected)
        assert refusal.reason is Reason.REPLAYED
        assert (await unit.readiness()).ready
        interval = unit.current_interval(SECTION.section_id)
        await unit.close()
        return interval

    first, second = asyncio.run(before()), asyncio.run(after())
    assert isinstance(first, FrictionInterval)
    assert isinstance(second, FrictionInterval)
    assert first.median_mu == pytest.approx(0.35, abs=1e-6)
    assert second.median_mu == first.median_mu
    assert second.passages_count == 11
    assert second.newest_age_s == pytest.approx(60.0, abs=1e-3)

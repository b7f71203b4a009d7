from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np

from roadgrip.bundle import Envelope, TrainingReference
from roadgrip.features import NEWEST_TABLE
from roadgrip.records import NotCounted
from rsu_app.domain.drift import DriftAlarm, DriftReport
from rsu_app.domain.section_baseline import BAND_ROWS_COUNT, SPELL_ROWS_COUNT, SPELL_S
from tests.bundles import make_manifest, manifest_of
from tests.rsu_app.fakes import FakeModel
from tests.rsu_app.usecases.site import SECTION, Site

KINEMATIC_COUNT = len(NEWEST_TABLE.kinematic)


async def looked(site: Site) -> DriftReport | None:
    await site.unit.watch_drift()
    report = site.unit.current_drift(SECTION.section_id)
    assert report is None or isinstance(report, DriftReport)
    return report


async def hours_of_traffic(site: Site, hours_count: int, *, first_seed: int = 0) -> None:
    """As many passages in each hour as an hour can teach."""
    for hour in range(hours_count):
        await site.ingest_many(SPELL_ROWS_COUNT, first_seed=first_seed + hour * SPELL_ROWS_COUNT)
        site.clock.advance(SPELL_S)


def test_without_a_passage_there_is_nothing_to_say():
    assert asyncio.run(looked(Site())) is None


def test_traffic_is_held_against_the_training_of_the_live_bundle():
    plain = make_manifest(model=b"a fake has no file")
    reference = TrainingReference(
        section_id=None,
        rows_count=1_000,
        quantiles=tuple(tuple(np.linspace(1e3, 2e3, 21).tolist()) for _ in NEWEST_TABLE.names),
        mu_quantiles=tuple(np.linspace(0.2, 0.3, 21).tolist()),
    )
    models = (replace(plain.models[0], references=(reference,)),)
    watched = replace(manifest_of(models, {plain.models[0].model_file: b"a fake has no file"}), name="watched")

    async def story():
        site = Site(model=FakeModel(watched))
        await site.ingest_many(40)
        report = await looked(site)
        assert report is not None
        assert (report.rows_count, report.own_road) == (40, False)
        assert len(report.features) == KINEMATIC_COUNT
        assert report.drifted_count > KINEMATIC_COUNT // 2
        assert DriftAlarm.ESTIMATES_OUTSIDE in report.alarms

    asyncio.run(story())


def test_a_bundle_that_says_nothing_of_its_training_is_still_watched():
    async def story():
        site = Site()
        await site.ingest_many(5)
        report = await looked(site)
        assert report is not None
        assert (report.rows_count, report.features, report.alarms) == (5, (), ())

    asyncio.run(story())


def test_later_traffic_is_held_against_the_section_s_own_first():
    async def story():
        site = Site()
        hours = -(-BAND_ROWS_COUNT // SPELL_ROWS_COUNT) + 1
        await hours_of_traffic(site, hours)
        report = await looked(site)
        assert report is not None
        assert report.own_rows_count >= SPELL_ROWS_COUNT
        assert DriftAlarm.OWN_TRAFFIC not in report.alarms

    asyncio.run(story())


def test_a_restart_learns_the_section_s_first_traffic_again_and_once():
    async def story():
        site = Site()
        await hours_of_traffic(site, BAND_ROWS_COUNT // SPELL_ROWS_COUNT)
        before = await looked(site)
        again = site.restarted()
        await again.unit.restore()
        await again.ingest_many(5, first_seed=50_000)
        report = await looked(again)
        assert before is not None
        assert report is not None
        assert before.own_rows_count > 0
        assert report.own_rows_count > 0

    asyncio.run(story())


def test_another_bundle_begins_with_nothing():
    async def story():
        site = Site()
        await site.ingest_many(40)
        assert await looked(site) is not None
        newer = make_manifest(model=b"another", weights={"sideslip_mean_rad": 1.0, "steer_mean_rad": 1e-9})
        site.unit.switch_model(FakeModel(newer))
        assert await looked(site) is None
        await site.ingest_many(3, first_seed=1_000)
        report = await looked(site)
        assert report is not None
        assert report.rows_count == 3

    asyncio.run(story())


def test_passages_outside_the_envelope_are_watched_too():
    upper = NEWEST_TABLE.maximum.copy()
    upper[NEWEST_TABLE.index("sideslip_mean_rad")] = 0.2
    narrow = Envelope(tuple(NEWEST_TABLE.minimum.tolist()), tuple(upper.tolist()), outside_allowed_count=0)

    async def story():
        site = Site(model=FakeModel(make_manifest(model=b"a fake has no file", envelope=narrow)))
        await site.ingest_many(30, mu=0.5)
        await site.ingest_many(10, mu=0.8, first_seed=100)
        assert site.store.entries[-1].estimate.flags == NotCounted.OUT_OF_ENVELOPE
        report = await looked(site)
        assert report is not None
        assert (report.rows_count, report.out_of_envelope_frac) == (40, 0.25)
        assert report.alarms == (DriftAlarm.OUT_OF_ENVELOPE,)

    asyncio.run(story())

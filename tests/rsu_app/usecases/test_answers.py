from __future__ import annotations

import asyncio

import pytest

from roadgrip.errors import ConfigurationError
from roadgrip.features import NEWEST_TABLE
from roadgrip.records import (
    AdvisoryNotice,
    AdvisoryReason,
    Beacon,
    MapOffer,
)
from roadgrip.units import kph_to_mps
from rsu_app.domain.advisory import AdvisoryPolicy
from rsu_app.usecases import RoadSideUnit, UnitLimits
from tests.rsu_app.fakes import FakeClock, FakeStore
from tests.rsu_app.usecases.site import OTHER, SECTION, Site


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


def test_the_map_comes_with_the_table_that_is_served():
    assert Site().unit.map_offer(SECTION.section_id) == MapOffer(section=SECTION, table_digests=(NEWEST_TABLE.digest,))


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
        issued_unix_s=int(site.clock.now_unix_s),
    )


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

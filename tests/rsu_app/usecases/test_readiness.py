from __future__ import annotations

import asyncio

from roadgrip.errors import StoreFullError
from roadgrip.records import (
    Accepted,
    AdvisoryNotice,
)
from tests.rsu_app.fakes import FakeClock, make_passage
from tests.rsu_app.usecases.site import OTHER, SECTION, Site


def checks(site):
    readiness = asyncio.run(site.unit.readiness())
    return readiness.ready, {check.name: check.ok for check in readiness.checks}, readiness


def test_a_unit_in_order_is_ready_and_its_empty_window_is_only_information():
    ready, by_name, _ = checks(Site())
    assert ready
    assert by_name == {"model": True, "store": True, "clock": True, "window": False}


def test_a_unit_without_a_model_is_never_ready():
    ready, by_name, readiness = checks(Site(without_model=True, model_absence="the bundle is for another table"))
    assert not ready
    assert not by_name["model"]
    assert readiness.checks[0].detail == "the bundle is for another table"


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

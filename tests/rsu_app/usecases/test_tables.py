"""A unit whose bundle serves several feature tables, with an expected error for each."""

from __future__ import annotations

import asyncio
from math import exp

import numpy as np
import pytest

from roadgrip.features import NEWEST_TABLE, PAPER_TABLE
from roadgrip.reasons import Reason
from roadgrip.records import MapOffer, NotCounted, Rejected
from rsu_app.adapters.inference import load_bundle
from rsu_app.ports import Estimates
from tests.bundles import CONFORMAL, make_bundle_of_tables, make_bundle_with_local, make_manifest
from tests.rsu_app.fakes import FakeModel, make_passage
from tests.rsu_app.usecases.site import OTHER, SECTION, Site, flags_of, reason_of


class ErrorModel(FakeModel):
    """Expects whatever error it is told to expect."""

    def __init__(self):
        super().__init__(make_manifest(model=b"a fake", conformal=CONFORMAL))
        self.answer_error_ratio = None

    def estimate(self, table_digest, rows, *, section_id=None):
        answers = super().estimate(table_digest, rows)
        if self.answer_error_ratio is None:
            return answers
        return Estimates(answers.mu, np.full(len(rows), self.answer_error_ratio))


def site_that_expects(error_ratio):
    model = ErrorModel()
    site = Site(model=model)
    model.answer_error_ratio = error_ratio
    return site, model


def test_each_summary_is_read_by_the_model_for_its_own_table(tmp_path, wider_table):
    make_bundle_of_tables(tmp_path, (wider_table, PAPER_TABLE), biases_mu=(0.7, 0.3))
    site = Site(model=load_bundle(tmp_path))
    for table, seed in ((wider_table, 1), (PAPER_TABLE, 2)):
        asyncio.run(site.unit.ingest_passage(make_passage(SECTION, seed=seed, table=table)))
    estimates = [entry.estimate.mu for entry in site.store.entries]
    assert estimates == pytest.approx([0.7, 0.3], abs=1e-5)


def test_a_section_with_a_model_of_its_own_is_judged_by_it_and_any_other_by_the_global_one(tmp_path):
    make_bundle_with_local(tmp_path, OTHER.section_id, global_mu=0.5, local_mu=0.4)
    site = Site(model=load_bundle(tmp_path))
    for section, seed in ((SECTION, 1), (OTHER, 2)):
        asyncio.run(site.unit.ingest_passage(make_passage(section, seed=seed, mu=0.5)))
    estimates = [entry.estimate.mu for entry in site.store.entries]
    assert estimates == pytest.approx([0.5, 0.4], abs=1e-5)
    assert site.unit.table_digests == (NEWEST_TABLE.digest,)


def test_the_unit_announces_what_its_live_bundle_serves(tmp_path, wider_table):
    make_bundle_of_tables(tmp_path, (wider_table, PAPER_TABLE), biases_mu=(0.7, 0.3))
    both = (wider_table.digest, PAPER_TABLE.digest)
    site = Site()
    assert site.unit.map_offer(SECTION.section_id) == MapOffer(SECTION, site.model.manifest.table_digests)
    site.unit.switch_model(load_bundle(tmp_path))
    assert site.unit.map_offer(SECTION.section_id) == MapOffer(SECTION, both)


def test_a_table_that_is_known_and_not_served_is_refused_with_both_digests(wider_table):
    site = Site()
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION, table=wider_table)))
    assert isinstance(outcome, Rejected)
    assert outcome.reason is Reason.WRONG_FEATURE_TABLE
    assert wider_table.digest in outcome.detail
    assert site.model.manifest.table_digests[0] in outcome.detail
    assert not site.store.entries


def test_a_unit_without_a_model_announces_every_table_it_knows(wider_table):
    site = Site(without_model=True)
    assert set(site.unit.table_digests) >= {PAPER_TABLE.digest, wider_table.digest}
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION, table=wider_table)))
    assert reason_of(outcome) is Reason.NO_MODEL


def test_an_estimate_is_stored_with_its_expected_error():
    site, _ = site_that_expects(0.1)
    asyncio.run(site.unit.ingest_passage(make_passage(SECTION, mu=0.5)))
    estimate = site.store.entries[0].estimate
    assert estimate.expected_error_ratio == pytest.approx(0.1)
    assert estimate.mu_low == pytest.approx(0.5 * exp(-CONFORMAL.quantile * 0.1), abs=1e-6)
    assert not estimate.at_least


def test_a_doubtful_estimate_counts_and_says_at_least():
    site, _ = site_that_expects(0.3)
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION, mu=0.5)))
    assert flags_of(outcome) == NotCounted.NONE
    assert site.store.entries[0].estimate.at_least
    assert site.interval().median_mu == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("error_ratio", [0.0, -0.1, float("nan"), float("inf")])
def test_a_model_that_expects_an_impossible_error_is_not_believed(error_ratio):
    site, _ = site_that_expects(error_ratio)
    outcome = asyncio.run(site.unit.ingest_passage(make_passage(SECTION, mu=0.5)))
    assert flags_of(outcome) == NotCounted.ESTIMATE_OUT_OF_RANGE
    assert site.store.entries[0].estimate.expected_error_ratio is None
    assert site.unit.current_interval(SECTION.section_id) is None


def test_the_window_holds_what_was_said_before_and_after_a_restart():
    site, model = site_that_expects(0.3)
    asyncio.run(site.unit.ingest_passage(make_passage(SECTION, mu=0.5, seed=1)))
    model.answer_error_ratio = 0.1
    asyncio.run(site.unit.ingest_passage(make_passage(SECTION, mu=0.6, seed=2, age_s=60.0)))
    model.answer_error_ratio = None  # a model that misses its golden vectors would not go live again
    again = site.restarted()
    asyncio.run(again.unit.restore())
    for one in (site, again):
        rows = one.state().window.rows
        assert rows.mu == pytest.approx([0.6, 0.5], abs=1e-6)
        assert rows.expected_error_ratio == pytest.approx([0.1, 0.3])
        assert rows.at_least.tolist() == [False, True]
        assert rows.mu_low == pytest.approx([0.6 * exp(-0.2), 0.5 * exp(-0.6)], abs=1e-6)

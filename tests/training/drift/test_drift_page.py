import json

import pytest

from tests.training.drift.exported_traffic import export_of, passages_of, watched_manifest
from training.drift.drift import drift_of
from training.drift.page import page_of
from training.drift.report import WORST_COUNT, document_of

MANIFEST = watched_manifest()


@pytest.fixture(scope="module")
def document():
    passages = passages_of(MANIFEST, range(20), seed=1, changed_from_day=10, shadow_ratio=0.9)
    return document_of(drift_of([export_of(MANIFEST, passages, unit="<north>")], MANIFEST))


def test_the_document_is_plain_json(document):
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["advice"] == "retrain"
    latest = document["sections"][0]["periods"][-1]
    assert latest["alarms"] == ["own_traffic"]
    assert latest["own_traffic"]["drifted_count"] == len(document["moved_most"])
    assert len(latest["own_traffic"]["worst"]) == WORST_COUNT
    assert latest["shadow"]["median_ratio"] == pytest.approx(-0.1054)
    assert latest["training"]["own_road"] is True


def test_what_could_not_be_compared_is_null():
    few = document_of(drift_of([export_of(MANIFEST, passages_of(MANIFEST, range(1), seed=1)[:20])], MANIFEST))
    latest = few["sections"][0]["periods"][-1]
    assert latest["own_traffic"]["drifted_count"] is None
    assert latest["training"]["estimate"] is None
    assert "too few passages" in page_of(few)


def test_the_page_needs_nothing_else_and_says_what_to_do(document):
    page = page_of(document)
    assert ">retrain</span>" in page
    assert "Plotly.newPlot" in page
    assert "<script src=" not in page
    assert "Traffic is not what it was at like friction" in page
    assert "Median of shadow over live estimate" in page


def test_names_from_outside_cannot_become_tags(document):
    assert "<td>&lt;north&gt;</td>" in page_of(document)
    assert "<td><north>" not in page_of(document)

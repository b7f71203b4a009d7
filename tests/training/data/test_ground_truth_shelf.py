from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from training.data.ground_truth import GroundTruth, Measurement, RefusedRow, RowReason, canonical_csv
from training.data.ground_truth_shelf import (
    GroundTruthCard,
    add_ground_truth,
    ground_truth_cards,
    read_ground_truth_set,
)
from training.data.shelf import ShelfError
from training.laboratory import Laboratory

FIRST = Measurement("bend", 1_769_839_200.0, 1_769_842_800.0, 0.35, 0.02, "ViaFriction 3", "wet")
SECOND = replace(FIRST, section_id="s-turn", mu=0.4, instrument="RCR")
REFUSED = RefusedRow(4, RowReason.OUT_OF_RANGE, "mu 35 is not within 0.02 to 1.5", "bend,…,35")


@pytest.fixture
def lab(tmp_path: Path) -> Laboratory:
    return Laboratory(tmp_path / "lab")


def added(lab: Laboratory, *measurements: Measurement, name: str = "week-5", **changes) -> GroundTruthCard:
    words = {"origin": "road authority", "licence": "CC0-1.0", "source": b"as it came", "now_unix_s": 7.0}
    return add_ground_truth(lab, GroundTruth(measurements, (REFUSED,)), name=name, **{**words, **changes})


def folder_of(lab: Laboratory, card: GroundTruthCard) -> Path:
    return lab.data_folder / "ground-truth" / card.digest


@pytest.mark.parametrize("ref", ["week-5", "digest"])
def test_measurements_come_back_as_they_were_put_there(lab, ref):
    card = added(lab, FIRST, SECOND)
    kept = read_ground_truth_set(lab, card.digest if ref == "digest" else ref)
    assert kept.card == card
    assert kept.measurements == (FIRST, SECOND)
    assert (card.sections, card.instruments) == (("bend", "s-turn"), ("RCR", "ViaFriction 3"))
    assert (card.measurements_count, card.refused_count) == (2, 1)
    assert (card.from_unix_s, card.until_unix_s, card.added_unix_s) == (FIRST.from_unix_s, FIRST.until_unix_s, 7.0)


def test_the_same_measurements_again_are_the_same_table(lab):
    first = added(lab, FIRST, SECOND)
    assert added(lab, SECOND, FIRST, name="again", source=b"sorted otherwise") == first
    assert ground_truth_cards(lab) == [first]


def test_refused_rows_are_kept_beside_what_is_used(lab):
    folder = folder_of(lab, added(lab, FIRST))
    assert "4,out_of_range" in (folder / "refused.csv").read_text(encoding="utf-8")
    assert {path.stat().st_mode & 0o777 for path in folder.iterdir()} == {0o444}


def test_a_name_stays_with_what_has_it(lab):
    first = added(lab, FIRST)
    with pytest.raises(ShelfError, match=f"week-5 is the name of {first.digest}"):
        added(lab, SECOND)


@pytest.mark.parametrize("changes", [{"origin": ""}, {"licence": " "}, {"name": "Week 5"}])
def test_what_is_not_described_stays_off_the_shelf(lab, changes):
    with pytest.raises(ShelfError):
        added(lab, FIRST, **changes)
    assert ground_truth_cards(lab) == []


def test_no_measurement_is_no_table(lab):
    with pytest.raises(ShelfError, match="all 1 rows were refused"):
        added(lab)


@pytest.mark.parametrize(
    "content",
    [
        canonical_csv([replace(FIRST, mu=0.5)]),
        canonical_csv([FIRST]) + "and more\n",
        "",
        canonical_csv([FIRST, replace(FIRST, mu=1.2, instrument="other")]),
    ],
)
def test_changed_measurements_are_noticed(lab, content):
    card = added(lab, FIRST)
    path = folder_of(lab, card) / "measurements.csv"
    path.unlink()
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ShelfError, match=r"has changed|cannot be read"):
        read_ground_truth_set(lab, "week-5")


@pytest.mark.parametrize("change", [None, {"digest": "0123456789abcdef"}, {"colour": "red"}])
def test_a_card_that_is_none_is_refused_with_its_place(lab, change):
    path = folder_of(lab, added(lab, FIRST)) / "card.json"
    text = "{" if change is None else json.dumps({**json.loads(path.read_text(encoding="utf-8")), **change})
    path.unlink()
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ShelfError, match=r"card\.json"):
        ground_truth_cards(lab)

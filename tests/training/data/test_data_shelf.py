from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.features import PAPER_TABLE
from tests.training.runs import made_up_runs, shuffled
from training.data.data_shelf import (
    DataCard,
    DataKind,
    HoldOutError,
    Role,
    add_data_set,
    card_from_json,
    content_digest,
    data_cards,
    read_data_set,
    row_hashes,
    to_json,
    training_sets,
)
from training.data.shelf import ShelfError, chosen, put_on_shelf
from training.dataset import Runs, joined, write_runs
from training.laboratory import Laboratory

WORDS = {"origin": "made up", "licence": "CC0-1.0", "label_kind": "simulated friction"}


@pytest.fixture
def lab(tmp_path: Path) -> Laboratory:
    return Laboratory(tmp_path / "lab")


def added(lab: Laboratory, runs: Runs, name: str, *, role: str = "training", **changes) -> DataCard:
    return add_data_set(lab, runs, **{**WORDS, "name": name, "kind": "simulated", "role": role, **changes})


def test_a_data_set_comes_back_as_it_was_put_there(lab):
    runs, label_sd_mu = made_up_runs(40), np.linspace(0.01, 0.05, 40)
    card = added(lab, runs, "first", label_sd_mu=label_sd_mu, made_from={"seed": "7"}, now_unix_s=5.0)
    data_set = read_data_set(lab, "first")
    assert data_set.card == card
    assert data_set.runs.digest() == runs.digest()
    assert data_set.label_sd_mu is not None
    assert data_set.label_sd_mu.tolist() == label_sd_mu.tolist()
    assert (card.rows_count, card.usable_count, card.sections, card.added_unix_s) == (40, 36, ("a", "b", "c"), 5.0)
    assert card.made_from == {"seed": "7"}


def test_exact_labels_have_no_uncertainty(lab):
    added(lab, made_up_runs(20), "first")
    assert read_data_set(lab, "first").label_sd_mu is None


def test_the_same_content_again_is_the_same_data_set(lab):
    first = added(lab, made_up_runs(40), "first")
    again = added(lab, shuffled(made_up_runs(40), seed=1), "second", origin="somebody else")
    assert again == first
    assert data_cards(lab) == [first]


def test_the_digest_tells_rows_uncertainty_and_role_apart():
    runs = made_up_runs(20)
    sd = np.full(20, 0.02)
    other_sd = sd.copy()
    other_sd[3] = 0.03
    digests = [
        content_digest(runs, None, role="training"),
        content_digest(made_up_runs(20, seed=1), None, role="training"),
        content_digest(runs, sd, role="training"),
        content_digest(runs, other_sd, role="training"),
        content_digest(runs, None, role="known_roads"),
    ]
    assert len(set(digests)) == 5


def test_the_uncertainty_follows_its_row_whatever_the_order():
    runs, sd = made_up_runs(30), np.linspace(0.01, 0.05, 30)
    order = np.random.default_rng(4).permutation(30)
    assert content_digest(runs.rows(order), sd[order], role="training") == content_digest(runs, sd, role="training")
    assert content_digest(runs.rows(order), sd, role="training") != content_digest(runs, sd, role="training")


def test_a_data_set_is_meant_by_digest_name_or_beginning(lab):
    card = added(lab, made_up_runs(20), "first")
    added(lab, made_up_runs(20, seed=1), "second")
    for ref in (card.digest, "first", card.digest[:6]):
        assert read_data_set(lab, ref).card == card


@pytest.mark.parametrize("ref", ["third", "", "abc"])
def test_what_is_not_there_is_refused_with_what_is(lab, ref):
    card = added(lab, made_up_runs(20), "first")
    with pytest.raises(ShelfError, match=f"first \\({card.digest}\\)"):
        read_data_set(lab, ref)


def test_a_beginning_of_two_digests_means_neither(lab):
    card = added(lab, made_up_runs(20), "first")
    cards = [replace(card, digest="abcdef0000000000"), replace(card, digest="abcdef1111111111", name="second")]
    assert chosen(cards, "abcdef1", what="data set").name == "second"
    with pytest.raises(ShelfError, match="may be any of abcdef0000000000, abcdef1111111111"):
        chosen(cards, "abcdef", what="data set")


def test_a_name_stays_with_what_has_it(lab):
    first = added(lab, made_up_runs(20), "first")
    with pytest.raises(ShelfError, match=f"first is the name of {first.digest}"):
        added(lab, made_up_runs(20, seed=1), "first")
    assert data_cards(lab) == [first]


def test_files_are_read_only(lab):
    card = added(lab, made_up_runs(20), "first", label_sd_mu=np.full(20, 0.1))
    modes = {path.name: path.stat().st_mode & 0o777 for path in (lab.data_folder / card.digest).iterdir()}
    assert modes == {"runs.parquet": 0o444, "label_sd_mu.npy": 0o444, "card.json": 0o444}


def test_changed_rows_are_noticed(lab):
    card = added(lab, made_up_runs(20), "first")
    path = lab.data_folder / card.digest / "runs.parquet"
    write_runs(made_up_runs(20, seed=1), path, description={})
    with pytest.raises(ShelfError, match="has changed since it was put on the shelf"):
        read_data_set(lab, "first")


def test_a_changed_uncertainty_is_noticed(lab):
    card = added(lab, made_up_runs(20), "first", label_sd_mu=np.full(20, 0.1))
    path = lab.data_folder / card.digest / "label_sd_mu.npy"
    path.unlink()
    np.save(path, np.full(20, 0.2))
    with pytest.raises(ShelfError, match="has changed"):
        read_data_set(lab, "first")
    path.unlink()
    with pytest.raises(ShelfError, match="has changed"):
        read_data_set(lab, "first")


def test_a_hold_out_whose_card_is_rewritten_for_training_is_noticed(lab):
    card = added(lab, made_up_runs(20), "judge", role="known_roads")
    path = lab.data_folder / card.digest / "card.json"
    path.unlink()
    path.write_text(to_json(replace(card, role=Role.TRAINING)))
    with pytest.raises(ShelfError, match="has changed"):
        training_sets(lab, ["judge"])


def test_damaged_rows_are_an_error_of_ours(lab):
    card = added(lab, made_up_runs(20), "first")
    path = lab.data_folder / card.digest / "runs.parquet"
    path.chmod(0o644)
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(ShelfError, match="cannot be read"):
        read_data_set(lab, "first")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"name": "first"}'])
def test_a_card_that_says_too_little_is_refused(text):
    with pytest.raises(ShelfError, match="no card of a data set"):
        card_from_json(text)


def test_the_card_of_another_data_set_is_refused(lab):
    card = added(lab, made_up_runs(20), "first")
    path = lab.data_folder / card.digest / "card.json"
    path.unlink()
    path.write_text(to_json(replace(card, digest="0123456789abcdef")))
    with pytest.raises(ShelfError, match="is the card of 0123456789abcdef"):
        data_cards(lab)


@given(
    words=st.fixed_dictionaries({name: st.text() for name in WORDS}), made_from=st.dictionaries(st.text(), st.text())
)
def test_cards_survive_their_file(words, made_from):
    card = DataCard(
        name="first",
        digest="0" * 16,
        kind=DataKind.MEASURED,
        role=Role.MEASURED,
        table_digest=PAPER_TABLE.digest,
        rows_count=3,
        usable_count=2,
        sections=("a", "b"),
        added_unix_s=1.5,
        made_from=made_from,
        **words,
    )
    assert card_from_json(to_json(card)) == card


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "Mixed drives"}, "is no name"),
        ({"name": "0123456789abcdef"}, "is no name"),
        ({"origin": " "}, "no origin"),
        ({"licence": ""}, "no licence"),
        ({"kind": "invented"}, "'invented' is none of simulated, measured"),
        ({"role": "judging"}, "'judging' is none of training"),
        ({"role": "measured"}, "for measured labels"),
        ({"label_sd_mu": np.full(19, 0.1)}, "20 rows but"),
        ({"label_sd_mu": np.full(20, -0.1)}, "uncertainty"),
        ({"label_sd_mu": np.full(20, np.nan)}, "uncertainty"),
    ],
)
def test_what_is_described_wrongly_stays_off_the_shelf(lab, changes, message):
    with pytest.raises(ShelfError, match=message):
        added(lab, made_up_runs(20), **{"name": "first", **changes})
    assert data_cards(lab) == []


@pytest.mark.parametrize("label_mu", [0.0, -0.2, 1.6])
def test_a_label_that_is_no_friction_stays_off_the_shelf(lab, label_mu):
    runs = made_up_runs(20)
    runs.labels["label_mu"][4] = label_mu
    with pytest.raises(ShelfError, match="are no frictions"):
        added(lab, runs, "first")


def test_rows_none_of_which_can_be_used_stay_off_the_shelf(lab):
    runs = made_up_runs(20)
    runs.labels["label_mu"][:] = np.nan
    with pytest.raises(ShelfError, match="none of the 20 rows"):
        added(lab, runs, "first")


def test_writing_that_breaks_off_leaves_nothing(tmp_path):
    def breaks_off(folder: Path) -> None:
        (folder / "half").write_text("ha")
        raise OSError

    with pytest.raises(OSError):
        put_on_shelf(tmp_path / "shelf" / ("0" * 16), breaks_off)
    assert list((tmp_path / "shelf").iterdir()) == []


def test_who_comes_second_changes_nothing(tmp_path):
    place = tmp_path / ("0" * 16)
    put_on_shelf(place, lambda folder: write_word(folder, "first"))
    put_on_shelf(place, lambda folder: write_word(folder, "second"))
    assert (place / "word").read_text() == "first"
    assert list(tmp_path.iterdir()) == [place]


def write_word(folder: Path, word: str) -> None:
    (folder / "word").write_text(word)


def test_what_a_killed_command_left_is_no_data_set(lab):
    (lab.data_folder / ".0123456789abcdef.77.partial").mkdir(parents=True)
    assert data_cards(lab) == []


# What may be learned from ---------------------------------------------------------------------------------------------


def test_training_sets_are_given_in_the_order_asked_for(lab):
    added(lab, made_up_runs(20), "first")
    added(lab, made_up_runs(20, seed=1), "second")
    added(lab, made_up_runs(20, seed=2), "judge", role="known_roads")
    assert [each.card.name for each in training_sets(lab, ["second", "first"])] == ["second", "first"]


@pytest.mark.parametrize("role", [role for role in Role if role.is_hold_out])
def test_no_hold_out_is_learned_from(lab, role):
    added(lab, made_up_runs(20), "judge", role=role, kind="measured")
    with pytest.raises(HoldOutError, match=f"judge .* is the hold-out {role}"):
        training_sets(lab, ["judge"])


@pytest.mark.parametrize("role", [role for role in Role if role.is_hold_out])
def test_rows_of_a_hold_out_are_not_learned_from_under_another_name(lab, role):
    judging, own = made_up_runs(20), made_up_runs(30, seed=1)
    added(lab, judging, "judge", role=role, kind="measured")
    renamed = replace(judging, run_key=tuple(f"mine/{key}" for key in judging.run_key))
    added(lab, joined([own, renamed.rows(np.array([2, 3, 4]))]), "mine")
    with pytest.raises(HoldOutError, match=f"3 of the 33 rows of mine .* judge .*{role}.*mine/made-up/00002"):
        training_sets(lab, ["mine"])


def test_rows_of_a_hold_out_are_known_in_an_older_table(lab):
    judging = made_up_runs(20)
    added(lab, judging, "judge", role="known_roads")
    added(lab, judging.for_table(PAPER_TABLE), "mine")
    with pytest.raises(HoldOutError, match="20 rows"):
        training_sets(lab, ["mine"])


def test_failed_drives_are_nobodys_rows(lab):
    judging = made_up_runs(20)
    added(lab, judging, "judge", role="known_roads")
    failed = judging.rows(np.flatnonzero(~judging.usable))
    added(lab, joined([made_up_runs(20, seed=1), failed]), "mine")
    assert [each.card.name for each in training_sets(lab, ["mine"])] == ["mine"]


def test_a_road_that_shall_stay_unseen_is_not_learned_from(lab):
    judging = replace(made_up_runs(20), section_id=("b", "x") * 10)
    added(lab, judging, "judge", role="unseen_roads")
    added(lab, made_up_runs(20, seed=1), "mine")
    with pytest.raises(HoldOutError, match=r"driven 1 of the roads that judge .* keeps unseen: b"):
        training_sets(lab, ["mine"])


def test_a_known_road_is_learned_from_by_other_drives(lab):
    added(lab, made_up_runs(20), "judge", role="known_roads")
    added(lab, made_up_runs(20, seed=1), "mine")
    assert len(training_sets(lab, ["mine"])) == 1


def test_a_changed_hold_out_stops_the_learning(lab):
    card = added(lab, made_up_runs(20), "judge", role="known_roads")
    added(lab, made_up_runs(20, seed=1), "mine")
    write_runs(made_up_runs(20, seed=2), lab.data_folder / card.digest / "runs.parquet", description={})
    with pytest.raises(ShelfError, match=r"judge .* has changed"):
        training_sets(lab, ["mine"])


def test_nothing_and_the_same_twice_are_refused(lab):
    card = added(lab, made_up_runs(20), "first")
    with pytest.raises(ShelfError, match="no data set is named"):
        training_sets(lab, [])
    with pytest.raises(ShelfError, match="named twice"):
        training_sets(lab, ["first", card.digest])


def test_rows_are_alike_to_the_bit_and_no_further():
    runs = made_up_runs(20)
    other = replace(runs, features=runs.features.copy())
    other.features[0, 0] = np.nextafter(np.float32(other.features[0, 0]), np.float32(1.0))
    other.features[1, 0] += 1e-12  # below what 32 bits tell
    same = [a == b for a, b in zip(row_hashes(runs), row_hashes(other), strict=True)]
    assert same == [False] + [True] * 19


def test_a_negative_zero_is_a_zero():
    runs = made_up_runs(2)
    runs.features[:, 0] = [0.0, -0.0]
    runs.features[1, 1:] = runs.features[0, 1:]
    first, second = row_hashes(runs)
    assert first == second


def test_the_card_file_is_for_people_too(lab):
    card = added(lab, made_up_runs(20), "first", origin="Straßenamt")
    text = (lab.data_folder / card.digest / "card.json").read_text(encoding="utf-8")
    assert "Straßenamt" in text
    assert json.loads(text)["role"] == "training"

"""What a bundle before the gate says of drives."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import GRIP_TABLE, PAPER_TABLE
from tests.training.gate.bouts import GOOD, GOOD_OF_PAPER, case, contender, drives, model_of, write
from training.dataset import Runs
from training.gate.contender import Answers, Contender, answers_of, mu_of_rows, read_contender, table_served


def said(bundle: Contender, runs: Runs) -> Answers:
    answers = answers_of(bundle, runs)
    assert answers is not None
    return answers


@pytest.fixture
def runs():
    return drives("unseen_roads", roads_count=3, runs_count=4)


def test_answers_are_those_of_the_models(tmp_path, runs):
    answers = said(contender(tmp_path / "a", conformal=None), runs)
    assert answers.mu == pytest.approx(runs.columns(["grip_all_best_mu"])[:, 0], abs=1e-6)
    assert np.isnan(answers.mu_low).all()


def test_bounds_are_those_that_the_bundle_promises(tmp_path, runs):
    answers = said(contender(tmp_path / "a"), runs)
    assert answers.mu_low == pytest.approx(answers.mu * np.exp(-0.1), rel=1e-5)
    assert answers.mu_high == pytest.approx(answers.mu * np.exp(0.1), rel=1e-5)
    assert (answers.promised_frac == 0.9).all()
    assert answers.counted.all()


def test_an_older_model_answers_what_it_can_of_a_newer_summary(tmp_path, runs):
    write(tmp_path / "old", model_of(weights=GOOD_OF_PAPER, table=PAPER_TABLE))
    old = read_contender(tmp_path / "old")
    assert table_served(old, GRIP_TABLE) == PAPER_TABLE
    answers = said(old, runs)
    assert answers.mu == pytest.approx(0.02 * runs.columns(["speed_mean_mps"])[:, 0], abs=1e-5)


def test_a_newer_model_says_nothing_of_an_older_summary(tmp_path, runs):
    assert answers_of(contender(tmp_path / "a"), runs.for_table(PAPER_TABLE)) is None


def test_a_section_is_judged_by_its_own_model(tmp_path, runs):
    own = runs.section_id[0]
    write(tmp_path / "a", model_of(weights=GOOD), model_of(weights={}, bias_mu=0.5, section_id=own))
    local = read_contender(tmp_path / "a")
    there = np.array(runs.section_id) == own
    for mu in (said(local, runs).mu, mu_of_rows(local, runs.features, runs.section_id, table=GRIP_TABLE)):
        assert mu[there] == pytest.approx(0.5)
        assert mu[~there] == pytest.approx(runs.columns(["grip_all_best_mu"])[~there, 0], abs=1e-6)


def test_an_answer_beyond_the_range_of_the_bundle_does_not_count(tmp_path, runs):
    answers = said(contender(tmp_path / "a", bias_mu=5.0), runs)
    assert answers.unbelievable.all()
    assert not answers.counted.any()


def test_no_estimate_is_as_bad_as_the_least_friction(tmp_path, runs):
    judged = case("unseen_roads", runs, contender(tmp_path / "a"))
    silent = replace(judged.challenger, mu=np.full(len(runs), np.nan))
    assert judged.error_ratio(silent) == pytest.approx(np.log(runs.labels["label_mu"] / 1e-3))


def test_trees_are_found_in_the_bundle_or_beside_it(tmp_path):
    contender(tmp_path / "a")
    assert read_contender(tmp_path / "a").trees_folder is None
    (tmp_path / "trees").mkdir()
    assert read_contender(tmp_path / "a").trees_folder == tmp_path / "trees"
    (tmp_path / "a" / "trees").mkdir()
    assert read_contender(tmp_path / "a").trees_folder == tmp_path / "a" / "trees"
    assert read_contender(tmp_path / "a", trees_folder=tmp_path).trees_folder == tmp_path

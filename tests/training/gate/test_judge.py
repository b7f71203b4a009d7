"""The whole gate: a good challenger passes, bad ones fail by what is wrong with them."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import PAPER_TABLE
from tests.training.gate.bouts import (
    GOOD,
    GOOD_OF_PAPER,
    WRONG_SIGN,
    contender,
    drives,
    holdouts,
    model_of,
    thresholds,
    write,
)
from training.gate.contender import read_contender
from training.gate.judge import judge
from training.gate.page import page_of
from training.gate.thresholds import ThresholdsError
from training.gate.verdict import verdict_digest, verdict_from_json, verdict_to_json


@pytest.fixture(scope="module")
def champion(tmp_path_factory):
    return contender(tmp_path_factory.mktemp("champion") / "a", of_paper=GOOD_OF_PAPER)


def judged(challenger, champion, runs=None, *, asked=None, **options):
    ticks = iter(np.arange(100_000) * 0.001)
    return judge(
        challenger,
        champion,
        holdouts() if runs is None else runs,
        asked or thresholds(),
        rng=np.random.default_rng(0),
        made_unix_s=1_790_000_000.0,
        clock=lambda: float(next(ticks)),
        **options,
    )


def failed(verdict):
    return {check.name for check in verdict.failures}


@pytest.fixture(scope="module")
def good_verdict(champion):
    return judged(champion, champion)


def test_a_challenger_as_good_as_the_champion_passes(good_verdict, champion):
    assert good_verdict.passed, good_verdict.failures
    assert (good_verdict.challenger, good_verdict.champion) == (champion.manifest.bundle_id,) * 2


def test_everything_that_is_asked_stands_in_the_verdict(good_verdict):
    assert {check.name for check in good_verdict.checks} == {
        "holdout", "serves", "paired_error", "worst_group", "coverage", "worst_coverage", "expected_error", "envelope",
        "answers", "interval_error", "onnx_parity", "latency", "size", "monotone_sanity", "drift",
    }  # fmt: skip
    assert [(each.role, each.digest) for each in good_verdict.holdouts] == [
        (role, runs.digest()) for role, runs in holdouts().items()
    ]


def test_models_of_older_tables_are_judged_by_their_errors(good_verdict):
    subjects = {(check.name, check.subject) for check in good_verdict.checks if "table 1" in check.subject}
    assert subjects == {
        (name, f"{role}, feature table 1")
        for name in ("paired_error", "worst_group")
        for role in ("known roads", "unseen roads", "manoeuvres")
    }


def test_a_verdict_of_the_gate_comes_back_from_its_json_to_its_digest(good_verdict):
    again = verdict_from_json(verdict_to_json(good_verdict))
    assert again == good_verdict
    assert verdict_digest(again) == verdict_digest(good_verdict)
    assert page_of(again) == page_of(good_verdict)


def test_the_same_bout_gives_the_same_verdict(good_verdict, champion):
    assert verdict_digest(judged(champion, champion)) == verdict_digest(good_verdict)


def test_a_challenger_that_goes_wrong_fails_by_all_that_it_breaks(tmp_path, champion):
    bad = contender(tmp_path / "bad", weights={**WRONG_SIGN, "grip_all_best_mu": 1.5}, of_paper=GOOD_OF_PAPER)
    verdict = judged(bad, champion)
    assert not verdict.passed
    assert {"paired_error", "worst_group", "coverage", "interval_error", "monotone_sanity"} <= failed(verdict)


def test_a_bad_model_for_an_older_table_alone_fails(tmp_path, champion):
    bad = contender(tmp_path / "bad", of_paper={"speed_mean_mps": 0.03})
    verdict = judged(bad, champion)
    assert {check.subject.rpartition(", ")[2] for check in verdict.failures} == {"feature table 1"}


def test_a_table_that_the_champion_serves_must_stay_served(tmp_path, champion):
    verdict = judged(contender(tmp_path / "a"), champion)
    assert failed(verdict) == {"serves"}


def test_a_challenger_of_the_older_table_alone_is_judged_by_it_in_full(tmp_path):
    write(tmp_path / "old", model_of(weights=GOOD_OF_PAPER, table=PAPER_TABLE))
    old = read_contender(tmp_path / "old")
    verdict = judged(old, old)
    assert verdict.passed, verdict.failures
    assert any(check.name == "coverage" and "table 1" in check.subject for check in verdict.checks)


def test_without_a_champion_limits_are_absolute(tmp_path, champion):
    assert judged(champion, None).passed
    bad = contender(tmp_path / "bad", weights={"grip_all_best_mu": 1.4})
    assert "paired_error" in failed(judged(bad, None))


def test_a_hold_out_that_is_missing_or_tiny_fails(champion):
    runs = holdouts()
    assert failed(judged(champion, champion, {role: runs[role] for role in ("known_roads", "manoeuvres")})) == {
        "holdout"
    }
    tiny = {**runs, "manoeuvres": drives("manoeuvres", roads_count=1, runs_count=20)}
    assert "holdout" in failed(judged(champion, champion, tiny))


def test_no_drive_at_all_fails_and_does_not_crash(champion):
    assert {"holdout", "interval_error", "latency"} <= failed(judged(champion, champion, {}))


def test_a_challenger_that_says_it_learned_from_a_hold_out_fails(tmp_path, champion):
    runs = holdouts()
    write(
        tmp_path / "cheat",
        model_of(weights=GOOD),
        model_of(weights=GOOD_OF_PAPER, table=PAPER_TABLE),
        dataset_digest=runs["unseen_roads"].digest(),
    )
    assert failed(judged(read_contender(tmp_path / "cheat"), champion, runs)) == {"holdout"}


def test_a_hold_out_of_the_older_table_cannot_judge_the_newest(champion):
    runs = holdouts()
    runs["known_roads"] = runs["known_roads"].for_table(PAPER_TABLE)
    assert "holdout" in failed(judged(champion, champion, runs))


def test_measured_drives_decide_only_where_there_are_enough(tmp_path, champion):
    bad_there = drives("measured", roads_count=1, runs_count=60)
    label_mu = 0.6 * bad_there.labels["label_mu"]
    bad_there = replace(bad_there, labels={**bad_there.labels, "label_mu": label_mu})
    verdict = judged(champion, champion, {**holdouts(), "measured": bad_there})
    assert failed(verdict) == {"measured_truth"}
    few = bad_there.rows(np.arange(40))
    assert judged(champion, champion, {**holdouts(), "measured": few}).passed


def test_the_uncertainty_of_measured_labels_reaches_the_check(champion):
    there = drives("measured", roads_count=1, runs_count=60)
    runs = {**holdouts(), "measured": there}
    certain = judged(champion, champion, runs, label_sd_mu=np.full(len(there), 0.001))
    assert failed(certain) == {"measured_truth"}
    assert judged(champion, champion, runs, label_sd_mu=np.full(len(there), 0.05)).passed


def test_parity_that_is_required_fails_without_trees(champion):
    asked = thresholds()
    asked = replace(asked, parity=replace(asked.parity, required=True))
    assert failed(judged(champion, champion, asked=asked)) == {"onnx_parity"}


def test_estimates_that_no_unit_would_believe_fail(tmp_path, champion):
    wild = contender(tmp_path / "wild", weights={"grip_all_best_mu": 3.0}, of_paper=GOOD_OF_PAPER)
    assert "answers" in failed(judged(wild, champion))


def test_steps_are_told_in_order(champion):
    told = []
    judged(champion, champion, on_step=lambda what, done, total: told.append((done, total)))
    assert told == [(number, len(told)) for number in range(len(told))]


def test_a_role_that_does_not_exist_is_refused(champion):
    with pytest.raises(ThresholdsError, match="parking"):
        judged(champion, champion, {"parking": drives("known_roads")})

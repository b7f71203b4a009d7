"""The error of the interval that a unit publishes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.training.gate.bouts import case, contender, drives, thresholds
from training.designs import TWO_FRICTIONS_SUFFIX
from training.gate.intervals import interval_error, interval_errors_ratio

LIMITS = thresholds().interval


def asked(*cases, **changes):
    return interval_error(cases, replace(LIMITS, **changes), seed=1).checks


@pytest.fixture
def runs():
    return drives("unseen_roads")


def test_a_model_that_is_right_places_the_interval_about_right(tmp_path, runs):
    (check,) = asked(case("unseen_roads", runs, contender(tmp_path / "a")))
    assert check.passed
    assert check.figures["mean_ratio"] < 0.04


def test_a_bias_moves_the_interval_by_as_much(tmp_path, runs):
    biased = contender(tmp_path / "a", weights={"grip_all_best_mu": 1.3})
    (check,) = asked(case("unseen_roads", runs, biased))
    assert not check.passed
    assert check.figures["mean_ratio"] == pytest.approx(0.3, abs=0.03)


def test_with_a_champion_its_error_is_the_measure(tmp_path, runs):
    good, bad = contender(tmp_path / "a"), contender(tmp_path / "b", weights={"grip_all_best_mu": 1.07})
    assert asked(case("unseen_roads", runs, good, good))[0].passed
    assert not asked(case("unseen_roads", runs, bad, good))[0].passed
    assert asked(case("unseen_roads", runs, bad))[0].passed
    assert asked(case("unseen_roads", runs, bad, bad))[0].passed


def test_only_passages_that_a_unit_would_count_are_drawn(tmp_path, runs):
    judged = case("unseen_roads", runs, contender(tmp_path / "a"))
    strange = np.array(runs.section_id) == "unseen_roads-00"
    mu = np.where(strange, 9.0, judged.challenger.mu)
    wild = replace(judged.challenger, mu=mu, strange=strange)
    errors = interval_errors_ratio(judged, wild, LIMITS, seed=1)
    assert max(each.max() for each in errors.values()) < 0.2
    assert {mu: len(each) for mu, each in errors.items()} == {0.3: 11 * 40, 0.6: 11 * 40}


def test_where_the_friction_drops_along_the_road_there_is_no_one_truth(tmp_path, runs):
    two = replace(runs, scenario=tuple(f"{name}{TWO_FRICTIONS_SUFFIX}" for name in runs.scenario))
    checks = asked(case("unseen_roads", two, contender(tmp_path / "a")))
    assert [check.required for check in checks] == [False, True]


def test_one_hold_out_that_says_nothing_is_said_and_the_other_decides(tmp_path, runs):
    good = contender(tmp_path / "a")
    few = drives("known_roads", runs_count=5)
    silent, judged = asked(case("known_roads", few, good), case("unseen_roads", runs, good))
    assert (silent.passed, silent.required, judged.passed, judged.required) == (False, False, True, True)


def test_hold_outs_of_which_none_says_anything_fail(tmp_path):
    checks = asked(case("known_roads", drives("known_roads", runs_count=5), contender(tmp_path / "a")))
    assert checks[-1].failed
    assert "no hold-out has enough passages" in checks[-1].sentence


def test_a_challenger_that_calls_everything_strange_fails_where_the_champion_answers(tmp_path, runs):
    good = contender(tmp_path / "a")
    judged = case("unseen_roads", runs, good, good)
    mute = replace(judged.challenger, strange=np.ones(len(runs), dtype=bool))
    assert asked(replace(judged, challenger=mute))[0].failed

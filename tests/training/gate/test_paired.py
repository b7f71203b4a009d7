"""The paired bootstrap: no worse, and how sure that is."""

from dataclasses import replace

import numpy as np
import pytest

from tests.training.gate.bouts import GOOD, case, contender, drives, thresholds
from training.gate.paired import bootstrap_means, clusters_of, paired_error

LIMITS = thresholds().paired


def asked(judged, **changes):
    (check,) = paired_error(
        judged, replace(LIMITS, **changes), slack_ratio=1.0, required=True, rng=np.random.default_rng(1)
    ).checks
    return check


@pytest.fixture
def runs():
    return drives("unseen_roads")


def test_the_champion_again_passes_and_is_no_better(tmp_path, runs):
    good = contender(tmp_path / "a")
    check = asked(case("unseen_roads", runs, good, good))
    assert check.passed
    assert check.figures["difference_upper_ratio"] == 0.0
    assert "neither surely better nor worse" in check.sentence


def test_a_worse_challenger_fails_and_the_better_one_is_said_to_be(tmp_path, runs):
    good, bad = contender(tmp_path / "a"), contender(tmp_path / "b", weights={"grip_all_best_mu": 1.1})
    worse = asked(case("unseen_roads", runs, bad, good))
    assert not worse.passed
    assert "surely worse" in worse.sentence
    better = asked(case("unseen_roads", runs, good, bad))
    assert better.passed
    assert "surely better" in better.sentence


def test_a_little_worse_passes_within_the_tolerance_only(tmp_path, runs):
    good, near = contender(tmp_path / "a"), contender(tmp_path / "b", weights=GOOD, bias_mu=0.006)
    judged = case("unseen_roads", runs, near, good)
    tolerance = dict.fromkeys(LIMITS.tolerance_ratio, asked(judged).figures["difference_upper_ratio"])
    assert asked(judged, tolerance_ratio=tolerance).passed
    assert not asked(judged, tolerance_ratio=dict.fromkeys(tolerance, 0.0)).passed


def test_without_a_champion_the_error_itself_has_a_limit(tmp_path, runs):
    alone = case("unseen_roads", runs, contender(tmp_path / "a"))
    assert asked(alone).passed
    assert not asked(alone, alone_ratio=dict.fromkeys(LIMITS.alone_ratio, 0.03)).passed


def test_roads_that_err_alike_make_the_mean_less_sure_than_their_drives_would(runs):
    by_road = np.random.default_rng(3).normal(size=12)
    values = by_road[np.unique(np.array(runs.section_id), return_inverse=True)[1]]
    spreads = []
    for fewest in (10, 13):
        clusters = clusters_of(runs, fewest_sections_count=fewest)
        assert clusters.by_road == (fewest == 10)
        means = bootstrap_means(values, clusters, replicates_count=400, rng=np.random.default_rng(4))
        assert means.mean() == pytest.approx(values.mean(), abs=0.1)
        spreads.append(means.std())
    # Drawn within their roads, drives that are alike say the same each time.
    assert spreads[0] == pytest.approx(by_road.std() / np.sqrt(12), rel=0.2)
    assert spreads[1] == pytest.approx(0.0, abs=1e-12)


def test_drives_of_one_name_are_drawn_together(runs):
    twice = replace(runs, run_key=tuple(f"{number // 2}" for number in range(len(runs))))
    assert len(clusters_of(twice, fewest_sections_count=99).stratum) == len(runs) // 2


def test_the_spread_of_drives_is_that_of_a_mean(runs):
    values = np.random.default_rng(5).normal(size=len(runs))
    clusters = clusters_of(runs, fewest_sections_count=99)
    means = bootstrap_means(values, clusters, replicates_count=1000, rng=np.random.default_rng(6))
    assert means.std() == pytest.approx(1.0 / np.sqrt(len(runs)), rel=0.15)


def test_a_handful_of_drives_compares_nothing(tmp_path):
    good = contender(tmp_path / "a")
    few = drives("known_roads", roads_count=1, frictions_mu=(0.3,), runs_count=5)
    check = asked(case("known_roads", few, good, good))
    assert not check.passed
    assert "too few" in check.sentence

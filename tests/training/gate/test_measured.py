"""Estimates against measured friction."""

import pytest

from tests.training.gate.bouts import case, contender, drives, thresholds
from training.gate.measured import measured_truth

LIMITS = thresholds().measured


def asked(folder, *, weight=1.0, runs_count=30, label_sd_mu=None):
    runs = drives("measured", roads_count=1, runs_count=runs_count)
    bundle = contender(folder / "a", weights={"grip_all_best_mu": weight})
    return measured_truth(case("measured", runs, bundle, label_sd_mu=label_sd_mu), LIMITS)


def test_estimates_that_agree_pass_and_a_bias_fails(tmp_path):
    assert asked(tmp_path / "good").passed
    biased = asked(tmp_path / "bad", weight=0.8)
    assert biased.failed
    assert biased.figures["bias_ratio"] == pytest.approx(-0.22, abs=0.03)


def test_scatter_without_bias_fails_by_the_error(tmp_path):
    runs = drives("measured", roads_count=1, noise_ratio=0.4, frictions_mu=(0.3, 0.45, 0.6, 0.7), runs_count=100)
    check = measured_truth(case("measured", runs, contender(tmp_path / "a")), LIMITS)
    assert abs(check.figures["bias_ratio"]) < LIMITS.bias_ratio
    assert check.failed


@pytest.mark.parametrize(("label_sd_mu", "passed"), [(0.02, True), (0.004, False)])
def test_uncertain_labels_are_the_measure_of_the_error(tmp_path, label_sd_mu, passed):
    check = asked(tmp_path, label_sd_mu=label_sd_mu)
    assert check.passed is passed
    assert "error_sds_ratio" in check.limits


def test_labels_that_are_called_certain_are_held_against_the_plain_error(tmp_path):
    assert "error_ratio" in asked(tmp_path, label_sd_mu=0.0).limits


def test_a_few_measured_drives_only_inform(tmp_path):
    few = asked(tmp_path, weight=0.5, runs_count=10)
    assert not few.passed
    assert not few.required
    assert "too few to decide" in few.sentence

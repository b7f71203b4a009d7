"""What a bundle says of its own errors, against what came."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.bundle import Conformal
from tests.bundles import CONFORMAL
from tests.training.gate.bouts import case, contender, drives, thresholds
from training.gate.calibration import calibration, stated_share_ratio

LIMITS = thresholds().calibration


def asked(judged, **changes):
    found = calibration(judged, replace(LIMITS, **changes), required=True)
    return {check.name: check for check in found.checks}


@pytest.fixture
def runs():
    return drives("unseen_roads")


def test_a_bundle_that_knows_its_errors_passes(tmp_path, runs):
    checks = asked(case("unseen_roads", runs, contender(tmp_path / "a")))
    assert {name: check.passed for name, check in checks.items()} == dict.fromkeys(checks, True)
    assert set(checks) == {"coverage", "worst_coverage", "expected_error"}
    # Two errors of 5 % to either side.
    assert checks["coverage"].figures["width_ratio"] == pytest.approx(0.2, rel=1e-4)


@pytest.mark.parametrize("quantile", [0.5, 40.0])
def test_bounds_that_are_far_too_narrow_or_always_hold_fail(tmp_path, runs, quantile):
    said = Conformal(coverage_frac=0.9, quantile=quantile, doubtful_above_ratio=0.2)
    assert asked(case("unseen_roads", runs, contender(tmp_path / "a", conformal=said)))["coverage"].failed


def test_a_group_in_which_bounds_seldom_hold_fails_and_is_named(tmp_path, runs):
    judged = case("unseen_roads", runs, contender(tmp_path / "a"))
    said, slippery = judged.challenger, judged.label_mu < 0.3
    spoiled = {
        name: np.where(slippery & (np.arange(len(runs)) % 3 == 0), 1.5, 1.0) * getattr(said, name)
        for name in ("mu", "mu_low", "mu_high")
    }
    check = asked(replace(judged, challenger=replace(said, **spoiled)))["worst_coverage"]
    assert check.failed
    assert "friction 0.2 to 0.3" in check.sentence


def test_errors_twice_as_large_as_expected_fail(tmp_path):
    noisy = drives("unseen_roads", noise_ratio=0.15)
    assert asked(case("unseen_roads", noisy, contender(tmp_path / "a")))["expected_error"].failed


def test_a_bundle_that_says_nothing_of_its_errors_fails_unless_that_is_allowed(tmp_path, runs):
    silent = case("unseen_roads", runs, contender(tmp_path / "a", conformal=None))
    assert asked(silent)["coverage"].failed
    assert not asked(silent, required=False)["coverage"].failed


def test_at_least_is_only_wrong_where_there_is_less(tmp_path, runs):
    doubtful = replace(CONFORMAL, doubtful_above_ratio=0.01)
    said = case("unseen_roads", runs, contender(tmp_path / "a", conformal=doubtful)).challenger
    assert said.at_least.all()
    assert stated_share_ratio(said, 2.0 * said.mu) == pytest.approx(0.0)
    assert stated_share_ratio(said, said.mu_low) == pytest.approx(1.0)
    assert (stated_share_ratio(said, 0.99 * said.mu_low) > 1.0).all()

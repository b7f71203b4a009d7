"""Trees of the error to expect: above zero, and right on average."""

from __future__ import annotations

import numpy as np
import pytest

from training.error_model import grow_error_trees, log_error_ratio
from training.fit_parameters import Target
from training.regressor import estimate_mu, target_of


def noisy(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Passages whose errors are four times as large where the first feature is positive."""
    rng = np.random.default_rng(1)
    features = rng.normal(size=(count, 5))
    spread = np.where(features[:, 0] > 0.0, 0.2, 0.05)
    return features, np.abs(spread * rng.normal(size=count))


def test_the_mean_magnitude_is_expected_not_the_usual_one() -> None:
    features, miss = noisy(6000)
    expected = estimate_mu(grow_error_trees(features, miss, threads_count=1), features)
    for side in (features[:, 0] > 0.0, features[:, 0] < 0.0):
        assert expected[side].mean() == pytest.approx(miss[side].mean(), rel=0.1)


def test_no_error_is_expected_to_be_nothing_or_less_even_far_from_all_that_was_seen() -> None:
    features, miss = noisy(1500)
    miss[features[:, 1] > 0.0] = 0.0
    trees = grow_error_trees(features, miss, threads_count=1)
    asked = np.random.default_rng(2).uniform(-50.0, 50.0, (1000, 5))
    assert (estimate_mu(trees, asked) > 0.0).all()


def test_trees_of_the_error_say_that_they_add_up_to_a_logarithm() -> None:
    assert target_of(grow_error_trees(*noisy(200), threads_count=1)) is Target.LOG_MU


def test_a_miss_is_as_large_upwards_as_downwards_and_finite_for_an_estimate_of_none() -> None:
    miss = log_error_ratio(np.array([0.2, 0.8, -0.1]), np.array([0.4, 0.4, 0.4]))
    assert miss[0] == pytest.approx(miss[1])
    assert np.isfinite(miss).all()

from __future__ import annotations

import numpy as np
import pytest

from roadgrip.errors import RoadgripError
from training.conformal import conformal_of, nonconformity_ratio


def passages(count: int, *, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return truth, estimate and expected error of passages some of which are three times as doubtful."""
    rng = np.random.default_rng(seed)
    truth_mu = rng.uniform(0.2, 0.7, count)
    expected_ratio = np.where(rng.random(count) < 0.3, 0.12, 0.04)
    estimate_mu = truth_mu * np.exp(rng.standard_t(4, count) * expected_ratio)
    return truth_mu, estimate_mu, expected_ratio


@pytest.mark.parametrize("coverage_frac", [0.5, 0.8, 0.9, 0.95])
def test_the_interval_holds_the_truth_as_often_as_asked_whatever_the_distribution(coverage_frac: float) -> None:
    held = []
    for seed in range(40):
        conformal = conformal_of(*passages(500, seed=seed), coverage_frac=coverage_frac, doubtful_above_ratio=0.2)
        truth_mu, estimate_mu, expected_ratio = passages(500, seed=1000 + seed)
        low = [conformal.mu_low(m, expected_error_ratio=e) for m, e in zip(estimate_mu, expected_ratio, strict=True)]
        high = [conformal.mu_high(m, expected_error_ratio=e) for m, e in zip(estimate_mu, expected_ratio, strict=True)]
        held.append(np.mean((low <= truth_mu) & (truth_mu <= high)))
    assert np.mean(held) == pytest.approx(coverage_frac, abs=0.01)


def test_the_quantile_is_the_rank_among_one_more() -> None:
    # Scores 1 to 9: 0.9 of ten is the ninth, 0.5 of ten the fifth.
    truth_mu = np.full(9, 0.5)
    estimate_mu = truth_mu * np.exp(0.01 * np.arange(1, 10))
    expected_ratio = np.full(9, 0.01)
    assert nonconformity_ratio(truth_mu, estimate_mu, expected_ratio) == pytest.approx(np.arange(1, 10))
    for coverage_frac, rank in ((0.9, 9), (0.5, 5)):
        found = conformal_of(
            truth_mu, estimate_mu, expected_ratio, coverage_frac=coverage_frac, doubtful_above_ratio=0.2
        )
        assert found.quantile == pytest.approx(rank)
    with pytest.raises(RoadgripError, match="too few"):
        conformal_of(truth_mu, estimate_mu, expected_ratio, coverage_frac=0.91, doubtful_above_ratio=0.2)


@pytest.mark.parametrize("wrong", [0.0, -0.1, np.nan, np.inf])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_what_is_not_positive_is_refused(which: int, wrong: float) -> None:
    figures = list(passages(50, seed=1))
    figures[which][7] = wrong
    with pytest.raises(RoadgripError, match="must be positive"):
        conformal_of(*figures, coverage_frac=0.8, doubtful_above_ratio=0.2)

from __future__ import annotations

import numpy as np
import pytest

from roadgrip.errors import RoadgripError
from training.conformal import (
    FEWEST_OF_GROUP_COUNT,
    GROUP_SHORTFALL_FRAC,
    conformal_of,
    nonconformity_ratio,
    stated_nonconformity_ratio,
)


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


def leaning_passages(count: int, *, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return passages whose estimates lean half of the way to the middle and whose expected errors do not tell."""
    rng = np.random.default_rng(seed)
    truth_mu = rng.uniform(0.2, 0.7, count)
    lean = np.exp(0.5 * np.log(truth_mu) + 0.5 * np.log(0.4))
    return truth_mu, lean * np.exp(rng.normal(0.0, 0.1, count)), np.full(count, 0.2)


def group_of(truth_mu: np.ndarray) -> np.ndarray:
    return np.searchsorted([0.3, 0.6], truth_mu, side="right")


def test_no_group_is_forgotten() -> None:
    passages_there = leaning_passages(4000, seed=1)
    group = group_of(passages_there[0])
    alone, grouped = (
        conformal_of(*passages_there, coverage_frac=0.9, doubtful_above_ratio=1.0, groupings=groupings)
        for groupings in ((), (group,))
    )
    truth_mu, estimate_mu, expected_ratio = leaning_passages(8000, seed=2)
    scores, group = nonconformity_ratio(truth_mu, estimate_mu, expected_ratio), group_of(truth_mu)
    held = [[np.mean(scores[group == k] <= said.quantile) for k in range(3)] for said in (alone, grouped)]
    assert min(held[0]) < 0.8
    assert min(held[1]) > 0.9 - GROUP_SHORTFALL_FRAC - 0.02


@pytest.mark.parametrize("seed", range(5))
def test_groups_never_narrow_an_interval(seed: int) -> None:
    figures = passages(900, seed=seed)
    group = np.random.default_rng(seed).integers(0, 3, 900)
    alone, grouped = (
        conformal_of(*figures, coverage_frac=0.9, doubtful_above_ratio=0.1, groupings=groupings)
        for groupings in ((), (group,))
    )
    assert grouped.quantile >= alone.quantile


def test_a_handful_of_passages_is_no_group() -> None:
    truth_mu, estimate_mu, expected_ratio = passages(1000, seed=3)
    few = np.arange(1000) < FEWEST_OF_GROUP_COUNT - 1
    estimate_mu = np.where(few, 3.0 * truth_mu, estimate_mu)
    found = conformal_of(
        truth_mu,
        estimate_mu,
        expected_ratio,
        coverage_frac=0.7,
        doubtful_above_ratio=1.0,
        groupings=(few.astype(np.intp),),
    )
    plain = conformal_of(truth_mu, estimate_mu, expected_ratio, coverage_frac=0.7, doubtful_above_ratio=1.0)
    assert found.quantile == pytest.approx(plain.quantile, rel=0.5)
    assert found.quantile < nonconformity_ratio(truth_mu, estimate_mu, expected_ratio)[few].min()


def test_a_bound_is_wrong_only_where_there_is_less_grip() -> None:
    truth_mu, estimate_mu, expected_ratio = np.array([0.2, 0.4, 0.8]), np.full(3, 0.4), np.full(3, 0.1)
    doubtful, sure = (
        stated_nonconformity_ratio(truth_mu, estimate_mu, expected_ratio, doubtful_above_ratio=limit)
        for limit in (0.05, 0.5)
    )
    assert doubtful == pytest.approx([np.log(2.0) / 0.1, 0.0, 0.0])
    assert sure == pytest.approx(nonconformity_ratio(truth_mu, estimate_mu, expected_ratio))


@pytest.mark.parametrize("coverage_frac", [0.8, 0.9])
def test_censoring_is_valid(coverage_frac: float) -> None:
    held = []
    for seed in range(20):
        conformal = conformal_of(*passages(800, seed=seed), coverage_frac=coverage_frac, doubtful_above_ratio=0.1)
        truth_mu, estimate_mu, expected_ratio = passages(800, seed=1000 + seed)
        said = np.array([conformal.at_least(expected_error_ratio=e) for e in expected_ratio])
        low = [conformal.mu_low(m, expected_error_ratio=e) for m, e in zip(estimate_mu, expected_ratio, strict=True)]
        held.append(np.mean((low <= truth_mu)[said]))
    assert np.mean(held) >= coverage_frac

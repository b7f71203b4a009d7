from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.bundle import Conformal
from training.study.generalise.passages import Passages, Traffic, drawn_passages

EXACT = Traffic(lowest_noise_ratio=0.0, highest_noise_ratio=0.0, outlier_frac=0.0)


def test_exact_vehicles_find_what_their_tyres_find(rng):
    passages = drawn_passages(rng, 2000, mu_new=0.5, traffic=EXACT)
    assert passages.mu.min() >= 0.4
    assert passages.mu.max() <= 0.5
    assert passages.mu.mean() == pytest.approx(0.45, abs=0.003)
    assert not passages.at_least.any()


def test_the_expected_error_is_the_one_that_comes(rng):
    passages = drawn_passages(
        rng, 40_000, mu_new=0.5, traffic=replace(EXACT, lowest_noise_ratio=0.06, highest_noise_ratio=0.06)
    )
    wear_spread = np.log(rng.uniform(0.8, 1.0, 40_000)).std()
    noise = np.sqrt(np.log(passages.mu).std() ** 2 - wear_spread**2)
    assert np.abs(noise * rng.standard_normal(40_000)).mean() == pytest.approx(
        passages.expected_error_ratio[0], rel=0.03
    )


def test_who_needs_little_grip_knows_a_bound(rng):
    passages = drawn_passages(rng, 4000, mu_new=0.5, traffic=replace(EXACT, shy_frac=1.0))
    # Needs are even from 0.5 to 1.1, tyres from 0.8 to 1: two thirds need less than there is.
    assert passages.at_least.mean() == pytest.approx(2.0 / 3.0, abs=0.03)
    assert (passages.mu[passages.at_least] < 0.5).all()


def test_an_error_that_all_share_moves_all_alike(rng):
    shared = [drawn_passages(rng, 400, mu_new=0.5, traffic=replace(EXACT, road_bias_ratio=0.03)) for _ in range(300)]
    assert np.std([np.log(one.mu).mean() for one in shared]) == pytest.approx(0.03, rel=0.15)


def test_rows_may_be_taken_again(rng):
    passages = drawn_passages(rng, 5, mu_new=0.5, traffic=Traffic())
    taken = passages.rows(np.array([4, 4, 0]))
    assert taken.mu.tolist() == passages.mu[[4, 4, 0]].tolist()
    assert len(taken) == 3


def test_only_doubtful_estimates_become_bounds_and_these_lie_below():
    said = Passages(np.full(4, 0.5), np.array([0.01, 0.3, 0.14, 0.16]), np.zeros(4, dtype=np.bool_))
    meant = Conformal(coverage_frac=0.9, quantile=2.0, doubtful_above_ratio=0.15)
    bounded = said.with_bounds(meant)
    assert bounded.at_least.tolist() == [False, True, False, True]
    assert bounded.mu[[0, 2]].tolist() == [0.5, 0.5]
    assert bounded.mu[1] == pytest.approx(meant.mu_low(0.5, expected_error_ratio=0.3))
    assert bounded.mu[3] == pytest.approx(meant.mu_low(0.5, expected_error_ratio=0.16))

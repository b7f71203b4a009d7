from __future__ import annotations

import numpy as np
import pytest

from roadgrip.features import PROFILE_FRICTIONS_MU
from rsu_app.domain.profiles import new_tyre_grid_mu
from rsu_app.domain.shrinkage import Unshrunk, unshrunk
from training.study.generalise.shrinkage import (
    LEAST_SLOPE_RATIO,
    evidence_of_estimates,
    learned_shrinkage,
    learned_temper_exponent,
    spread_ratio,
)

GRID_MU = np.array(PROFILE_FRICTIONS_MU)
NEW_MU = new_tyre_grid_mu(GRID_MU)


def drawn(rng, count, *, shy_noise=0.2):
    """Answers as the best regressor gives them to a noisy reading: the noisier, the more they are drawn."""
    truth = np.exp(rng.normal(np.log(0.4), 0.35, count))
    noise = np.exp(rng.uniform(np.log(0.02), np.log(shy_noise), count))
    slope = 0.35**2 / (0.35**2 + noise**2)
    reading = np.log(truth / 0.4) + noise * rng.standard_normal(count)
    return truth, 0.4 * np.exp(slope * reading), np.sqrt(2.0 / np.pi) * 0.35 * np.sqrt(1.0 - slope)


def test_what_was_drawn_is_learned_and_undone(rng):
    truth, mu, expected = drawn(rng, 20_000)
    shrinkage = learned_shrinkage(mu, expected_error_ratio=expected, label_mu=truth)
    assert shrinkage.slope_ratio[0] > 0.95
    assert 0.6 < shrinkage.slope_ratio[-1] < 0.9
    got = unshrunk(mu, expected_error_ratio=expected, shrinkage=shrinkage)
    slippery = truth < 0.25
    assert np.log(mu / truth)[slippery].mean() > 3.0 * abs(np.log(got.mu / truth)[slippery].mean())


def test_a_regressor_that_follows_nothing_keeps_a_slope(rng):
    truth, _, expected = drawn(rng, 2_000)
    shrinkage = learned_shrinkage(np.full(2_000, 0.4), expected_error_ratio=expected, label_mu=truth)
    assert set(shrinkage.slope_ratio) == {LEAST_SLOPE_RATIO}


def test_evidence_peaks_where_a_tyre_of_usual_wear_puts_it():
    estimates = Unshrunk(np.array([0.45, 0.3]), np.array([0.03, 0.2]))
    lines = evidence_of_estimates(estimates, new_mu=NEW_MU)
    assert np.isfinite(lines).all()
    assert NEW_MU[lines.argmax(axis=1)] == pytest.approx([0.5, 0.33], rel=0.1)
    sharp, shallow = spread_ratio(lines, new_mu=NEW_MU)
    assert sharp < shallow


def test_evidence_adds_up_to_the_truth(rng):
    found = 0.5 * rng.uniform(0.8, 1.0, 300)
    noise = rng.uniform(0.05, 0.4, 300)
    estimates = Unshrunk(found * np.exp(noise * rng.standard_normal(300)), noise)
    total = evidence_of_estimates(estimates, new_mu=NEW_MU).sum(axis=0)
    assert NEW_MU[total.argmax()] == pytest.approx(0.5, rel=0.04)


@pytest.mark.parametrize(("true_exponent", "low", "high"), [(1.0, 0.5, 1.0), (0.1, 0.05, 0.2)])
def test_overconfident_likelihoods_are_found_out(rng, true_exponent, low, high):
    base = rng.uniform(0.3, 0.7, 600)
    found = base * rng.uniform(0.8, 1.0, 600)
    read = np.log(found) + 0.2 / np.sqrt(true_exponent) * rng.standard_normal(600)
    profiles = np.maximum(-0.5 * ((np.log(GRID_MU) - read[:, None]) / 0.2) ** 2, -40.0)
    exponent = learned_temper_exponent(profiles, grid_mu=GRID_MU, base_friction_mu=base)
    assert low <= exponent <= high

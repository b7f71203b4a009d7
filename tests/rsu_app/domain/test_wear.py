from __future__ import annotations

import numpy as np
import pytest

from rsu_app.domain.wear import estimate_density, estimate_survival, noise_of_expected_error

Z = np.linspace(-3.0, 3.0, 4_001)


@pytest.mark.parametrize("noise_ratio", [0.02, 0.05, 0.13, 0.4])
def test_the_density_is_one(noise_ratio):
    assert np.trapezoid(estimate_density(Z, noise_ratio=noise_ratio), Z) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("noise_ratio", [0.02, 0.05, 0.13, 0.4])
def test_the_survival_is_the_integral_of_the_density(noise_ratio):
    density = estimate_density(Z, noise_ratio=noise_ratio)
    below = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2.0 * np.diff(Z))])
    assert estimate_survival(Z, noise_ratio=noise_ratio) == pytest.approx(1.0 - below, abs=1e-4)


def test_drawn_estimates_have_that_distribution(rng):
    wear, error = rng.uniform(0.8, 1.0, 200_000), 0.05 * rng.standard_normal(200_000)
    drawn = np.log(wear) + error
    at = np.array([-0.3, -0.2, -0.1, 0.0, 0.1])
    share = [(drawn > z).mean() for z in at]
    assert estimate_survival(at, noise_ratio=0.05) == pytest.approx(share, abs=0.004)


def test_without_much_noise_only_wear_spreads():
    inside, outside = np.log([0.82, 0.9, 0.98]), np.log([0.75, 1.05])
    # Even in wear w, so of density 5 w in ln w.
    assert estimate_density(inside, noise_ratio=0.002) == pytest.approx([4.1, 4.5, 4.9], rel=1e-3)
    assert estimate_density(outside, noise_ratio=0.002) == pytest.approx([0.0, 0.0], abs=1e-9)


def test_an_expected_error_is_a_mean_magnitude(rng):
    errors = np.abs(0.1 * rng.standard_normal(100_000))
    noise = noise_of_expected_error(
        np.array([errors.mean(), np.nan, 0.0, 9.0]), typical_ratio=0.05, lowest_ratio=0.02, highest_ratio=0.4
    )
    assert noise == pytest.approx([0.1, 0.05 * np.sqrt(np.pi / 2.0), 0.02, 0.4], rel=0.01)

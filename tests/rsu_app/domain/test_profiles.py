from __future__ import annotations

from dataclasses import replace
from math import isinf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.domain.profiles import ProfilePolicy, evidence_of_profiles, new_tyre_grid_mu, pooled_profile
from rsu_app.domain.wear import estimate_density

GRID_MU = np.geomspace(0.08, 1.2, 12)
WHOLE = ProfilePolicy(temper_exponent=1.0)


def pooled(profiles, policy=WHOLE, grid_mu=GRID_MU):
    return pooled_profile(profiles, grid_mu=grid_mu, policy=policy)


def parabolas(tyre_mu, width_ratio):
    """Profiles of a normal error in ln mu; the flanks of real ones are no less deep."""
    return -0.5 * ((np.log(GRID_MU) - np.log(tyre_mu)[:, None]) / np.reshape(width_ratio, (-1, 1))) ** 2


def drawn(rng, count, *, mu_new, width):
    tyre_mu = mu_new * rng.uniform(0.8, 1.0, count)
    width_ratio = rng.uniform(*width, count)
    return parabolas(tyre_mu * np.exp(width_ratio * rng.standard_normal(count)), width_ratio)


def test_nobody_places_nothing():
    assert pooled(np.zeros((0, 12))) is None


@pytest.mark.parametrize("mu_new", [0.2, 0.45, 0.8])
def test_sharp_profiles_place_the_interval(rng, mu_new):
    placed = pooled(drawn(rng, 60, mu_new=mu_new, width=(0.02, 0.08)))
    assert placed.mu_new == pytest.approx(mu_new, rel=0.03)
    assert abs(placed.mu_new - mu_new) < placed.half_width_mu < 0.1 * mu_new
    assert placed.mu_low == pytest.approx(0.8 * placed.mu_new)
    assert (placed.informative_count, placed.at_least) == (60, False)


def test_many_shallow_profiles_add_up_to_a_sharp_one(rng):
    profiles = drawn(rng, 400, mu_new=0.4, width=(0.4, 0.5))
    few, many = (pooled(profiles[:n]) for n in (5, 400))
    assert many.mu_new == pytest.approx(0.4, rel=0.06)
    assert many.half_width_mu < few.half_width_mu / 3.0


@given(st.integers(0, 2**32 - 1), st.randoms(use_true_random=False))
def test_the_order_of_vehicles_and_their_constants_do_not_matter(seed, chance):
    profiles = drawn(np.random.default_rng(seed), 12, mu_new=0.5, width=(0.03, 0.3))
    order = list(range(12))
    chance.shuffle(order)
    shifted = profiles[order] + np.arange(12.0)[:, None]
    a, b = (pooled(p) for p in (profiles, shifted))
    assert a.mu_new == pytest.approx(b.mu_new)
    assert a.half_width_mu == pytest.approx(b.half_width_mu)


@given(st.floats(0.5, 1.5))
def test_scaling_friction_scales_the_interval(factor):
    profiles = parabolas(np.array([0.35, 0.37, 0.4]), 0.05)
    plain = pooled(profiles)
    scaled = pooled(profiles, grid_mu=factor * GRID_MU)
    assert scaled.mu_new == pytest.approx(factor * plain.mu_new)


def test_flat_profiles_say_nothing():
    sharp = parabolas(np.array([0.36, 0.38, 0.41]), 0.04)
    alone = pooled(sharp)
    among = pooled(np.concatenate([sharp, np.zeros((50, 12))]))
    assert among.mu_new == pytest.approx(alone.mu_new)
    assert (among.informative_count, among.censored_count) == (3, 50)


def test_profiles_that_only_exclude_low_friction_place_a_bound():
    rising = -20.0 / (1.0 + np.exp((np.log(GRID_MU) - np.log(0.3)) / 0.1))
    placed = pooled(np.repeat(rising[None, :], 10, axis=0))
    assert placed.at_least
    assert isinf(placed.half_width_mu)
    assert 0.25 < placed.mu_new < 0.6


def test_an_outlier_weighs_no_more_than_its_being_one():
    sharp = parabolas(np.array([0.36, 0.38, 0.39, 0.4, 0.41, 0.42]), 0.04)
    absurd = parabolas(np.array([1.1]), 0.02)
    alone, among = (pooled(p) for p in (sharp, np.concatenate([sharp, absurd])))
    assert among.mu_new == pytest.approx(alone.mu_new, rel=0.01)


def test_tempering_widens():
    profiles = parabolas(np.array([0.36, 0.38, 0.41]), 0.1)
    whole, tempered = (pooled(profiles, p) for p in (WHOLE, replace(WHOLE, temper_exponent=0.25)))
    assert tempered.half_width_mu > 1.3 * whole.half_width_mu


def test_the_evidence_of_a_parabola_is_that_of_the_formula():
    policy = replace(WHOLE, outlier_frac=1e-9)
    evidence = evidence_of_profiles(parabolas(np.array([0.4]), 0.06), grid_mu=GRID_MU, policy=policy)[0]
    new_mu = new_tyre_grid_mu(GRID_MU)
    near = np.abs(np.log(new_mu / 0.44)) < 0.2
    exact = np.log(estimate_density(np.log(0.4 / new_mu[near]), noise_ratio=0.06))
    difference = evidence[near] - exact
    assert np.ptp(difference) < 0.05


@pytest.mark.parametrize("grid", [[0.1, 0.2, 0.3], [0.3, 0.2, 0.4, 0.5], [0.3, 0.31, 0.32, 0.33]])
def test_a_grid_that_cannot_hold_a_profile_is_refused(grid):
    with pytest.raises(ValueError, match="four ascending"):
        new_tyre_grid_mu(np.array(grid))


@pytest.mark.parametrize(
    "belief",
    [{"temper_exponent": 0.0}, {"temper_exponent": 1.5}, {"outlier_frac": 0.0}, {"road_bias_ratio": -1.0}],
)
def test_a_policy_that_contradicts_itself_is_refused(belief):
    with pytest.raises(ValueError, match=r".+"):
        ProfilePolicy(**belief)


def slow_drives(rng, count, *, slope):
    """Profiles that leave nearly everything open and lean a little, all the same way, besides their noise."""
    return -np.log(GRID_MU) * (slope + 0.1 * rng.standard_normal((count, 1)))


def test_a_little_that_all_passages_share_excludes_nothing_however_many_they_are(rng):
    for count in (10, 60, 1000):
        placed = pooled(slow_drives(rng, count, slope=0.05), ProfilePolicy())
        assert placed.at_least
        assert placed.mu_new == pytest.approx(new_tyre_grid_mu(GRID_MU)[0], rel=0.01)


def test_what_is_excluded_by_each_a_little_more_than_they_may_share_is_excluded_by_many(rng):
    few, many = (pooled(slow_drives(rng, count, slope=0.6), ProfilePolicy()) for count in (2, 60))
    assert few.at_least
    assert not many.at_least


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.floats(0.0, 0.5))
def test_the_more_passages_may_share_the_less_is_excluded(seed, count, shared):
    profiles = drawn(np.random.default_rng(seed), count, mu_new=0.5, width=(0.3, 2.0))
    careful, careless = (pooled(profiles, ProfilePolicy(shared_log_ratio=one)) for one in (shared, 0.0))
    assert careful.at_least >= careless.at_least
    if careful.at_least and careless.at_least:
        assert careful.mu_new <= careless.mu_new + 1e-12

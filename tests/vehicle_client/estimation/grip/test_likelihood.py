"""The robust fit: a problem with known constants, bad samples, and what must not matter."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_client.estimation.grip.channels import Channel
from vehicle_client.estimation.grip.likelihood import log_likelihood as log_likelihood_by_sample

COUNT = 200
FRICTIONS_MU = np.linspace(0.2, 0.8, 61)
TRUE_MU = 0.5
STD = 0.02
WEIGHT = np.full(COUNT, 0.5)


def channel(*, seed=1, offset=0.0, scale=0.0, priors=(0.05, 0.03)):
    """Return a channel that senses friction times something known, an offset and a share of something else."""
    rng = np.random.default_rng(seed)
    known, other = np.sin(np.arange(COUNT) / 9.0), np.cos(np.arange(COUNT) / 23.0)
    sensed = TRUE_MU * known + STD * rng.normal(size=COUNT) + offset + scale * other
    return Channel(
        misfit=sensed - FRICTIONS_MU[:, None] * known,
        variance=np.full((len(FRICTIONS_MU), COUNT), STD**2),
        nuisances=(np.ones(COUNT), np.broadcast_to(other, (len(FRICTIONS_MU), COUNT))),
        priors=priors,
    )


def log_likelihood(of, weight):
    return log_likelihood_by_sample(of, weight).sum(axis=1)


def best_mu(fit):
    return FRICTIONS_MU[int(np.argmax(fit))]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("offset", "scale"), [(0.0, 0.0), (0.05, 0.0), (-0.05, 0.03)])
def test_a_known_friction_is_found_beside_unknown_constants(seed, offset, scale):
    assert best_mu(log_likelihood(channel(seed=seed, offset=offset, scale=scale), WEIGHT)) == pytest.approx(
        TRUE_MU, abs=0.021
    )


def test_a_share_of_wild_samples_decides_nothing():
    found = channel()
    wild = np.zeros(COUNT)
    wild[::17] = 2.0
    moved = replace(found, misfit=found.misfit + wild)
    assert best_mu(log_likelihood(moved, WEIGHT)) == pytest.approx(best_mu(log_likelihood(found, WEIGHT)), abs=0.021)


@given(offset=st.floats(-1.0, 1.0), scale=st.floats(-1.0, 1.0))
def test_constants_cost_what_their_priors_say_and_move_no_friction(offset, scale):
    priors = (0.05, 0.03)
    calm = log_likelihood(channel(priors=priors), WEIGHT)
    moved = log_likelihood(channel(offset=offset * priors[0], scale=scale * priors[1], priors=priors), WEIGHT)
    assert best_mu(moved) == pytest.approx(best_mu(calm), abs=0.011)
    # One deviation costs a half; a few rounds leave a little unexplained.
    assert calm.max() - moved.max() == pytest.approx(0.5 * (offset**2 + scale**2), abs=0.5)


def test_beyond_its_prior_a_constant_costs_more_than_it_explains():
    narrow = channel(offset=0.5, priors=(0.005, 0.003))
    wide = channel(offset=0.5, priors=(1.0, 0.003))
    assert log_likelihood(narrow, WEIGHT).max() < log_likelihood(wide, WEIGHT).max() - 50.0


@given(seed=st.integers(0, 2**32 - 1))
def test_the_order_of_the_samples_does_not_matter(seed):
    found = channel()
    order = np.random.default_rng(seed).permutation(COUNT)
    shuffled = Channel(
        misfit=found.misfit[:, order],
        variance=found.variance[:, order],
        nuisances=tuple(np.broadcast_to(of, found.misfit.shape)[:, order] for of in found.nuisances),
        priors=found.priors,
    )
    assert log_likelihood(shuffled, WEIGHT) == pytest.approx(log_likelihood(found, WEIGHT), rel=1e-9)


@given(factor=st.floats(1e-4, 1e4))
def test_the_unit_does_not_matter(factor):
    found = channel(offset=0.02)
    scaled = Channel(
        misfit=factor * found.misfit,
        variance=factor**2 * found.variance,
        nuisances=found.nuisances,
        priors=tuple(factor * prior for prior in found.priors),
    )
    assert log_likelihood(scaled, WEIGHT) == pytest.approx(log_likelihood(found, WEIGHT), rel=1e-6)


def test_samples_without_weight_do_not_count():
    found, weight = channel(), WEIGHT.copy()
    weight[150:] = 0.0
    spoilt = found.misfit.copy()
    spoilt[:, 150:] = 1e3
    assert log_likelihood(replace(found, misfit=spoilt), weight) == pytest.approx(log_likelihood(found, weight))


def test_nothing_sensed_is_nothing_told():
    assert log_likelihood(channel(), np.zeros(COUNT)) == pytest.approx(0.0, abs=1e-12)
    alike = replace(channel(), misfit=np.zeros((len(FRICTIONS_MU), COUNT)))
    assert log_likelihood(alike, WEIGHT) == pytest.approx(0.0, abs=1e-12)


def test_twice_the_samples_tell_twice_as_much():
    found = channel(priors=(10.0, 10.0))
    once, twice = log_likelihood(found, WEIGHT), log_likelihood(found, 2.0 * WEIGHT)
    assert twice - twice.max() == pytest.approx(2.0 * (once - once.max()), rel=1e-3, abs=1e-3)


def test_a_prediction_that_is_less_certain_is_not_punished_for_it():
    # The logarithm of the variance is left out on purpose: with it, noise of the force would be taken for grip.
    found = channel()
    vague = replace(found, variance=4.0 * found.variance)
    assert (log_likelihood(vague, WEIGHT) > log_likelihood(found, WEIGHT)).all()

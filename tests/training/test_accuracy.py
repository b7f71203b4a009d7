from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.accuracy import by_group, mape_ratio, relative_rms_ratio, rms_mu

frictions = st.lists(st.floats(0.05, 1.2), min_size=1, max_size=30)


def test_figures_of_known_numbers():
    truth, estimate = np.array([0.2, 0.5]), np.array([0.22, 0.45])
    assert mape_ratio(truth, estimate) == pytest.approx(0.1)
    assert relative_rms_ratio(truth, estimate) == pytest.approx(0.1)
    assert rms_mu(truth, estimate) == pytest.approx(np.sqrt((0.02**2 + 0.05**2) / 2))


def test_groups_are_measured_each_for_itself_in_the_order_of_their_names():
    truth, estimate = np.array([0.2, 0.5, 0.4]), np.array([0.22, 0.5, 0.36])
    found = by_group(mape_ratio, ["wet", "dry", "wet"], truth_mu=truth, estimate_mu=estimate)
    assert list(found) == ["dry", "wet"]
    assert found == pytest.approx({"dry": 0.0, "wet": 0.1})


@given(frictions, st.floats(0.5, 2.0))
def test_an_error_of_one_share_everywhere_is_that_share(truth, factor):
    mu = np.array(truth)
    assert mape_ratio(mu, factor * mu) == pytest.approx(abs(factor - 1.0))
    assert relative_rms_ratio(mu, factor * mu) == pytest.approx(abs(factor - 1.0))


@given(frictions, st.integers(0, 1000))
def test_the_mean_error_never_exceeds_the_root_mean_square(truth, seed):
    mu = np.array(truth)
    estimate = mu * np.random.default_rng(seed).uniform(0.5, 1.5, len(mu))
    assert mape_ratio(mu, estimate) <= relative_rms_ratio(mu, estimate) * (1.0 + 1e-12)

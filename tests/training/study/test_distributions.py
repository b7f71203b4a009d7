from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.study.distributions import (
    CLOUD_POINTS_COUNT,
    bell_shares,
    box_of,
    cloud_of,
    histogram_of,
    identity_line,
    shape_of,
)


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=40))
def test_a_box_ascends_and_lies_within_its_values(values):
    quantiles = box_of(np.array(values), name="a", group="b").quantiles
    assert list(quantiles) == sorted(quantiles)
    assert min(values) <= quantiles[0]
    assert quantiles[-1] <= max(values)


def test_a_cloud_is_thinned_to_points_that_were_there_and_the_same_each_time():
    x = np.arange(5000.0)
    cloud = cloud_of(x, 2.0 * x, name="a", seed=1)
    assert len(cloud.x) == CLOUD_POINTS_COUNT
    assert all(y == 2.0 * x for x, y in zip(cloud.x, cloud.y, strict=True))
    assert cloud == cloud_of(x, 2.0 * x, name="a", seed=1)
    assert len(cloud_of(x[:10], x[:10], name="a", seed=1).x) == 10


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=40))
def test_every_value_is_in_some_bin(values):
    ((_, shares),) = histogram_of({"a": np.array(values)}, edge_values=np.linspace(-1.0, 1.0, 9))
    assert len(shares) == 8
    assert sum(shares) == pytest.approx(100.0)


@given(st.floats(-1.0, 1.0), st.floats(0.05, 3.0))
def test_a_bell_fills_all_bins_to_one(mean, std):
    assert sum(bell_shares(mean_value=mean, std_value=std, edge_values=np.linspace(-1.0, 1.0, 9))) == pytest.approx(
        100.0
    )


def test_a_bell_looks_like_one_and_a_lopsided_distribution_does_not():
    rng = np.random.default_rng(0)
    bell, lopsided = shape_of(rng.normal(1.0, 2.0, 40_000)), shape_of(rng.exponential(1.0, 40_000))
    assert (bell.mean_value, bell.std_value) == pytest.approx((1.0, 2.0), abs=0.05)
    assert abs(bell.skewness_ratio) < 0.05
    assert abs(bell.kurtosis_ratio) < 0.1
    assert bell.within_one_std_frac == pytest.approx(0.683, abs=0.01)
    assert bell.within_two_std_frac == pytest.approx(0.954, abs=0.01)
    assert lopsided.skewness_ratio == pytest.approx(2.0, abs=0.3)
    assert lopsided.kurtosis_ratio > 3.0


def test_on_the_identity_line_both_are_equal():
    line = identity_line(0.1, 0.8)
    assert line.x == line.y

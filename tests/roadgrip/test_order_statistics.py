"""Quantiles and distinct values, against numpy's own."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.order_statistics import distinct, first_of_each, median, quantile

values = st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=40).map(np.array)


@given(values=values, share=st.floats(0.0, 1.0))
def test_a_quantile_is_numpys(values, share):
    # Between two far neighbours a place is as exact as their distance can be written.
    tolerance = 1e-15 * float(np.abs(values).max())
    assert quantile(values, share) == pytest.approx(float(np.quantile(values, share)), rel=1e-12, abs=tolerance)


@given(values=values)
def test_a_median_is_numpys(values):
    assert median(values) == pytest.approx(float(np.median(values)), rel=1e-15)


@given(values=values)
def test_each_value_comes_once(values):
    assert np.array_equal(distinct(values), np.unique(values))


@given(values=values)
def test_the_first_of_each_is_where_numpy_finds_it(values):
    ordered = np.sort(values)
    assert np.array_equal(np.flatnonzero(first_of_each(ordered)), np.unique(ordered, return_index=True)[1])


def test_one_unknown_value_leaves_the_middle_unknown():
    broken = np.array([1.0, np.nan, 3.0])
    assert np.isnan(median(broken))
    assert np.isnan(quantile(broken, 0.1))


CAR = """
import sys
from tests.vehicle_client.synthetic import drive_over, road, s_turn
from vehicle_client.pipeline import Summarised, summarise_passage
trace, _ = drive_over(s_turn)
assert isinstance(summarise_passage(trace, road(s_turn)), Summarised)
sys.exit("numpy.ma" in sys.modules)
"""


@pytest.mark.system
def test_a_passage_loads_no_masked_arrays():
    assert subprocess.run([sys.executable, "-c", CAR], check=False).returncode == 0

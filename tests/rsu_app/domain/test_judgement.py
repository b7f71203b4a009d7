from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.features import NEWEST_TABLE
from roadgrip.records import NotCounted
from rsu_app.domain.judgement import Judgement, judgement
from tests.bundles import CONFORMAL, make_model

ROW = np.clip(0.0, NEWEST_TABLE.minimum, NEWEST_TABLE.maximum)
MODEL = make_model(conformal=CONFORMAL)


@given(st.floats(0.1, 1.0), st.floats(1e-6, 10.0))
def test_the_bound_lies_below_the_estimate_and_doubt_begins_at_the_bundles_limit(mu, error_ratio):
    found = judgement(ROW, MODEL, mu=mu, expected_error_ratio=error_ratio)
    assert found.flags == NotCounted.NONE
    assert found.mu == mu
    assert found.mu_low is not None
    assert 0.0 < found.mu_low < mu
    assert found.at_least == (error_ratio > CONFORMAL.doubtful_above_ratio)


def test_without_a_model_for_the_error_there_is_a_plain_estimate():
    assert judgement(ROW, make_model(), mu=0.5) == Judgement(mu=0.5, flags=NotCounted.NONE)


@pytest.mark.parametrize("mu", [nan, inf, -inf])
def test_what_is_no_number_says_nothing_at_all(mu):
    found = judgement(ROW, MODEL, mu=mu, expected_error_ratio=0.05)
    assert found == Judgement(mu=None, flags=NotCounted.ESTIMATE_OUT_OF_RANGE)


@pytest.mark.parametrize("error_ratio", [nan, inf, -inf, 0.0, -0.1])
def test_an_impossible_expected_error_does_not_count(error_ratio):
    found = judgement(ROW, MODEL, mu=0.5, expected_error_ratio=error_ratio)
    assert found == Judgement(mu=0.5, flags=NotCounted.ESTIMATE_OUT_OF_RANGE)

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.rounding import rounded


def test_figures_are_rounded_wherever_they_stand_and_nothing_else_is():
    found = rounded({"a": [0.123456, (1234567.0, 1234567)], "b": ("text", None, True)}, digits_count=4)
    assert found == {"a": [0.1235, [1235000.0, 1234567]], "b": ["text", None, True]}


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=1e-200, max_value=1e200), st.integers(1, 12))
def test_what_is_rounded_stays_near_and_is_not_rounded_again(value, digits_count):
    once = rounded(value, digits_count=digits_count)
    assert once == pytest.approx(value, rel=0.5 * 10.0 ** (1 - digits_count) * 1.0001)
    assert rounded(once, digits_count=digits_count) == once

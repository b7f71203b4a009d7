from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.domain import sorted_rows
from rsu_app.domain.sorted_rows import SortedRows

TIMES = st.sampled_from([0.0, 1.0, 1.5, 2.0, 3.0])
"""Few, so that many rows have the same."""
NUMBERS = st.sampled_from([math.nan, -1.0, 0.0, 2.0])
ROW = st.tuples(TIMES, st.sampled_from([0.1, 0.2]), NUMBERS)
ROWS = st.lists(ROW, max_size=60)


@pytest.fixture(autouse=True, scope="module")
def _small_blocks():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sorted_rows, "BLOCK_COUNT", 8)
        patch.setattr(sorted_rows, "FIRST_BLOCK_COUNT", 2)
        yield


def rank(row):
    return [-math.inf if math.isnan(value) else value for value in row]


def held(rows: SortedRows):
    return [rank(row) for row in rows.newest(len(rows)).tolist()]


@given(ROWS)
def test_rows_come_out_in_order_however_they_went_in(given_rows):
    rows = SortedRows(3)
    for row in given_rows:
        rows.add(row)
    assert held(rows) == sorted(map(rank, given_rows))
    assert len(rows) == len(given_rows)


@given(st.lists(st.one_of(ROW, st.none()), max_size=60))
def test_the_first_leaves_whatever_came_in_between(story):
    rows = SortedRows(3)
    expected: list[list[float]] = []
    for row in story:
        if row is not None:
            rows.add(row)
            expected = sorted([*expected, rank(row)])
        elif expected:
            assert rank(rows.pop_first().tolist()) == expected.pop(0)
    assert held(rows) == expected
    if expected:
        assert rank(rows.first.tolist()) == expected[0]
        assert rank(rows.last.tolist()) == expected[-1]


@given(ROWS, st.integers(0, 70))
def test_the_newest_are_the_end_of_all(given_rows, limit_count):
    rows = SortedRows(3)
    for row in given_rows:
        rows.add(row)
    everything = rows.newest(len(rows))
    newest = rows.newest(limit_count)
    np.testing.assert_array_equal(newest, everything[max(0, len(everything) - limit_count) :])


def test_what_was_read_does_not_change_with_the_rows():
    rows = SortedRows(2)
    rows.add([2.0, 0.1])
    read = rows.newest(1)
    rows.add([1.0, 0.1])
    assert read.tolist() == [[2.0, 0.1]]


def test_rows_in_order_fill_their_blocks():
    rows = SortedRows(2)
    for time in range(64):
        rows.add([float(time), 0.5])
    assert [block.stop - block.start for block in rows._blocks] == [8] * 8  # noqa: SLF001 - what memory is taken for

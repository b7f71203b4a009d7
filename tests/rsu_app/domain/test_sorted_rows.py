from __future__ import annotations

import math
from collections import Counter

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rsu_app.domain.sorted_rows import SortedRows

TIMES = st.one_of(
    # Few, so that many rows have the same; before the clock began, too.
    st.sampled_from([-7.25, -0.5, -0.0, 0.0, 1.0, 1.5, 3e9]),
    st.floats(allow_nan=False, allow_infinity=False),
)
NUMBERS = st.sampled_from([math.nan, -1.0, 0.0, 2.0])
ROW = st.tuples(TIMES, st.sampled_from([0.0, 0.1, 0.2, 1e300]), NUMBERS)
ROWS = st.lists(ROW, max_size=60)


def rows_of(given_rows) -> SortedRows:
    rows = SortedRows(3)
    for row in given_rows:
        rows.add(row)
    return rows


def spelled(row):
    """Return a row so that NaN equals itself, and zero its negative."""
    return tuple("NaN" if math.isnan(value) else value + 0.0 for value in row)


@given(ROWS)
def test_rows_come_out_in_order_however_they_went_in(given_rows):
    rows = rows_of(given_rows)
    read = rows.newest(len(rows)).tolist()
    assert [row[:2] for row in read] == sorted([time, number] for time, number, _ in given_rows)
    assert Counter(map(spelled, read)) == Counter(map(spelled, given_rows))
    assert len(rows) == len(given_rows)


@given(ROWS, st.randoms(use_true_random=False))
def test_what_is_held_does_not_depend_on_the_order_of_arrival(given_rows, random):
    shuffled = random.sample(given_rows, len(given_rows))
    np.testing.assert_array_equal(rows_of(given_rows).newest(60), rows_of(shuffled).newest(60))


@given(st.lists(st.one_of(ROW, st.none()), max_size=60))
def test_the_first_leaves_whatever_came_in_between(story):
    rows = SortedRows(3)
    expected: list[tuple[float, float, float]] = []
    for row in story:
        if row is not None:
            rows.add(row)
            expected.append(row)
        elif expected:
            first = min(expected, key=lambda known: known[:2])
            assert rows.first_number == first[0]
            assert tuple(rows.first[:2]) == first[:2]
            gone = spelled(rows.pop_first().tolist())
            assert gone[:2] == spelled(first[:2])
            expected.remove(next(known for known in expected if spelled(known) == gone))
    assert Counter(map(spelled, rows.newest(60).tolist())) == Counter(map(spelled, expected))
    if expected:
        assert tuple(rows.last[:2]) == max(known[:2] for known in expected)


@given(ROWS, st.integers(0, 70))
def test_the_newest_are_the_end_of_all(given_rows, limit_count):
    rows = rows_of(given_rows)
    everything = rows.newest(len(rows))
    newest = rows.newest(limit_count)
    np.testing.assert_array_equal(newest, everything[max(0, len(everything) - limit_count) :])


def test_what_was_read_does_not_change_with_the_rows():
    rows = SortedRows(2)
    rows.add([2.0, 0.1])
    read = rows.newest(1)
    rows.add([1.0, 0.1])
    assert read.tolist() == [[2.0, 0.1]]

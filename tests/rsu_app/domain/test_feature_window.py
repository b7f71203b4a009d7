from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.records import NotCounted
from rsu_app.domain.feature_window import FeatureWindow

PASSAGES = st.lists(
    st.tuples(st.sampled_from([0.0, 1.0, 2.0, 50.0]), st.sampled_from(["old", "new"]), st.integers(0, 5)), max_size=40
)


def filled(passages, **limits):
    window = FeatureWindow(window_s=100.0, **limits)
    for left_at_s, digest, number in passages:
        window.add(
            left_at_s=left_at_s,
            table_digest=digest,
            values=[number, -number],
            mu=None if number == 5 else 0.1 * number,
            flags=NotCounted(number % 2),
        )
    return window


def contents(window, *, now_s=0.0):
    return {
        digest: [(*map(float, row.values[place]), row.mu[place].hex(), int(row.flags[place])) for place in range(n)]
        for digest in window.table_digests
        if (row := window.rows(digest, now_s=now_s)) is not None and (n := len(row.mu))
    }


@given(PASSAGES, st.randoms(use_true_random=False), st.integers(1, 8))
def test_the_order_of_arrival_does_not_matter(passages, chance, capacity_count):
    shuffled = list(passages)
    chance.shuffle(shuffled)
    assert contents(filled(passages, capacity_count=capacity_count)) == contents(
        filled(shuffled, capacity_count=capacity_count)
    )


@given(PASSAGES, st.floats(0.0, 300.0))
def test_a_passage_counts_until_it_is_older_than_the_window(passages, now_s):
    window = filled(passages)
    kept = [each for each in passages if now_s - each[0] <= 100.0]
    for digest in ("old", "new"):
        rows = window.rows(digest, now_s=now_s)
        held = [] if rows is None else rows.values[:, 0].tolist()
        assert sorted(held) == sorted(number for _, table, number in kept if table == digest)
    assert len(window) == len(kept)


def test_a_full_table_keeps_the_newest_and_leaves_the_other_alone():
    window = filled([(9.0, "old", 1), *((float(at), "new", at % 5) for at in (3, 1, 4, 2))], capacity_count=2)
    rows = window.rows("new", now_s=9.0)
    assert rows is not None
    assert rows.values.tolist() == [[3.0, -3.0], [4.0, -4.0]]
    assert window.table_digests == ("new", "old")


def test_what_was_said_of_a_passage_comes_back():
    window = FeatureWindow(window_s=10.0)
    flags = NotCounted.OUT_OF_ENVELOPE | NotCounted.ESTIMATE_OUT_OF_RANGE
    window.add(left_at_s=1.0, table_digest="t", values=np.array([1.5], dtype=np.float32), mu=0.5)
    window.add(left_at_s=2.0, table_digest="t", values=[2.5], mu=None, flags=flags)
    window.add(left_at_s=3.0, table_digest="t", values=[3.5], mu=0.5, flags=NotCounted.ESTIMATE_OUT_OF_RANGE)
    rows = window.rows("t", now_s=3.0)
    assert rows is not None
    assert rows.values.dtype == np.float32
    assert rows.values[:, 0].tolist() == [1.5, 2.5, 3.5]
    assert np.array_equal(rows.mu, [0.5, np.nan, 0.5], equal_nan=True)
    assert rows.flags.tolist() == [0, flags.value, NotCounted.ESTIMATE_OUT_OF_RANGE.value]
    assert rows.out_of_envelope_count == 1


def test_an_idle_window_is_empty_and_so_is_one_that_forgot():
    window = FeatureWindow(window_s=10.0)
    assert len(window) == 0
    assert window.rows("t", now_s=0.0) is None
    window.add(left_at_s=1.0, table_digest="t", values=[1.0], mu=0.5)
    window.forget()
    assert window.table_digests == ()


def test_what_cannot_be_held_is_refused():
    with pytest.raises(ValueError, match="does not belong"):
        FeatureWindow(window_s=10.0).add(left_at_s=np.nan, table_digest="t", values=[1.0], mu=0.5)
    with pytest.raises(ValueError, match="holds nothing"):
        FeatureWindow(window_s=0.0)
    with pytest.raises(ValueError, match="holds nothing"):
        FeatureWindow(window_s=1.0, capacity_count=0)

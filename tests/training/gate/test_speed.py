"""Times and sizes, by a clock that a test winds."""

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import PAPER_TABLE
from tests.training.gate.bouts import GOOD_OF_PAPER, contender, drives, model_of, thresholds, write
from training.gate.contender import read_contender
from training.gate.speed import latency, size, times_of

LIMITS = replace(thresholds().speed, calls_count=100)


class Watch:
    """A clock that only goes when somebody answers: so long to open, so long per row."""

    def __init__(self, *, opening_s, row_s, slow_call=None):
        self.now_s, self.opening_s, self.row_s, self.slow_call = 0.0, opening_s, row_s, slow_call
        self.single_count = 0

    def __call__(self):
        return self.now_s

    def answer(self, rows):
        self.single_count += len(rows) == 1
        slow_s = 1.0 if self.single_count == self.slow_call else 0.0
        self.now_s += self.opening_s + self.row_s * len(rows) + slow_s


def test_opening_and_a_row_more_are_told_apart():
    watch = Watch(opening_s=0.02, row_s=0.0001)
    (times,) = times_of([(watch.answer, np.zeros((7, 3)))], calls_count=100, clock=watch)
    assert times.opening_median_s == pytest.approx(0.0201)
    assert times.row_s == pytest.approx(0.0001)


def test_one_slow_call_in_fifty_shows_in_the_ninety_ninth_of_a_hundred():
    watch = Watch(opening_s=0.02, row_s=0.0, slow_call=30)
    (times,) = times_of([(watch.answer, np.zeros((7, 3)))], calls_count=50, clock=watch)
    assert times.opening_median_s == pytest.approx(0.02)
    assert times.opening_p99_s > 0.3


class Steps:
    """A clock by which the calls of several bundles take so long each; it is looked at twice a call."""

    def __init__(self, *steps_s):
        self.steps_s, self.looked_count, self.now_s = steps_s, 0, 0.0

    def __call__(self):
        self.now_s += self.steps_s[self.looked_count // 2 % len(self.steps_s)]
        self.looked_count += 1
        return self.now_s


@pytest.mark.parametrize(
    ("steps_s", "passed"), [((0.02, 0.02), True), ((0.2, 0.02), False), ((0.2, 0.2), True), ((0.6, 0.6), False)]
)
def test_latency_is_held_against_the_champion_and_against_the_clock(tmp_path, steps_s, passed):
    good = contender(tmp_path / "a")
    # One call each, then one with many rows each.
    limits = replace(LIMITS, calls_count=1)
    ours_s, theirs_s = steps_s
    clock = Steps(ours_s, ours_s, theirs_s, theirs_s)
    rows = drives("unseen_roads", roads_count=1).features
    (check,) = latency(good, good, rows, limits, clock=clock).checks
    assert check.passed is passed
    assert check.figures["opening_over_champion_ratio"] == pytest.approx(steps_s[0] / steps_s[1])


def test_a_champion_of_the_older_table_is_timed_by_its_own_columns(tmp_path):
    write(tmp_path / "old", model_of(weights=GOOD_OF_PAPER, table=PAPER_TABLE))
    old, new = read_contender(tmp_path / "old"), contender(tmp_path / "new")
    rows = drives("unseen_roads", roads_count=1).features
    assert latency(new, old, rows, LIMITS, clock=Steps(0.01)).checks[0].passed
    assert latency(old, new, rows[:, : len(PAPER_TABLE)], LIMITS, clock=Steps(0.01)).checks[0].passed


def test_size_is_held_against_the_champion_and_against_a_limit(tmp_path):
    small, large = contender(tmp_path / "a"), contender(tmp_path / "b", of_paper=GOOD_OF_PAPER)
    assert small.size_bytes == sum(f.stat().st_size for f in (tmp_path / "a").glob("*.onnx"))
    assert size(large, small, LIMITS).passed
    assert not size(large, small, replace(LIMITS, allowance_bytes=0, worse_size_ratio=1.1)).passed
    assert not size(large, None, replace(LIMITS, most_bytes=100)).passed

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.training.study.generalise.road_drives import drives_on_roads
from training.study.folds import rows_by_name
from training.study.generalise.doubt import best_threshold, intervals, told_apart_frac
from training.study.generalise.held_out import HeldOut


def judged(*, spread=0.1, seed=1, roads_count=60):
    runs = drives_on_roads(roads_count)
    rows = rows_by_name(runs)
    rng = np.random.default_rng(seed)
    expected = rng.uniform(0.02, 2.0 * spread, len(rows))
    mu = runs.labels["label_mu"][rows] * np.exp(expected * rng.standard_normal(len(rows)))
    fold = np.arange(len(rows)) % 8
    return HeldOut(runs, rows, fold, mu, expected)


def classless(found):
    return np.zeros(len(found), dtype=np.intp)


@pytest.mark.parametrize("coverage_frac", [0.5, 0.9])
def test_intervals_hold_as_often_as_asked_whatever_their_scale(coverage_frac):
    found = judged()
    for scale in (np.ones(len(found)), found.expected_error_ratio):
        placed = intervals(found, scale_ratio=scale, class_number=classless(found), coverage_frac=coverage_frac)
        assert placed.holds.mean() == pytest.approx(coverage_frac, abs=0.04)


def test_only_the_right_scale_holds_in_every_part():
    found = judged()
    sure = found.expected_error_ratio < 0.06
    plain, scaled = (
        intervals(found, scale_ratio=scale, class_number=classless(found), coverage_frac=0.9)
        for scale in (np.ones(len(found)), found.expected_error_ratio)
    )
    assert plain.holds[sure].mean() > 0.97
    assert scaled.holds[sure].mean() == pytest.approx(0.9, abs=0.06)


def test_classes_repair_a_scale_that_is_wrong():
    found = judged()
    classes = np.searchsorted([0.06, 0.12], found.expected_error_ratio)
    placed = intervals(found, scale_ratio=np.ones(len(found)), class_number=classes, coverage_frac=0.9)
    for number in range(3):
        assert placed.holds[classes == number].mean() == pytest.approx(0.9, abs=0.07)


def test_a_class_of_few_goes_by_all_others():
    found = judged()
    classes = (np.arange(len(found)) < 5).astype(np.intp)
    placed = intervals(found, scale_ratio=np.ones(len(found)), class_number=classes, coverage_frac=0.9)
    alone = intervals(found, scale_ratio=np.ones(len(found)), class_number=classless(found), coverage_frac=0.9)
    assert placed.half_width_ratio[:5].tolist() == alone.half_width_ratio[:5].tolist()


def test_passages_of_ones_own_fold_have_no_say():
    found = judged()
    here = found.fold == 0
    lost = np.where(here, 50.0, found.mu)
    strange = HeldOut(found.runs, found.rows, found.fold, lost, found.expected_error_ratio)
    widths = [
        intervals(one, scale_ratio=np.ones(len(one)), class_number=classless(one), coverage_frac=0.9).half_width_ratio
        for one in (found, strange)
    ]
    assert widths[0][here].tolist() == widths[1][here].tolist()
    assert widths[1][~here].min() > widths[0][~here].max()


def test_a_threshold_parts_what_can_be_parted():
    signal = np.concatenate([np.linspace(0.0, 1.0, 200), np.linspace(2.0, 3.0, 100)])
    wanted = np.arange(300) >= 200
    assert 0.97 <= best_threshold(signal, wanted) < 2.05
    assert told_apart_frac(signal, wanted) == 1.0
    assert told_apart_frac(-signal, wanted) == 0.0


def test_where_none_are_wanted_none_are_found():
    signal = np.array([0.1, 0.5, 0.3])
    nobody = np.zeros(3, dtype=np.bool_)
    assert best_threshold(signal, nobody) == 0.5
    assert np.isnan(told_apart_frac(signal, nobody))


@given(st.lists(st.tuples(st.integers(0, 5), st.booleans()), min_size=2, max_size=30))
def test_telling_apart_counts_pairs_and_halves_of_ties(pairs):
    signal, wanted = np.array([float(x) for x, _ in pairs]), np.array([y for _, y in pairs])
    if wanted.all() or not wanted.any():
        return
    compared = signal[wanted][:, None] - signal[~wanted]
    counted = np.mean((compared > 0.0) + 0.5 * (compared == 0.0))
    assert told_apart_frac(signal, wanted) == pytest.approx(counted)

"""Batches: what is drawn, and what the errors of a rule are."""

import numpy as np
import pytest

from rsu_app.domain.interval import MEDIAN_TYRE_RATIO
from training.study.batches import (
    Cell,
    cells_of,
    drawn_batches,
    errors_by_cell,
    errors_of_cell,
    published_rule,
    worst_cell,
)

CELL = Cell("bend", 0.5, np.arange(40))


def test_cells_part_the_rows_by_road_and_friction():
    roads = ["b", "a", "a", "b", "a"]
    base_mu = np.array([0.2, 0.3, 0.2, 0.2 + 1e-9, 0.2])
    cells = cells_of(roads, base_mu, rows=np.array([0, 1, 2, 3]))
    found = [(cell.road, cell.base_friction_mu, cell.rows.tolist()) for cell in cells]
    assert found == [("a", 0.2, [2]), ("a", 0.3, [1]), ("b", 0.2, [0, 3])]


def test_a_batch_holds_rows_of_its_cell_alone():
    batches = drawn_batches(np.random.default_rng(1), np.array([3, 5, 9]), size_count=7, batches_count=11)
    assert batches.shape == (11, 7)
    assert set(batches.ravel().tolist()) == {3, 5, 9}


def test_a_perfect_rule_has_no_error():
    errors = errors_of_cell(CELL, lambda _rows: MEDIAN_TYRE_RATIO * 0.5, size_count=10, batches_count=20, seed=1)
    assert errors.mean_ratio == errors.p95_ratio == errors.worst_ratio == errors.bias_ratio == 0.0
    assert errors.answered_frac == 1.0


def test_errors_are_relative_to_the_midpoint():
    errors = errors_of_cell(CELL, lambda _rows: 0.8 * MEDIAN_TYRE_RATIO * 0.5, size_count=10, batches_count=20, seed=1)
    assert errors.bias_ratio == pytest.approx(-0.2)
    assert errors.worst_ratio == pytest.approx(0.2)


def test_statistics_are_ordered():
    labels = 0.5 * np.random.default_rng(2).uniform(0.8, 1.0, 40)
    errors = errors_of_cell(CELL, published_rule(labels), size_count=5, batches_count=200, seed=1)
    assert abs(errors.bias_ratio) <= errors.mean_ratio <= errors.p95_ratio <= errors.worst_ratio


def test_every_rule_sees_the_same_batches():
    seen: list[list[list[int]]] = [[], []]

    def watching(which: int):
        def rule(rows: np.ndarray) -> float:
            seen[which].append(rows.tolist())
            return 0.4

        return rule

    for which in (0, 1):
        errors_of_cell(CELL, watching(which), size_count=3, batches_count=5, seed=4)
    assert seen[0] == seen[1]


def test_what_a_rule_does_not_answer_is_said():
    half = errors_of_cell(
        CELL, lambda rows: 0.45 if rows[0] % 2 else float("nan"), size_count=1, batches_count=400, seed=1
    )
    assert 0.3 < half.answered_frac < 0.7
    assert half.worst_ratio == pytest.approx(0.0)
    silent = errors_of_cell(CELL, lambda _rows: float("nan"), size_count=1, batches_count=4, seed=1)
    assert silent.answered_frac == 0.0
    assert np.isnan(silent.worst_ratio)


def test_the_worst_cell_is_that_of_the_largest_percentile_and_silence_is_worse():
    def wrong_by(ratio: float):
        return lambda _rows: (1.0 + ratio) * MEDIAN_TYRE_RATIO * 0.5

    known = [
        errors_of_cell(Cell(name, 0.5, np.arange(3)), wrong_by(ratio), size_count=1, batches_count=2, seed=1)
        for name, ratio in (("good", 0.1), ("bad", -0.3))
    ]
    assert worst_cell(known).road == "bad"
    silent = errors_of_cell(
        Cell("silent", 0.5, np.arange(3)), lambda _rows: float("nan"), size_count=1, batches_count=2, seed=1
    )
    assert worst_cell([*known, silent]).road == "silent"


def test_the_published_rule_is_the_median():
    estimate_mu = np.array([0.30, 0.50, 0.35, np.nan])
    assert published_rule(estimate_mu)(np.array([0, 1, 2])) == pytest.approx(0.35)


def test_the_published_rule_nears_the_midpoint_with_the_number_of_vehicles():
    rng = np.random.default_rng(3)
    labels = 0.5 * rng.uniform(0.8, 1.0, 4000)
    cell = Cell("bend", 0.5, np.arange(4000))
    p95 = [
        errors_by_cell([cell], published_rule(labels), size_count=size, batches_count=300, seed=1)[0].p95_ratio
        for size in (1, 10, 100)
    ]
    assert p95[0] > p95[1] > p95[2]

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from training.study.generalise.passages import Passages, Traffic, drawn_passages
from training.study.generalise.rules import (
    KAPLAN_MEIER,
    MEDIAN,
    POLICY,
    POSTERIOR,
    REFINED,
    RULES,
    interval_of,
    refined_or_nothing_mu,
    relative_errors,
    rule_on_rows,
)


@pytest.mark.parametrize("name", RULES)
def test_every_rule_comes_near_the_truth_with_many_honest_vehicles(rng, name):
    passages = drawn_passages(rng, 3000, mu_new=0.6, traffic=Traffic(outlier_frac=0.0))
    assert RULES[name](passages) == pytest.approx(0.54, rel=0.01)


@pytest.mark.parametrize("name", RULES)
def test_every_rule_answers_one_vehicle_and_bounds_alone(name):
    one = Passages(np.array([0.4]), np.array([0.05]), np.array([False]))
    assert RULES[name](one) == pytest.approx(0.4, rel=0.03)
    bounds = Passages(np.array([0.3, 0.35]), np.array([0.05, 0.05]), np.array([True, True]))
    assert RULES[name](bounds) == pytest.approx(0.325, rel=0.01)


def test_only_bounds_are_no_answer_where_none_is_asked_for():
    bounds = Passages(np.array([0.3, 0.35]), np.array([0.05, 0.05]), np.array([True, True]))
    assert np.isnan(refined_or_nothing_mu(bounds))


def test_without_passages_there_is_no_interval():
    with pytest.raises(ValueError, match="no passages"):
        interval_of(Passages(np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool)), policy=POLICY)


def test_a_rule_on_rows_sees_those_rows():
    passages = Passages(np.array([0.2, 0.4, 0.6]), np.full(3, 0.05), np.zeros(3, dtype=bool))
    assert rule_on_rows(RULES[MEDIAN], passages)(np.array([1, 2, 2])) == 0.6


def errors_of(name, traffic, count=30):
    draw = partial(drawn_passages, count=count, mu_new=0.5, traffic=traffic)
    return relative_errors(RULES[name], draw, mu_new=0.5, seeds=np.arange(300))


def test_without_bounds_both_medians_are_the_same():
    assert errors_of(MEDIAN, Traffic()) == pytest.approx(errors_of(KAPLAN_MEIER, Traffic()))


def test_what_knows_the_errors_does_better_than_the_median():
    by_rule = {name: np.abs(errors_of(name, Traffic())).mean() for name in (MEDIAN, POSTERIOR, REFINED)}
    assert by_rule[POSTERIOR] < 0.8 * by_rule[MEDIAN]
    assert by_rule[REFINED] < 0.8 * by_rule[MEDIAN]


def test_a_bound_taken_for_an_estimate_pulls_the_median_down():
    shy = Traffic(shy_frac=0.6)
    assert errors_of(MEDIAN, shy).mean() < -0.04
    assert abs(errors_of(KAPLAN_MEIER, shy).mean()) < 0.015

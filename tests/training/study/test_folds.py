from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.training.runs import made_up_runs, shuffled
from tests.training.study.desk import Desk
from training.dataset import DatasetError
from training.study.folds import (
    cross_validated,
    fold_numbers,
    learner,
    paper_estimates,
    recipe_fold_mape_ratio,
    road_folds,
    rows_by_name,
    side_by_side,
    split_by_scenario,
)
from training.study.generalise.features import BestByGain
from training.study.recipes import BEST_RECIPE, PAPER_RECIPE, Boosted, Recipe
from vehicle_client.simulator.plan import SensorGrade


def learned_mean(features, label_mu):
    """Learn nothing but the mean: cheap, and it shows who was learned from."""
    mean_mu = label_mu.mean()
    return lambda rows: np.full(len(rows), mean_mu)


def nearest(features, label_mu):
    """Learn by heart: a row that was learned from is known exactly."""
    return lambda rows: label_mu[np.abs(features[None, :, 0] - rows[:, 0, None]).argmin(axis=1)]


MEAN = Recipe("mean", ("steer_mean_rad",), learned_mean)


@given(st.integers(8, 300), st.integers(2, 8), st.integers(0, 100))
def test_folds_hold_every_row_once_and_differ_by_one_at_most(rows_count, folds_count, seed):
    sizes = np.bincount(fold_numbers(rows_count, folds_count, seed=seed), minlength=folds_count)
    assert sizes.sum() == rows_count
    assert sizes.max() - sizes.min() <= 1


def test_the_split_takes_a_tenth_of_every_scenario_and_no_failed_run():
    runs = made_up_runs(900)
    split = split_by_scenario(runs, seed=1)
    both = np.concatenate([split.train_rows, split.test_rows])
    assert sorted(both.tolist()) == np.flatnonzero(runs.usable).tolist()
    for name in split.scenarios:
        of_all = len(split.scenario_rows(both, name))
        assert len(split.scenario_rows(split.test_rows, name)) == round(0.1 * of_all)


def test_the_split_follows_the_runs_not_their_order():
    runs = made_up_runs(300)
    other = shuffled(runs, seed=4)
    one, two = split_by_scenario(runs, seed=1), split_by_scenario(other, seed=1)
    assert [runs.run_key[i] for i in one.test_rows] == [other.run_key[i] for i in two.test_rows]
    assert [runs.run_key[i] for i in one.train_rows] == [other.run_key[i] for i in two.train_rows]


def test_scenarios_are_mixed_in_the_rows_to_learn_from():
    split = split_by_scenario(made_up_runs(300), seed=1)
    names = [split.runs.scenario[i] for i in split.train_rows]
    assert sum(a != b for a, b in pairwise(names)) > len(names) / 3


def test_a_handful_of_runs_is_not_split():
    with pytest.raises(DatasetError, match="cannot be split"):
        split_by_scenario(made_up_runs(6), seed=1)


def test_nobody_is_judged_by_who_has_seen_him():
    rng = np.random.default_rng(0)
    features, label_mu = rng.normal(size=(80, 1)), rng.uniform(0.2, 0.7, 80)
    judged = cross_validated(nearest, features, label_mu, seed=1)
    assert (judged.estimate_mu != label_mu).all()
    assert np.isin(judged.estimate_mu, label_mu).all()


def test_each_fold_has_its_own_figure():
    label_mu = np.linspace(0.2, 0.7, 64)
    judged = cross_validated(learned_mean, np.zeros((64, 1)), label_mu, seed=3)
    assert judged.fold_mape_ratio.shape == (8,)
    sizes = np.bincount(judged.fold)
    pooled = np.mean(np.abs(judged.label_mu - judged.estimate_mu) / judged.label_mu)
    assert np.average(judged.fold_mape_ratio, weights=sizes) == pytest.approx(pooled)


def test_an_error_in_one_job_ends_them_all():
    def fail():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        side_by_side([fail] * 5)


def test_all_rows_of_a_road_are_judged_together():
    names = [f"road-{i % 24}" for i in range(200)]
    folds = road_folds(names, seed=1)
    assert len({(name, fold) for name, fold in zip(names, folds.tolist(), strict=True)}) == 24
    assert len(set(folds.tolist())) == 8


def test_rows_come_by_name_whatever_their_order():
    runs = made_up_runs(60)
    other = shuffled(runs, seed=4)
    names = [runs.run_key[i] for i in rows_by_name(runs).tolist()]
    assert names == [other.run_key[i] for i in rows_by_name(other).tolist()]
    assert len(names) == runs.usable.sum()


@pytest.mark.parametrize("recipe", [PAPER_RECIPE, BEST_RECIPE])
def test_only_a_rough_answer_takes_coarser_bins(recipe):
    usual, rough = (learner(Desk(quick=quick), recipe.learn) for quick in (False, True))
    assert usual is recipe.learn
    assert isinstance(usual, Boosted)
    assert isinstance(rough, Boosted)
    assert replace(rough, parameters=usual.parameters) == usual
    assert rough.parameters.bins_count < usual.parameters.bins_count


def test_a_learner_within_another_takes_coarser_bins_too():
    rough = learner(Desk(quick=True), BestByGain(BEST_RECIPE.learn, 20))
    assert rough == BestByGain(learner(Desk(quick=True), BEST_RECIPE.learn), 20)


def test_only_the_first_rows_are_judged_if_some_are_asked_for():
    desk = Desk()
    few = recipe_fold_mape_ratio(desk, SensorGrade.IDEAL, MEAN, rows_count=40)
    assert not np.array_equal(few, recipe_fold_mape_ratio(desk, SensorGrade.IDEAL, MEAN))
    assert len(desk.worked) == 2


def test_estimates_by_strangers_stand_where_their_runs_stand():
    runs = made_up_runs(200)
    order = np.random.default_rng(1).permutation(len(runs))
    estimates = paper_estimates(Desk({"paper": runs}), SensorGrade.IDEAL, recipe=MEAN)
    elsewhere = paper_estimates(Desk({"paper": runs.rows(order)}), SensorGrade.IDEAL, recipe=MEAN)
    assert np.array_equal(np.isfinite(estimates), runs.usable)
    assert np.array_equal(estimates[order], elsewhere, equal_nan=True)


def test_what_was_estimated_once_is_remembered_by_grade_and_features():
    desk = Desk()
    for grade in SensorGrade:
        for features in (("steer_mean_rad",), ("speed_mean_mps",)):
            for _ in range(2):
                paper_estimates(desk, grade, features=features, recipe=MEAN)
    assert len(desk.worked) == 4


def test_recipes_of_one_name_and_other_features_are_not_confused():
    desk = Desk()
    recipe_fold_mape_ratio(desk, SensorGrade.IDEAL, MEAN)
    recipe_fold_mape_ratio(desk, SensorGrade.IDEAL, replace(MEAN, features=("speed_mean_mps",)))
    assert len(desk.worked) == 2

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from training.fit_parameters import FitParameters, Target
from training.study.recipes import BEST_RECIPE, FIRST_GUESS, PAPER_FIT, PAPER_RECIPE, Boosted, Recipe, mends_first_guess


def learned_by_a_function(features, label_mu):
    return lambda rows: np.zeros(len(rows))


def test_the_papers_recipe_is_a_hundred_trees_of_six_levels():
    assert (PAPER_FIT.trees_count, PAPER_FIT.depth_count, len(PAPER_RECIPE.features)) == (100, 6, 78)


def test_recipes_have_one_key_as_long_as_nothing_changes():
    same = Recipe("paper", tuple(PAPER_RECIPE.features), Boosted(replace(PAPER_FIT)))
    assert same.key == PAPER_RECIPE.key


@pytest.mark.parametrize(
    "other",
    [
        replace(PAPER_RECIPE, name="another"),
        replace(PAPER_RECIPE, features=PAPER_RECIPE.features[1:]),
        replace(PAPER_RECIPE, learn=Boosted(replace(PAPER_FIT, depth_count=5))),
        replace(PAPER_RECIPE, learn=Boosted(PAPER_FIT, relative=True)),
        replace(PAPER_RECIPE, learn=learned_by_a_function),
    ],
)
def test_the_key_changes_with_whatever_changes_the_regressor(other):
    assert other.key != PAPER_RECIPE.key


def test_a_closure_is_no_learner():
    with pytest.raises(TypeError, match="no learner"):
        _ = replace(PAPER_RECIPE, learn=lambda features, label_mu: lambda rows: rows[:, 0]).key


@pytest.mark.parametrize("learn", [Boosted(FitParameters(target=Target.LOG_MU)), Boosted(PAPER_FIT, relative=True)])
def test_relative_errors_count_alike_where_they_are_asked_to(learn):
    # Two truths that the features cannot tell apart: squares ask for their mean, relative squares for less.
    label_mu = np.tile([0.2, 0.8], 200)
    estimate = learn(np.zeros((400, 1)), label_mu)(np.zeros((1, 1)))[0]
    assert estimate == pytest.approx(np.sqrt(0.16) if not learn.relative else 0.2353, abs=0.005)


def test_what_mends_a_first_guess_keeps_it_first_whatever_else_it_learns_from():
    other = BEST_RECIPE.on(("speed_mean_mps", FIRST_GUESS), name="two")
    assert other.features == (FIRST_GUESS, "speed_mean_mps")
    assert other.learn == BEST_RECIPE.learn


def test_without_the_first_guess_the_same_way_of_learning_starts_from_nothing():
    assert not mends_first_guess(BEST_RECIPE.on(("speed_mean_mps",)).learn)


def test_a_first_guess_in_the_wrong_place_is_no_recipe():
    with pytest.raises(ValueError, match="first feature"):
        replace(BEST_RECIPE, features=("speed_mean_mps", FIRST_GUESS))

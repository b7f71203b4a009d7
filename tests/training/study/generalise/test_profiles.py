from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import NEWEST_TABLE, PROFILE_FLOOR
from tests.training.study.desk import Desk
from tests.training.study.generalise.road_drives import FEW, SMALL_BEST, drives_on_roads
from training.dataset import joined
from training.study.batches import Cell
from training.study.chapter import Claim
from training.study.generalise import held_out, profiles
from training.study.generalise.passages import Passages
from training.study.generalise.pooling import BOUNDED
from training.study.generalise.rules import MEDIAN
from training.study.recipes import PAPER_RECIPE
from vehicle_client.simulator.plan import SensorGrade

GRADE = SensorGrade.AUTOMOTIVE


def with_profiles(runs):
    """The drives with the likelihood that their best friction and its width stand for."""
    features = runs.features.copy()
    best, width = (
        features[:, NEWEST_TABLE.index(name), None] for name in ("grip_all_best_mu", "grip_all_above_1sd_ratio")
    )
    falls = -0.5 * (np.log(profiles.GRID_MU / best) / np.maximum(width, 0.02)) ** 2
    falls -= falls.max(axis=1, keepdims=True)
    features[:, NEWEST_TABLE.columns(profiles.PROFILE_COLUMNS)] = np.maximum(falls, PROFILE_FLOOR)
    return replace(runs, features=features)


def crowded_roads():
    """Three roads with sixteen drives at each base friction."""
    parts = [drives_on_roads(3, seed=seed, shy_noise=0.3, prefix="other") for seed in range(16)]
    named = [replace(part, run_key=tuple(f"{i}/{key}" for key in part.run_key)) for i, part in enumerate(parts)]
    return with_profiles(joined(named))


@pytest.fixture(scope="module")
def result():
    desk = Desk(
        data_sets={
            "random-roads": with_profiles(drives_on_roads(40, shy_noise=0.3)),
            "random-roads-two-frictions": with_profiles(drives_on_roads(4, shy_noise=0.3, seed=9, prefix="two")),
            "random-roads-batches": crowded_roads(),
        }
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(profiles, "QUICK_BATCHES_COUNT", 4)
        patch.setattr(held_out, "EXPECTED_ERROR", FEW)
        patch.setattr(profiles, "CONFIGS", {"best": SMALL_BEST, "paper_config": replace(PAPER_RECIPE, learn=FEW)})
        found = profiles.CHAPTER.compute(desk, GRADE)
        yield found, profiles.CHAPTER.verdict({GRADE: found})


def test_every_rule_is_judged_with_ten_and_with_fifty(result):
    figures = result[0].figures
    for rule in (profiles.FLOOR, *profiles.COMPARED):
        for size in profiles.SIZES_COUNT:
            assert 0.0 <= figures[f"best.{rule}.{size}.bias_mean"] <= figures[f"best.{rule}.{size}.bias_worst"]
            assert np.isfinite(figures[f"best.{rule}.{size}.worst_p95"])


def test_likelihoods_without_a_bias_add_up_to_less_than_answers_do(result):
    figures = result[0].figures
    assert figures[f"best.{profiles.PROFILES}.50.bias_mean"] < figures[f"best.{MEDIAN}.50.bias_mean"]
    assert figures[f"best.{profiles.LIKELIHOOD}.50.bias_mean"] < figures[f"best.{MEDIAN}.50.bias_mean"]


def test_the_headline_is_that_of_the_estimator_chosen_beforehand(result):
    figures = result[0].figures
    for config in ("best", "paper_config"):
        assert (
            figures[f"headline.{config}.interval50_worst_unseen"] == figures[f"{config}.{profiles.CHOSEN}.50.worst_p95"]
        )
        assert (
            figures[f"headline.{config}.interval50_worst_unseen_median"] == figures[f"{config}.{MEDIAN}.50.worst_p95"]
        )


def test_the_half_width_is_held_against_the_truth(result):
    for size in profiles.SIZES_COUNT:
        assert 0.5 < result[0].figures[f"best.half_width.{size}.held_frac"] <= 1.0


def test_tables_are_whole(result):
    assert all(len(row) == len(table.columns) for table in result[0].tables for row in table.rows)


def test_where_a_friction_is_named_all_rules_are_judged_on_the_same_batches(result):
    figures = result[0].figures
    for size in profiles.SIZES_COUNT:
        named = {figures[f"best.named.{rule}.{size}.answered_frac"] for rule in profiles.NAMED}
        assert len(named) == 1
        assert 0.0 < named.pop() <= 1.0


def test_bounds_are_counted_where_too_few_name_a_friction():
    cell = Cell("bend", 0.5, np.arange(20))
    for bound, held in ((0.4, 1.0), (0.7, 0.0)):
        told = Passages(np.full(20, bound), np.full(20, 0.3), at_least=np.ones(20, dtype=np.bool_))
        assert profiles.bounds_held_frac(told, (cell,), size_count=10, batches_count=4, seed=1) == held
    sure = Passages(np.full(20, 0.45), np.full(20, 0.02), at_least=np.zeros(20, dtype=np.bool_))
    assert np.isnan(profiles.bounds_held_frac(sure, (cell,), size_count=10, batches_count=4, seed=1))


def test_the_verdict_follows_the_figures(result):
    found, told = result
    assert told.claim is Claim.NOT_CLAIMED
    figures = {
        **found.figures,
        f"best.{profiles.CHOSEN}.50.worst_p95": 0.4321,
        f"best.named.{BOUNDED}.50.worst_p95": 0.0765,
    }
    text = profiles.CHAPTER.verdict({GRADE: replace(found, figures=figures)}).text
    assert "43.2 % (automotive) by the regressor's likelihoods" in text
    assert "7.65 % (automotive) in the worst cell" in text


def test_the_verdict_says_so_where_nothing_is_named(result):
    name = f"best.named.{BOUNDED}.50"
    nothing = {f"{name}.answered_frac": 0.0, f"{name}.mean": np.nan, f"{name}.worst_p95": np.nan}
    figures = {**result[0].figures, **nothing, "best.bound.50.held_frac": np.nan}
    text = profiles.CHAPTER.verdict({GRADE: replace(result[0], figures=figures)}).text
    assert "names no friction." in text
    assert "nan" not in text

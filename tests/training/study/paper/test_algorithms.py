from __future__ import annotations

import numpy as np
import pytest

from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from tests.training.study.results import assert_presentable, with_figures
from training.study.chapter import Claim, Result
from training.study.learners import (
    Constant,
    GradientBoosting,
    Perceptron,
    RandomForest,
    SupportVectors,
    XgboostForest,
)
from training.study.paper import algorithms
from training.study.paper.algorithms import BOOSTED, CHAPTER, EVERYWHERE, FEW_ROWS_ONLY, ORDER
from vehicle_client.simulator.plan import SensorGrade


@pytest.fixture(scope="module")
def law():
    """Return rows in units far apart, and a friction that follows from the one with the small numbers."""
    rng = np.random.default_rng(0)
    features = np.column_stack([rng.normal(0.0, 1e-3, 300), rng.normal(5000.0, 300.0, 300)])
    return features, 0.45 + 0.2 * np.tanh(1000.0 * features[:, 0])


@pytest.mark.parametrize(
    "learn",
    [SupportVectors(), Perceptron(), Perceptron((30, 30)), RandomForest(), GradientBoosting(), XgboostForest()],
)
def test_every_algorithm_learns_a_law_whatever_the_units(law, learn):
    features, label_mu = law
    estimate = learn(features[:250], label_mu[:250])(features[250:])
    assert np.mean(np.abs(estimate - label_mu[250:]) / label_mu[250:]) < 0.1


def test_one_number_for_all_is_the_one_of_least_relative_error():
    label_mu = np.array([0.2, 0.25, 0.3, 0.6, 0.7, 0.7])
    best = Constant()(np.zeros((6, 1)), label_mu)(np.zeros((1, 1)))[0]
    errors = {mu: np.mean(np.abs(label_mu - mu) / label_mu) for mu in np.linspace(0.15, 0.75, 601)}
    assert np.mean(np.abs(label_mu - best) / label_mu) <= min(errors.values()) + 1e-12


@pytest.fixture(scope="module")
def result() -> Result:
    chosen = {name: learn for name, learn in EVERYWHERE.items() if name in {BOOSTED, "no feature"}}
    with pytest.MonkeyPatch.context() as patch:
        # The slow ones are learners like any other.
        patch.setattr(
            algorithms, "EVERYWHERE", {**EVERYWHERE, **dict.fromkeys(set(EVERYWHERE) - set(chosen), Constant())}
        )
        patch.setattr(algorithms, "FEW_ROWS_ONLY", dict.fromkeys(FEW_ROWS_ONLY, Constant()))
        return CHAPTER.compute(Desk({"paper": made_up_runs(200)}), SensorGrade.IDEAL)


def test_the_chapter_is_presentable(result):
    assert_presentable(result)
    assert [row[0] for row in result.tables[0].rows[: len(ORDER)]] == list(ORDER)


def test_trees_that_learn_beat_a_number_for_all(result):
    assert result.figures[f"median_mape.all.{BOOSTED}"] < result.figures["median_mape.all.no feature"]
    assert result.figures["headline.paper_config.cv_median_mape"] == result.figures[f"median_mape.all.{BOOSTED}"]


@pytest.mark.parametrize(
    ("boosted_mape", "others_mape", "claim"),
    [
        (0.0168, 0.0284, Claim.CONFIRMED),
        (0.05, 0.08, Claim.PARTLY),
        (0.0168, 0.015, Claim.PARTLY),
        (0.05, 0.04, Claim.NOT_CONFIRMED),
    ],
)
def test_the_verdict_follows_the_figures(result, boosted_mape, others_mape, claim):
    figures = {name: others_mape for name in result.figures if name.startswith("median_mape.")}
    figures |= {f"median_mape.{rows}.{BOOSTED}": boosted_mape for rows in ("few", "all")}
    verdict = CHAPTER.verdict(with_figures(result, figures))
    assert verdict.claim is claim
    assert "speed alone" in verdict.text

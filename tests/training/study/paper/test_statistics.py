from __future__ import annotations

import pytest

from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from tests.training.study.results import FEW_TREES_RECIPE, assert_presentable, with_figures
from training.study.chapter import Claim, Result
from training.study.paper import statistics
from training.study.paper.statistics import ALL, CHAPTER, CHOSEN, MEANS, QUANTS, SHAPE
from training.study.paper_features import PAPER_FEATURES
from vehicle_client.simulator.plan import SensorGrade


@pytest.fixture(scope="module")
def result() -> Result:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(statistics, "PAPER_RECIPE", FEW_TREES_RECIPE)
        patch.setattr(statistics, "selected_features", lambda bench, grade: PAPER_FEATURES[:15])
        return CHAPTER.compute(Desk({"paper": made_up_runs(150)}), SensorGrade.IDEAL)


def test_the_chapter_is_presentable(result):
    assert_presentable(result)


def test_formats_are_made_of_seven_signals(result):
    assert result.sizes[f"features, {MEANS}"] == 2 * 7
    assert result.sizes[f"features, {QUANTS}"] == 7 * 7
    assert result.sizes[f"features, {SHAPE}"] == 2 * 7


@pytest.mark.parametrize(
    ("mape", "claim"),
    [
        ({ALL: 0.03, MEANS: 0.05, QUANTS: 0.04, CHOSEN: 0.025, SHAPE: 0.1}, Claim.CONFIRMED),
        ({ALL: 0.02, MEANS: 0.05, QUANTS: 0.04, CHOSEN: 0.025, SHAPE: 0.1}, Claim.PARTLY),
        ({ALL: 0.02, MEANS: 0.03, QUANTS: 0.04, CHOSEN: 0.05, SHAPE: 0.1}, Claim.NOT_CONFIRMED),
    ],
)
def test_the_verdict_follows_the_figures(result, mape, claim):
    verdict = CHAPTER.verdict(with_figures(result, {f"median_mape.{name}": value for name, value in mape.items()}))
    assert verdict.claim is claim
    assert "speed alone" in verdict.text

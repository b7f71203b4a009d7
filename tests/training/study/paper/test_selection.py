from __future__ import annotations

import numpy as np
import pytest

from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from tests.training.study.results import FEW_TREES_RECIPE, assert_presentable, with_figures
from training.study.chapter import Claim, Result
from training.study.feature_selection import Selected
from training.study.paper import selection
from training.study.paper.selection import CHAPTER, idle_count
from vehicle_client.simulator.plan import SensorGrade


def first_ones(bench, grade, candidates):
    """Choose what comes first, the last road feature of those there are as number twelve."""
    names = (*candidates[:11], candidates[-1], *candidates[11:29])
    return Selected(names, np.linspace(0.1, 0.03, 30))


@pytest.fixture(scope="module")
def result() -> Result:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "PAPER_RECIPE", FEW_TREES_RECIPE)
        patch.setattr(selection, "selection", first_ones)
        return CHAPTER.compute(Desk({"paper": made_up_runs(150)}), SensorGrade.IDEAL)


def test_the_chapter_is_presentable(result):
    assert_presentable(result)
    assert len(result.tables[0].rows) == 30


def test_it_is_told_where_the_road_comes_in_and_what_both_searches_share(result):
    assert result.figures["first_road_feature"] == 12
    assert result.figures["shared.10"] == 10
    assert result.figures["shared.15"] == 14


def test_the_headline_is_the_median_with_fifteen(result):
    assert result.figures["headline.paper_config.sfs15_mape"] == result.figures["median_mape.road.15"]


def test_choices_that_bring_nothing_are_counted():
    assert idle_count(Selected(("a", "b", "c", "d"), np.array([0.3, 0.2, 0.2, 0.25])), 4) == 2
    assert idle_count(Selected(("a", "b", "c", "d"), np.array([0.3, 0.2, 0.2, 0.25])), 2) == 0


@pytest.mark.parametrize(
    ("fifteen_mape", "thirty_mape", "first_road", "claim"),
    [
        (0.025, 0.025, 11.0, Claim.CONFIRMED),
        (0.05, 0.048, 11.0, Claim.PARTLY),
        (0.05, 0.03, 2.0, Claim.NOT_CONFIRMED),
    ],
)
def test_the_verdict_follows_the_figures(result, fifteen_mape, thirty_mape, first_road, claim):
    figures = {
        "median_mape.road.15": fifteen_mape,
        "median_mape.road.30": thirty_mape,
        "first_road_feature": first_road,
    }
    verdict = CHAPTER.verdict(with_figures(result, figures))
    assert verdict.claim is claim
    assert "speed alone" in verdict.text

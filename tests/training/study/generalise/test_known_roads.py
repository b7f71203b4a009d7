"""The best regressor on known roads gives the headlines that the summary asks for, and a verdict by the figures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.training.study.desk import Desk
from tests.training.study.generalise.road_drives import FEW, SMALL_BEST
from tests.training.study.results import assert_presentable, with_figures
from training.study import feature_selection
from training.study.generalise import known_roads
from training.study.recipes import PAPER_FIT, Recipe
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL
NAMES = SMALL_BEST.features[:16]


@pytest.fixture(scope="module")
def results():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(feature_selection, "QUICK_SEARCH_ROWS_COUNT", 60)
        patch.setattr(feature_selection, "QUICK_SEARCH_FIT", replace(PAPER_FIT, trees_count=2, depth_count=1))
        few = {"paper_config": Recipe("paper", NAMES, FEW), "best": Recipe("best", NAMES, FEW)}
        patch.setattr(known_roads, "CONFIGS", few)
        return {IDEAL: known_roads.compute(Desk(), IDEAL)}


def test_it_gives_the_best_regressors_headlines_and_no_others(results):
    result = results[IDEAL]
    assert_presentable(result)
    headlines = {name for name in result.figures if name.startswith("headline.")}
    assert headlines == {f"headline.best.{name}" for name in known_roads.MEASURES}
    assert all(0.0 < result.figures[name] < 0.5 for name in headlines)


@pytest.mark.parametrize(("best", "words"), [(0.01, "regressor gains"), (0.03, "does not always gain")])
def test_the_verdict_follows_the_figures(results, best, words):
    figures = {"best.cv_median_mape": best, "paper_config.cv_median_mape": 0.02}
    assert words in known_roads.verdict({IDEAL: with_figures(results[IDEAL], figures)[IDEAL]}).text

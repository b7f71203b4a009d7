from __future__ import annotations

import numpy as np
import pytest

from tests.training.study.desk import Desk
from tests.training.study.generalise.road_drives import SMALL_BEST, drives_on_roads, road_desk
from tests.training.study.results import FEW_TREES_RECIPE, assert_presentable, with_figures
from training.dataset import DatasetError
from training.study.generalise import learning_curve
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL
CURVES = {
    "paper_config": FEW_TREES_RECIPE,
    "paper_features": FEW_TREES_RECIPE,
    "best": SMALL_BEST,
}


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learning_curve, "CURVES", CURVES)
        patch.setattr(learning_curve, "ROADS_COUNTS", (4, 12, 500))
        return learning_curve.compute(road_desk(), IDEAL)


def test_more_roads_err_less_and_all_there_are_come_last(result):
    counts = [row[0] for row in result.tables[0].rows]
    assert counts == [4, 12, 38]
    assert result.figures["mape.best.38"] < result.figures["mape.best.4"]
    assert_presentable(result)


def test_nobody_learns_from_the_roads_he_is_judged_on(result):
    assert result.sizes["roads judged on"] + result.sizes["roads learned from, at most"] == 48


def test_a_single_road_makes_no_curve():
    with pytest.raises(DatasetError, match="too few"):
        learning_curve.compute(Desk(data_sets={"random-roads": drives_on_roads(1)}), IDEAL)


def test_the_last_doubling_is_told_between_the_counts_there_are():
    counts = np.array([10.0, 100.0, 400.0])
    assert learning_curve.last_doubling_frac(counts, np.array([0.4, 0.2, 0.1])) == pytest.approx(1.0 / 3.0)
    assert learning_curve.last_doubling_frac(counts, np.full(3, 0.2)) == pytest.approx(0.0)


def test_the_verdict_follows_the_figures(result):
    hungry = learning_curve.verdict(with_figures(result, {"last_doubling.best": 0.2})).text
    assert "would help further" in hungry
    full = learning_curve.verdict(
        with_figures(result, {"last_doubling.best": 0.01, "most.paper_features": 0.2, "least.best": 0.1})
    ).text
    assert "would hardly help" in full
    assert "no number of such roads" in full

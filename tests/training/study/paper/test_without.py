from __future__ import annotations

import pytest

from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from tests.training.study.results import FEW_TREES_RECIPE, assert_presentable, with_figures
from training.study.chapter import Claim, Result
from training.study.paper import without
from training.study.paper.without import (
    CHAPTER,
    NEITHER,
    NO_SIDESLIP,
    NO_SPEED,
    ONLY_SPEED,
    SPEED_AND_ROAD,
    WHOLE,
    told_frac,
    variants,
)
from training.study.paper_features import PAPER_FEATURES, signal_of
from vehicle_client.simulator.plan import SensorGrade


@pytest.fixture(scope="module")
def result() -> Result:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(without, "PAPER_RECIPE", FEW_TREES_RECIPE)
        patch.setattr(without, "selected_features", lambda bench, grade: PAPER_FEATURES[:15])
        return CHAPTER.compute(Desk({"paper": made_up_runs(200)}), SensorGrade.IDEAL)


def test_signals_are_taken_away_whole():
    left = variants(PAPER_FEATURES)
    assert {signal_of(name) for name in left[NO_SPEED]} == {signal_of(name) for name in PAPER_FEATURES} - {"speed"}
    assert not {"sideslip", "sideslip_rate"} & {signal_of(name) for name in left[NO_SIDESLIP]}
    assert len(left[WHOLE]) == len(left[NO_SPEED]) + len(left[ONLY_SPEED])
    assert len(left[SPEED_AND_ROAD]) == 11 + 23
    assert len(left[NEITHER]) == 78 - 33


def test_a_set_that_nothing_is_left_of_is_missing():
    assert ONLY_SPEED not in variants(("steer_mean_rad", "sideslip_mean_rad"))
    assert NO_SPEED not in variants(("speed_mean_mps",))


def test_what_some_features_tell_lies_between_nothing_and_everything():
    assert told_frac(nothing_mape_ratio=0.3, some_mape_ratio=0.3, all_mape_ratio=0.1) == 0.0
    assert told_frac(nothing_mape_ratio=0.3, some_mape_ratio=0.2, all_mape_ratio=0.1) == pytest.approx(0.5)
    assert told_frac(nothing_mape_ratio=0.3, some_mape_ratio=0.1, all_mape_ratio=0.1) == pytest.approx(1.0)


def test_the_chapter_is_presentable(result):
    assert_presentable(result)


@pytest.mark.parametrize(
    ("no_speed_mape", "told", "claim"),
    [(0.051, 0.1, Claim.CONFIRMED), (0.051, 0.8, Claim.PARTLY), (0.09, 0.8, Claim.NOT_CONFIRMED)],
)
def test_the_verdict_follows_the_figures(result, no_speed_mape, told, claim):
    figures = {
        f"median_mape.78.{WHOLE}": 0.05,
        f"median_mape.78.{NO_SPEED}": no_speed_mape,
        "speed_tells_frac": told,
    }
    verdict = CHAPTER.verdict(with_figures(result, figures))
    assert verdict.claim is claim
    assert "nothing but the speed" in verdict.text

from __future__ import annotations

import pytest

from tests.training.study.generalise.road_drives import FEW, SMALL_BEST, road_desk
from tests.training.study.results import assert_presentable, with_figures
from training.study.generalise import held_out as judging
from training.study.generalise import uncertainty
from training.study.generalise.held_out import held_out
from training.study.generalise.uncertainty import SCALED
from training.table_models import COVERAGE_FRAC
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judging, "EXPECTED_ERROR", FEW)
        patch.setattr(uncertainty, "BEST_RECIPE", SMALL_BEST)
        return uncertainty.compute(road_desk(), IDEAL)


@pytest.fixture
def judged(monkeypatch):
    monkeypatch.setattr(judging, "EXPECTED_ERROR", FEW)
    return held_out(road_desk(), IDEAL, SMALL_BEST)


def test_intervals_hold_the_truth_as_often_as_asked(result):
    for name in uncertainty.ways_of(held_out(road_desk(), IDEAL, SMALL_BEST)):
        assert result.figures[f"held.{name}"] == pytest.approx(COVERAGE_FRAC, abs=0.06)
    assert_presentable(result)


def test_doubtful_are_above_all_those_that_used_little(result):
    figures = result.figures
    assert figures["at_least.of_shy"] > figures["at_least.of_others"] + 0.2
    assert figures["at_least_by_use.of_shy"] > figures["at_least_by_use.of_others"] + 0.5
    assert figures["bound.held"] > COVERAGE_FRAC


def test_what_is_said_holds_in_every_group(result):
    figures = result.figures
    assert figures["stated.held"] >= COVERAGE_FRAC - 1e-9
    assert COVERAGE_FRAC - 0.2 < figures["stated.held_in_worst_group"] <= figures["stated.held"]


def test_keeping_those_that_seem_sure_errs_less_and_an_oracle_least(result):
    figures = result.figures
    least, most = figures["kept_mape.the errors"], figures["kept_mape.nothing"]
    assert least < figures[f"kept_mape.{uncertainty.REGRESSOR}"] < most


def test_what_is_recommended_is_what_a_bundle_needs(judged):
    advice = uncertainty.recommended(judged)
    assert advice.coverage_frac == COVERAGE_FRAC
    low = [
        advice.mu_low(mu, expected_error_ratio=expected)
        for mu, expected in zip(judged.mu.tolist(), judged.expected_error_ratio.tolist(), strict=True)
    ]
    assert (low <= judged.label_mu).mean() > COVERAGE_FRAC
    expected = judged.expected_error_ratio
    assert expected.min() < advice.doubtful_above_ratio < expected.max()


def test_the_verdict_follows_the_figures(result):
    right = {"calibration.worst_ratio": 1.1, f"held_in_worst_band.{SCALED}": 0.89}
    assert "is about what is found" in uncertainty.verdict(with_figures(result, right)).text
    wrong = {"calibration.worst_ratio": 2.0, f"held_in_worst_band.{SCALED}": 0.6}
    text = uncertainty.verdict(with_figures(result, wrong)).text
    assert "is not what is found" in text
    assert "but not whatever share" in text
    other = uncertainty.verdict(with_figures(result, {f"kept_mape.{uncertainty.WIDTH}": 0.0})).text
    assert f"{uncertainty.WIDTH} tells best" in other

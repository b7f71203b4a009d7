from __future__ import annotations

import numpy as np
import pytest

from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from tests.training.study.results import FEW_TREES_RECIPE, assert_presentable, with_figures
from training.study.chapter import Claim, Result
from training.study.paper import local_global
from training.study.paper.local_global import CHAPTER, band_residuals
from training.study.paper_features import PAPER_FEATURES
from vehicle_client.simulator.plan import SensorGrade


@pytest.fixture(scope="module")
def result() -> Result:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(local_global, "PAPER_RECIPE", FEW_TREES_RECIPE)
        patch.setattr(local_global, "selected_features", lambda bench, grade: PAPER_FEATURES[:15])
        return CHAPTER.compute(Desk({"paper": made_up_runs(600)}), SensorGrade.IDEAL)


def test_the_chapter_is_presentable(result):
    assert_presentable(result)


def test_the_worst_scenario_is_one_of_them(result):
    values = [result.figures[f"mape.78.global.{name}"] for name in "abc"]
    assert result.figures["headline.paper_config.known_worst_mape"] == max(values)
    assert result.figures["worst_mape.78.global"] == max(values)


def test_every_headline_has_the_speed_only_regressor_beside_it(result):
    headlines = {name.split(".")[2] for name in result.figures if name.startswith("headline.paper_config.")}
    assert headlines == {name.split(".")[2] for name in result.figures if name.startswith("headline.speed_only.")}


def test_residuals_in_bands_show_an_estimate_that_shrinks_to_the_middle():
    truth_mu = np.linspace(0.2, 0.7, 500)
    bands = band_residuals(truth_mu, 0.45 + 0.8 * (truth_mu - 0.45))
    means = [mean for _, mean, _, _ in bands]
    assert means[0] > 0.1
    assert means[-1] < -0.05
    assert means == sorted(means, reverse=True)
    assert sum(count for *_, count in bands) >= 490


def test_bands_of_a_few_runs_are_left_out():
    assert band_residuals(np.array([0.3, 0.31, 0.32]), np.array([0.3, 0.3, 0.3])) == []


GOOD = {
    "worst_mape.15.global": 0.03,
    "worst_mape.15.local": 0.02,
    "worst_mape.78.global": 0.03,
    "worst_mape.78.local": 0.02,
    "relative_rms.15.global.all scenarios": 0.04,
    "residual_skewness.15": 0.1,
    "residual_kurtosis.15": 0.2,
    "residual_worst_band_mean.15": 0.001,
    "residual_std.15": 0.04,
}
BAD = {
    "worst_mape.15.global": 0.2,
    "worst_mape.15.local": 0.1,
    "relative_rms.15.global.all scenarios": 0.3,
    "residual_skewness.15": 2.0,
}


@pytest.mark.parametrize(
    ("figures", "claim"),
    [
        (GOOD, Claim.CONFIRMED),
        ({**GOOD, "worst_mape.15.global": 0.2}, Claim.PARTLY),
        ({**GOOD, **BAD}, Claim.NOT_CONFIRMED),
    ],
)
def test_the_verdict_follows_the_figures(result, figures, claim):
    verdict = CHAPTER.verdict(with_figures(result, figures))
    assert verdict.claim is claim
    assert "speed alone" in verdict.text

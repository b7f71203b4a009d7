from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.training.study.desk import Desk
from tests.training.study.generalise.road_drives import FEW, SMALL_BEST, drives_on_roads, road_desk
from tests.training.study.results import FEW_TREES_RECIPE, assert_presentable, with_figures
from training.study.chapter import Claim
from training.study.generalise import held_out as judging
from training.study.generalise import unseen_roads
from training.study.generalise.held_out import held_out
from training.study.headlines import BESIDE, HEADLINES
from training.study.paper_features import SPEED_FEATURES
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL
CONFIGS = {
    "paper_config": FEW_TREES_RECIPE,
    "best": SMALL_BEST,
    "speed_only": replace(FEW_TREES_RECIPE, name="speed only", features=SPEED_FEATURES),
}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(judging, "EXPECTED_ERROR", FEW)
    monkeypatch.setattr(unseen_roads, "CONFIGS", CONFIGS)


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judging, "EXPECTED_ERROR", FEW)
        patch.setattr(unseen_roads, "CONFIGS", CONFIGS)
        return unseen_roads.compute(road_desk(), IDEAL)


@pytest.fixture
def judged():
    return held_out(road_desk(), IDEAL, SMALL_BEST)


def test_the_chapter_gives_every_headline_of_roads_never_seen(result):
    wanted = {headline.name for headline in HEADLINES if headline.name.startswith("unseen_roads")} | set(BESIDE)
    for config in CONFIGS:
        given = {name.rpartition(".")[2] for name in result.figures if name.startswith(f"headline.{config}.")}
        assert given == wanted - {"unseen_ringebu_mape"}
    assert_presentable(result)


def test_who_sees_the_inverse_is_better_than_who_does_not(result):
    figures = result.figures
    assert figures["headline.best.unseen_roads_mape"] < 0.6 * figures["headline.paper_config.unseen_roads_mape"]


def test_headlines_are_of_the_passages_they_name(judged):
    figures = unseen_roads.headline_figures(judged)
    assert figures["unseen_roads_mape"] == pytest.approx(judged.error_ratio.mean())
    assert figures["unseen_roads_coverage_80"] == pytest.approx(0.8, abs=0.003)
    used = judged.utilisation_ratio >= 0.6
    assert figures["unseen_roads_mape_util60"] == pytest.approx(judged.error_ratio[used].mean())
    assert figures["unseen_roads_mape_80"] < figures["unseen_roads_mape"] < figures["unseen_roads_p95_road"]


def test_keeping_all_passages_is_the_plain_error(judged):
    least, most = unseen_roads.selective_mape_ratio(judged, (0.3, 1.0))
    assert most == pytest.approx(judged.mape_ratio)
    assert least < most


def test_an_oracle_of_errors_keeps_the_best(judged):
    oracle = replace(judged, expected_error_ratio=judged.error_ratio)
    half = np.sort(judged.error_ratio)[: int(np.ceil(len(judged) / 2))]
    assert unseen_roads.selective_mape_ratio(oracle, (0.5,))[0] == pytest.approx(half.mean())


def test_a_road_counts_however_many_drive_it(judged):
    by_road = [
        np.mean([e for e, r in zip(judged.error_ratio, judged.roads, strict=True) if r == road])
        for road in set(judged.roads)
    ]
    assert unseen_roads.p95_road(judged) == pytest.approx(np.quantile(by_road, 0.95))


def test_a_bias_that_a_road_shares_is_told(judged):
    everywhere = replace(judged, mu=1.1 * judged.label_mu)
    assert unseen_roads.more_figures(everywhere)["road_bias_rms"] == pytest.approx(np.log(1.1))


def test_real_roads_are_judged_where_they_are_at_hand():
    sets = {**road_desk().data_sets, "ringebu": drives_on_roads(3, seed=9, prefix="ringebu")}
    found = unseen_roads.compute(Desk(data_sets=sets), IDEAL)
    assert found.figures["headline.best.unseen_ringebu_mape"] < 0.2
    assert "Ringebu it errs by" in unseen_roads.verdict({IDEAL: found}).text


def test_the_verdict_follows_the_figures(result):
    told = unseen_roads.verdict({IDEAL: result})
    assert told.claim is Claim.NOT_CLAIMED
    assert "not at hand" in told.text
    poor = unseen_roads.verdict(
        with_figures(
            result, {"headline.paper_config.unseen_roads_mape": 0.25, "headline.speed_only.unseen_roads_mape": 0.27}
        )
    )
    assert "is of little use" in poor.text
    assert "hardly better than" in poor.text
    well = unseen_roads.verdict(
        with_figures(
            result,
            {
                "headline.paper_config.unseen_roads_mape": 0.03,
                "headline.speed_only.unseen_roads_mape": 0.27,
                "headline.best.unseen_roads_mape": 0.04,
            },
        )
    )
    assert "may be of use" in well.text
    assert "no less" in well.text

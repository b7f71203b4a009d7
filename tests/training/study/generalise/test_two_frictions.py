"""Made-up drives whose inverse takes the middle of two frictions, and says of the slippery part what is true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import NEWEST_TABLE
from tests.training.study.desk import Desk
from tests.training.study.generalise.road_drives import FEW, SMALL_BEST, drives_on_roads
from tests.training.study.results import FEW_TREES_RECIPE, assert_presentable, with_figures
from training.dataset import Runs
from training.study.folds import LEARNED_SETS, RANDOM_ROADS_SET
from training.study.generalise import held_out as judging
from training.study.generalise import two_frictions
from training.study.generalise.two_frictions import BEST, ONE, TWO, UNIFORM, WHOLE, WITHOUT_PARTS, Way
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL
TAKEN_FOR = 1.4
"""How many times the lesser friction the inverse finds over all of such a drive."""
WAYS = {
    BEST: Way(SMALL_BEST, LEARNED_SETS),
    UNIFORM: Way(SMALL_BEST, (RANDOM_ROADS_SET,)),
    WHOLE: Way(SMALL_BEST.on(WITHOUT_PARTS, name="without parts"), LEARNED_SETS),
    two_frictions.PAPER: Way(FEW_TREES_RECIPE, LEARNED_SETS),
}


def drives(roads_count: int, *, two: bool, seed: int, prefix: str, per_road_count: int = 11) -> Runs:
    runs = drives_on_roads(roads_count, per_road_count=per_road_count, seed=seed, prefix=prefix, shy_noise=0.02)
    features, column = runs.features.copy(), NEWEST_TABLE.index
    shift = np.log(TAKEN_FOR) if two else 0.0
    features[:, column("grip_all_best_mu")] *= np.exp(shift)
    features[:, column("grip_parts_gain_ratio")] = 20.0 * two
    features[:, column("grip_weak_shift_ratio")] = -shift
    features[~runs.usable] = np.nan
    return replace(runs, features=features)


def paper_drives() -> Runs:
    one = drives(1, two=False, seed=3, prefix=ONE, per_road_count=66)
    two = drives(1, two=True, seed=4, prefix=TWO, per_road_count=66)
    return replace(
        one,
        features=np.vstack([one.features, two.features]),
        labels={name: np.concatenate([values, two.labels[name]]) for name, values in one.labels.items()},
        scenario=(ONE,) * len(one) + (TWO,) * len(two),
        section_id=(ONE,) * (len(one) + len(two)),
        outcome=one.outcome + two.outcome,
        run_key=one.run_key + two.run_key,
    )


@pytest.fixture(scope="module")
def result():
    desk = Desk(
        data_sets={
            "random-roads": drives(60, two=False, seed=1, prefix="road"),
            "random-roads-two-frictions": drives(24, two=True, seed=2, prefix="changing"),
            "paper": paper_drives(),
        }
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judging, "EXPECTED_ERROR", FEW)
        patch.setattr(two_frictions, "WAYS", WAYS)
        return two_frictions.compute(desk, IDEAL)


def test_the_chapter_can_be_shown(result):
    assert_presentable(result)
    assert result.sizes["roads of two frictions"] == 24


def test_who_knows_uniform_roads_alone_takes_a_road_of_two_frictions_for_a_better_one(result):
    figures = result.figures
    assert figures[f"{UNIFORM}.{TWO}.worst_bias"] > 0.3
    assert figures[f"{UNIFORM}.two.bias"] > 0.2


def test_with_such_roads_and_the_parts_the_lesser_friction_is_found(result):
    figures = result.figures
    assert figures[f"{BEST}.{TWO}.mape"] < 0.4 * figures[f"{UNIFORM}.{TWO}.mape"]
    assert figures[f"{BEST}.two.mape"] < 0.4 * figures[f"{UNIFORM}.two.mape"]


def test_without_the_parts_uniform_roads_pay_for_the_others(result):
    figures = result.figures
    assert figures[f"{WHOLE}.uniform.mape"] > 1.3 * figures[f"{BEST}.uniform.mape"]


def test_the_features_without_parts_are_all_the_others():
    assert len(WITHOUT_PARTS) == len(NEWEST_TABLE) - 8


def test_the_verdict_tells_the_gain_only_where_there_is_one(result):
    gained = two_frictions.verdict(dict.fromkeys(SensorGrade, result)).text
    assert "times less" in gained
    lost = with_figures(result, {f"{BEST}.{TWO}.mape": 0.5, f"{UNIFORM}.{TWO}.mape": 0.4})
    assert "times less" not in two_frictions.verdict(lost).text

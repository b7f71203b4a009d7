from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from roadgrip.features import FEATURE_NAMES
from tests.training.study.generalise.road_drives import FEW, SMALL_BEST, road_desk
from tests.training.study.results import assert_presentable, with_figures
from training.study.generalise import features
from training.study.generalise.features import ALL, FEWER_COUNTS, INVERSE, NO_INVERSE, PAPER, BestByGain, OneChannel
from training.study.paper_features import PAPER_FEATURES
from training.study.recipes import FIRST_GUESS, Recipe
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL
FEW_ROUNDS = replace(features.RANKING_FIT, trees_count=40, bins_count=16)


@pytest.fixture(scope="module")
def result():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(features, "BEST_RECIPE", SMALL_BEST)
        patch.setattr(features, "RANKING_FIT", FEW_ROUNDS)
        return features.compute(road_desk(), IDEAL)


def test_every_feature_belongs_to_everything_and_groups_hold_nothing_else():
    found = features.groups()
    assert found[ALL] == FEATURE_NAMES
    assert all(set(names) <= set(FEATURE_NAMES) and len(set(names)) == len(names) > 0 for names in found.values())
    assert found[PAPER] == PAPER_FEATURES


def test_what_is_not_of_the_inverse_and_what_is_make_up_everything():
    found = features.groups()
    assert set(found[NO_INVERSE]) | set(found[INVERSE]) == set(FEATURE_NAMES)
    assert not any(name.startswith("grip_") or "use" in name for name in found[NO_INVERSE])


def test_a_feature_that_a_newer_table_brings_is_part_of_everything():
    found = features.groups((*FEATURE_NAMES, "element_one_speed_mps", "grip_new_best_mu"))
    assert {"element_one_speed_mps", "grip_new_best_mu"} <= set(found[ALL])
    assert "element_one_speed_mps" in found[NO_INVERSE]
    assert "grip_new_best_mu" in found[INVERSE]


def test_the_best_columns_are_found_in_what_is_learned_from(monkeypatch):
    monkeypatch.setattr(features, "RANKING_FIT", FEW_ROUNDS)
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(300, 8))
    label = 0.5 * np.exp(0.2 * np.tanh(rows[:, 5]))
    assert features.columns_by_gain(rows, label)[0] == 5
    estimator = BestByGain(FEW, 1)(rows, label)
    blurred = rng.normal(size=rows.shape)
    blurred[:, 5] = rows[:, 5]
    assert estimator(blurred).tolist() == estimator(rows).tolist()


def test_a_channel_alone_knows_its_own_best_and_not_that_of_all():
    rng = np.random.default_rng(1)
    own, together = rng.uniform(0.2, 0.7, 200), rng.uniform(0.2, 0.7, 200)
    rows = np.column_stack([together, np.log(own / together), rng.normal(size=200)])
    other = np.column_stack([np.full(200, 0.3), np.log(own / 0.3), rows[:, 2]])
    estimator = OneChannel(FEW)(rows, own)
    assert np.abs(estimator(rows) / own - 1.0).mean() < 0.1
    assert estimator(other).tolist() == pytest.approx(estimator(rows).tolist(), rel=1e-3)


def test_only_single_channels_are_told_by_their_own_best():
    alone = {name for name, recipe in features.recipes().items() if isinstance(recipe.learn, OneChannel)}
    assert alone == {f"{PAPER} and {channel}" for channel in ("steering", "drift", "wheels")}
    assert all(features.recipes()[name].features[0] == FIRST_GUESS for name in alone)
    for name in alone:
        assert features.floats_counts(features.recipes()[name])[0] == len(features.groups()[name])


def test_recipes_of_different_counts_have_keys_of_their_own():
    keys = {Recipe("some", FEATURE_NAMES, BestByGain(FEW, count)).key for count in FEWER_COUNTS}
    assert len(keys) == len(FEWER_COUNTS)


def test_the_chapter_finds_what_carries_the_friction(result):
    figures = result.figures
    assert figures[f"mape.{ALL}"] < 0.6 * figures[f"mape.{PAPER}"]
    assert figures["place.grip_all_best_mu"] == 1.0
    assert_presentable(result)


def test_the_verdict_follows_the_figures(result):
    sizes = {f"mape.{features.fewer_name(count)}": 0.05 for count in FEWER_COUNTS}
    well = features.verdict(with_figures(result, {f"mape.{ALL}": 0.05, f"mape.{NO_INVERSE}": 0.2, **sizes})).text
    assert "what makes the difference" in well
    assert "With the best 20 alone" in well
    assert "at most a tenth more" in well
    poor = features.verdict(
        with_figures(result, {f"mape.{ALL}": 0.05, f"mape.{NO_INVERSE}": 0.05, **dict.fromkeys(sizes, 0.2)})
    ).text
    assert "is little" in poor
    assert "more than a tenth more" in poor
    steering = features.verdict(with_figures(result, {f"mape.{PAPER} and drift": 0.001})).text
    assert "channels drift alone" in steering

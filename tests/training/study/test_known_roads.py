from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from training.fit_parameters import FitParameters
from training.study.folds import paper_split
from training.study.known_roads import (
    global_estimates,
    known_relative_rms_ratio,
    known_worst_mape_ratio,
    local_estimates,
    scenario_mape_ratio,
)
from training.study.recipes import Boosted, Recipe
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL
NAMES = ("steer_mean_rad", "speed_mean_mps", "steer_std_rad")
TREES = Recipe("few trees", NAMES, Boosted(FitParameters(trees_count=20, learning_rate_ratio=0.3)))


def learned_mean(features, label_mu):
    mean_mu = label_mu.mean()
    return lambda rows: np.full(len(rows), mean_mu)


def scenarios_of_their_own_friction():
    """Return runs whose friction is told by the scenario alone: 0.2 in a, 0.4 in b, 0.8 in c."""
    runs = made_up_runs(600)
    label_mu = np.array([{"a": 0.2, "b": 0.4, "c": 0.8}[name] for name in runs.scenario])
    return replace(runs, labels={**runs.labels, "label_mu": label_mu})


def test_a_local_regressor_learns_from_its_own_scenario_only():
    desk = Desk({"paper": scenarios_of_their_own_friction()})
    split = paper_split(desk, IDEAL)
    mean = Recipe("mean", NAMES, learned_mean)
    assert local_estimates(desk, IDEAL, mean) == pytest.approx(split.label_mu(split.test_rows))
    assert np.ptp(global_estimates(desk, IDEAL, mean)) == 0.0


def test_the_worst_scenario_makes_the_headline():
    desk = Desk({"paper": scenarios_of_their_own_friction()})
    mean = Recipe("mean", NAMES, learned_mean)
    by_scenario = scenario_mape_ratio(paper_split(desk, IDEAL), global_estimates(desk, IDEAL, mean))
    assert max(by_scenario, key=lambda name: by_scenario[name]) == "a"
    assert known_worst_mape_ratio(desk, IDEAL, mean) == by_scenario["a"] == pytest.approx(4 / 3, abs=0.02)


def test_held_out_runs_are_harder_than_they_would_be_by_heart():
    assert known_relative_rms_ratio(Desk(), IDEAL, TREES) > 0.01

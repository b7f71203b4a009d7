from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from training.study.generalise import estimates as made
from training.study.generalise.estimates import (
    DOUBTFUL_ABOVE_RATIO,
    known_roads,
    road_folds,
    unseen_roads,
)
from training.study.paper_features import PAPER_FEATURES
from training.study.recipes import PAPER_FIT, PAPER_RECIPE, Boosted, Recipe
from vehicle_client.simulator.plan import SensorGrade

IDEAL = SensorGrade.IDEAL
FEW = Boosted(replace(PAPER_FIT, trees_count=8, depth_count=3, bins_count=16))
SMALL = replace(PAPER_RECIPE, name="small", learn=FEW)


@pytest.fixture(autouse=True)
def quick_expectations(monkeypatch):
    monkeypatch.setattr(made, "ERROR_LEARNER", FEW)


@dataclass(frozen=True, slots=True)
class ByHeart:
    """Knows every row it has seen, and says 0.3 of all others."""

    def __call__(self, features, label_mu):
        seen = {row.tobytes(): mu for row, mu in zip(features, label_mu, strict=True)}
        return lambda rows: np.array([seen.get(row.tobytes(), 0.3) for row in rows])


def desk():
    roads = made_up_runs(400, seed=5)
    named = replace(roads, section_id=tuple(f"road-{i % 24}" for i in range(400)))
    return Desk(data_sets={"paper": made_up_runs(300), "random-roads": named})


def test_all_rows_of_a_road_are_judged_together():
    names = [f"road-{i % 24}" for i in range(200)]
    folds = road_folds(names, seed=1)
    assert len({(name, fold) for name, fold in zip(names, folds.tolist(), strict=True)}) == 24
    assert len(set(folds.tolist())) == 8


@pytest.mark.parametrize("estimates", [known_roads, unseen_roads])
def test_nobody_judges_a_drive_he_has_seen(estimates):
    found = estimates(desk(), IDEAL, Recipe("by heart", PAPER_FEATURES, ByHeart()))
    assert found.passages.mu[found.rows].tolist() == [0.3] * len(found.rows)


@pytest.mark.parametrize("estimates", [known_roads, unseen_roads])
def test_every_run_with_a_summary_gets_an_estimate_and_its_expected_error(estimates):
    found = estimates(desk(), IDEAL, SMALL)
    assert found.rows.tolist() == np.flatnonzero(found.runs.usable).tolist()
    label_mu = found.runs.labels["label_mu"][found.rows]
    error = np.abs(np.log(found.passages.mu[found.rows] / label_mu))
    expected = found.passages.expected_error_ratio[found.rows]
    assert expected.mean() == pytest.approx(error.mean(), rel=0.4)
    assert (expected > 0.0).all()
    # Nineteen in twenty are asked for; the few random roads make it a rough figure.
    assert np.mean(found.bound_mu[found.rows] <= label_mu) > 0.85


def test_only_doubtful_estimates_become_bounds():
    found = known_roads(desk(), IDEAL, SMALL)
    expected = np.where(np.arange(len(found.runs)) % 2, 0.01, 2.0 * DOUBTFUL_ABOVE_RATIO)
    found = replace(found, passages=replace(found.passages, expected_error_ratio=expected))
    bounded, rows = found.with_bounds, found.rows
    assert bounded.at_least.tolist() == (expected > DOUBTFUL_ABOVE_RATIO).tolist()
    named = rows[rows % 2 == 1]
    assert bounded.mu[named].tolist() == found.passages.mu[named].tolist()
    assert (bounded.mu[rows[rows % 2 == 0]] <= found.passages.mu[rows[rows % 2 == 0]]).all()

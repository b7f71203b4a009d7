"""What ordinary drives look like goes into a bundle and is asked by the unit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roadgrip.features import NEWEST_TABLE
from roadgrip.records import NotCounted
from rsu_app.adapters.inference import load_bundle
from rsu_app.domain.plausibility import envelope_flag
from tests.training.runs import made_up_runs
from training.bundling import TableModel, write_models
from training.fit_parameters import FitParameters
from training.regressor import grow_trees
from training.study.envelopes import Ordinary, learn_whole_envelope

DRIVING = ("speed_mean_mps", "steer_mean_rad")
ROAD = ("section_length_m",)


def ordinary_rows() -> np.ndarray:
    """Drives on which more speed goes with less steering, to either side."""
    runs = made_up_runs(1300)
    rows = runs.features[runs.usable].copy()
    rng = np.random.default_rng(5)
    speed, steer = NEWEST_TABLE.columns(DRIVING)
    rows[:, speed] = rng.normal(15.0, 3.0, len(rows))
    turned = 0.01 * (25.0 - rows[:, speed]) + rng.normal(0.0, 0.003, len(rows))
    rows[:, steer] = turned * rng.choice([-1.0, 1.0], len(rows))
    return rows


def test_a_combination_no_driver_has_is_seen_through_the_bundle_and_not_by_the_box(tmp_path: Path):
    rows = ordinary_rows()
    label_mu = np.random.default_rng(1).uniform(0.2, 0.7, len(rows))
    roads = tuple(f"road-{i % 40}" for i in range(len(rows) - 600))
    ordinary = learn_whole_envelope(
        Ordinary(rows[:600], rows[600:], roads, NEWEST_TABLE.names), road_columns=ROAD, driving_columns=DRIVING, seed=1
    )
    made = TableModel(
        table=NEWEST_TABLE,
        friction=grow_trees(rows, label_mu, FitParameters(trees_count=5), threads_count=1),
        train_rows=rows[:-100],
        train_label_mu=label_mu[:-100],
        unseen_rows=rows[-100:],
        ordinary=ordinary,
    )
    write_models([made], tmp_path, name="test", metrics={}, provenance={}, rng=np.random.default_rng(3))
    model = load_bundle(tmp_path).manifest.models[0]
    assert model.ordinary is not None
    assert model.ordinary.road == ordinary.road
    assert np.array(model.ordinary.driving.whitening_ratio) == pytest.approx(
        np.array(ordinary.driving.whitening_ratio), rel=1e-6, abs=1e-6
    )
    assert np.mean([envelope_flag(row, model) == NotCounted.OUT_OF_ENVELOPE for row in rows]) < 0.08
    box_alone = replace(model, ordinary=None)
    usual = next(row for row in rows if envelope_flag(row, box_alone) == NotCounted.NONE)
    strange = usual.copy()
    strange[NEWEST_TABLE.columns(DRIVING)] = (19.0, -0.14)
    assert envelope_flag(strange, box_alone) == NotCounted.NONE
    assert envelope_flag(strange, model) == NotCounted.OUT_OF_ENVELOPE

"""Data sets for a laboratory that retrains in seconds: made-up drives on the paper's, random and one own road."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.training.many_roads import runs_of_many_roads
from training.data.data_shelf import DataCard, DataSet, add_data_set, training_sets
from training.dataset import LABEL_COLUMNS, Runs
from training.laboratory import Laboratory
from training.retraining.retrain import RetrainOptions

OWN_ROAD = "hill-bend"
QUICK = RetrainOptions(trees_count=20, depth_count=4)
QUICKEST = RetrainOptions(trees_count=5, depth_count=3, tables=(1,))
TOOLS = {"python": "3", "version.roadgrip": "0"}


def measured_runs(count: int, *, seed: int = 9) -> Runs:
    """Return drives on a road of one's own, of which nothing is known but the friction that was measured."""
    runs = runs_of_many_roads(count, seed=seed, first_road_number=90)
    unknown = {name: np.full(count, np.nan) for name in LABEL_COLUMNS}
    return replace(
        runs,
        labels={**unknown, "label_mu": runs.labels["label_mu"]},
        section_id=(OWN_ROAD,) * count,
        scenario=("measured",) * count,
        run_key=tuple(f"passage/{i:05d}" for i in range(count)),
    )


def simulated_set(lab: Laboratory, name: str, *, count: int = 900, seed: int = 0) -> DataCard:
    """Put simulated drives on the shelf."""
    return add_data_set(
        lab,
        runs_of_many_roads(count, seed=seed),
        name=name,
        kind="simulated",
        role="training",
        origin="made up",
        licence="any",
        label_kind="simulated friction",
        made_from={"sensor_grade": "automotive"},
        now_unix_s=seed,
    )


def measured_set(lab: Laboratory, name: str, *, count: int = 240) -> DataCard:
    """Put measured drives on the shelf."""
    runs = measured_runs(count)
    return add_data_set(
        lab,
        runs,
        name=name,
        kind="measured",
        role="training",
        origin="made up",
        licence="any",
        label_kind="trailer measurement",
        label_sd_mu=np.where(np.arange(count) % 2, 0.02, 0.1),
        now_unix_s=100.0,
    )


def data_of(lab: Laboratory, *names: str) -> list[DataSet]:
    """Return data sets of the shelf."""
    return training_sets(lab, names)


def unseen_show(title: str, steps_count: int) -> Callable[[int], None]:
    """Show progress to nobody."""
    assert title
    assert steps_count > 0
    return lambda _: None

"""Made-up drives on many roads, for chapters on roads never seen: a law that holds everywhere, a bias of each road."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from roadgrip.features import NEWEST_TABLE
from tests.training.runs import made_up_runs
from tests.training.study.desk import Desk
from training.dataset import COMPLETED, Runs
from training.study.recipes import BEST_RECIPE, PAPER_FIT, Boosted
from training.study.sources import no_runs

FEW = Boosted(replace(PAPER_FIT, trees_count=10, depth_count=3, bins_count=16))
SMALL_BEST = replace(BEST_RECIPE, learn=FEW)


def drives_on_roads(
    roads_count: int, *, per_road_count: int = 11, seed: int = 0, shy_noise: float = 0.1, prefix: str = "road"
) -> Runs:
    """Return drives whose friction the inverse sees the better, the more of the grip was used; some failed."""
    rng = np.random.default_rng(seed)
    count = roads_count * per_road_count
    road = np.repeat(np.arange(roads_count), per_road_count)
    base_mu = np.tile(np.linspace(0.2, 0.7, per_road_count), roads_count)
    label_mu = base_mu * rng.uniform(0.8, 1.0, count)
    use = rng.uniform(0.2, 1.0, count)
    bias = rng.normal(0.0, 0.02, roads_count)[road]
    noise = shy_noise * (1.2 - use)
    features = rng.normal(0.0, 0.1, (count, len(NEWEST_TABLE)))
    column = NEWEST_TABLE.index
    features[:, column("grip_all_best_mu")] = label_mu * np.exp(noise * rng.standard_normal(count) + bias)
    features[:, column("grip_all_above_1sd_ratio")] = noise
    features[:, column("grip_all_below_1sd_ratio")] = noise
    features[:, column("demand_q100_mu")] = use * label_mu
    features[:, column("demand_q100_use_ratio")] = use * label_mu / features[:, column("grip_all_best_mu")]
    features[:, column("section_length_m")] = rng.uniform(50.0, 600.0, roads_count)[road]
    features[:, column("curvature_max_1pm")] = 1.0 / rng.uniform(20.0, 300.0, roads_count)[road]
    features = np.clip(features, NEWEST_TABLE.minimum, NEWEST_TABLE.maximum)
    failed = np.arange(count) % 17 == 16
    features[failed] = np.nan
    labels = {**made_up_runs(count).labels, "label_mu": label_mu}
    labels |= {"peak_utilisation_ratio": use, "base_friction_mu": base_mu}
    names = tuple(f"{prefix}-{i:03d}" for i in road.tolist())
    return Runs(
        features=features,
        labels=labels,
        scenario=names,
        section_id=names,
        outcome=tuple("left_road" if bad else COMPLETED for bad in failed.tolist()),
        run_key=tuple(f"{prefix}/{i:05d}" for i in range(count)),
    )


@cache
def road_desk() -> Desk:
    """Return a desk with random roads, the paper's three, and no real ones; never changed but for its memory."""
    return Desk(
        data_sets={
            "random-roads": drives_on_roads(48),
            "random-roads-two-frictions": drives_on_roads(12, seed=6, prefix="two-frictions"),
            "paper": drives_on_roads(3, per_road_count=60, seed=5, prefix="paper"),
            "ringebu": no_runs(),
        }
    )

"""Made-up drives with base frictions, wear and roads, for chapters that need more than features and a label."""

from __future__ import annotations

import numpy as np

from roadgrip.features import NEWEST_TABLE
from training.dataset import COMPLETED, LABEL_COLUMNS, Runs
from training.study.paper.manoeuvres import ROAD_FEATURES

FRICTIONS_MU = (0.3, 0.5, 0.7)


def drives(
    roads: tuple[str, ...], *, per_cell_count: int, seed: int = 0, design: str = "paper", wild_ratio: float = 1.0
) -> Runs:
    """Return drives whose friction is to be seen in their features, some of them failed.

    Args:
        roads: Their names; each has features of its own.
        per_cell_count: Runs of each road at each base friction.
        seed: Of chance.
        design: Begins the names of the runs.
        wild_ratio: How far features lie out.
    """
    rng = np.random.default_rng(seed)
    cells = [(road, mu, i) for road in roads for mu in FRICTIONS_MU for i in range(per_cell_count)]
    count = len(cells)
    base_mu = np.array([mu for _, mu, _ in cells])
    wear = rng.uniform(0.8, 1.0, count)
    features = rng.normal(0.0, 0.1, (count, len(NEWEST_TABLE)))
    features[:, 0] += base_mu * wear
    road_features = {
        road: np.random.default_rng([seed, i]).uniform(-1.0, 1.0, len(ROAD_FEATURES)) for i, road in enumerate(roads)
    }
    columns = NEWEST_TABLE.columns(ROAD_FEATURES)
    features[:, columns] = [road_features[road] for road, _, _ in cells]
    features *= wild_ratio
    failed = np.arange(count) % 11 == 10
    features[failed] = np.nan
    labels = {name: np.zeros(count) for name in LABEL_COLUMNS} | {
        "label_mu": base_mu * wear,
        "base_friction_mu": base_mu,
        "wear_ratio": wear,
        "attempt_number": np.array([float(i) for _, _, i in cells]),
    }
    return Runs(
        features=features,
        labels=labels,
        scenario=tuple(road for road, _, _ in cells),
        section_id=tuple(road for road, _, _ in cells),
        outcome=tuple("left_road" if failed[i] else COMPLETED for i in range(count)),
        run_key=tuple(f"{design}/{road}/{mu:.2f}/{i:05d}" for road, mu, i in cells),
    )

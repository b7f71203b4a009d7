"""Made-up runs on the paper's roads and on random ones, by usual drivers and by such of any speed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from roadgrip.features import NEWEST_TABLE
from tests.training.runs import made_up_runs
from training.dataset import Runs
from training.designs import PAPER_ROADS

ROADS_COUNT = 20


def runs_of_many_roads(count: int, *, seed: int = 0, first_road_number: int = 0) -> Runs:
    """Return runs of which every third was driven on one of the paper's roads; each road has a geometry of its own."""
    runs = made_up_runs(count, seed=seed)
    roads = [f"random-{first_road_number + i:02d}" for i in range(ROADS_COUNT)]
    section_id = tuple(PAPER_ROADS[i // 3 % 3] if i % 3 == 0 else roads[i % ROADS_COUNT] for i in range(count))
    features = runs.features.copy()
    names = sorted(set(section_id))
    place = np.array([names.index(name) for name in section_id])
    road = NEWEST_TABLE.columns([feature.name for feature in NEWEST_TABLE.road])
    low, high = NEWEST_TABLE.minimum[road], NEWEST_TABLE.maximum[road]
    of_roads = low + (high - low) * np.random.default_rng(seed).uniform(0.4, 0.6, (len(names), len(road)))
    features[:, road] = np.where(np.isfinite(features[:, :1]), of_roads[place], np.nan)
    # What the inverse takes for the friction is near it; from nothing but noise no trees mend anything.
    (guess,) = NEWEST_TABLE.columns(["grip_all_best_mu"])
    features[:, guess] = np.where(
        np.isfinite(features[:, guess]),
        runs.labels["label_mu"] * np.random.default_rng(5).uniform(0.9, 1.1, count),
        np.nan,
    )
    scenario = tuple(f"{name}-any-speed" if i % 5 == 0 else name for i, name in enumerate(section_id))
    used = np.random.default_rng(7).uniform(0.2, 1.0, count)
    labels = {**runs.labels, "peak_utilisation_ratio": used}
    return replace(runs, features=features, labels=labels, section_id=section_id, scenario=scenario)

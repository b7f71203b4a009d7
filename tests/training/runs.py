"""Made-up runs whose friction follows from their features, for tests that need no simulator."""

from __future__ import annotations

import numpy as np

from roadgrip.features import NEWEST_TABLE, FeatureTable
from training.dataset import COMPLETED, LABEL_COLUMNS, Runs


def made_up_runs(count: int, *, seed: int = 0, table: FeatureTable = NEWEST_TABLE) -> Runs:
    """Return runs with a smooth law behind them and every tenth one failed."""
    rng = np.random.default_rng(seed)
    features = rng.normal(0.0, 0.1, (count, len(table)))
    label_mu = 0.45 + 0.2 * np.tanh(5.0 * features[:, 0] + 3.0 * features[:, 44])
    # A unit asks its model about nothing that no passage can have; the law is one of columns that clipping spares.
    features[:, 44] += 1.0
    features = np.clip(features, table.minimum, table.maximum)
    failed = np.arange(count) % 10 == 9
    features[failed] = np.nan
    labels = {name: np.ones(count) for name in LABEL_COLUMNS} | {"label_mu": label_mu}
    return Runs(
        features=features,
        labels=labels,
        scenario=tuple("abc"[i % 3] for i in range(count)),
        section_id=tuple("abc"[i % 3] for i in range(count)),
        outcome=tuple("left_road" if failed[i] else COMPLETED for i in range(count)),
        run_key=tuple(f"made-up/{i:05d}" for i in range(count)),
        table=table,
    )


def shuffled(runs: Runs, *, seed: int) -> Runs:
    """Return the same runs in another order."""
    order = np.random.default_rng(seed).permutation(len(runs))
    return runs.rows(order)

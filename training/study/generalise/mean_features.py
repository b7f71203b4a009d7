"""A regressor for what all vehicles of a window say together: asked once, about the mean of their features.

Noise of sensors and roughness averages out of the features before the regressor sees them, so it need not shy away from
them. But it must learn what such quiet features tell, and the drives it learns from come one per road and friction. On
one road, though, features change smoothly with friction: a parabola through a road's drives is nearly as quiet as the
mean of four vehicles at each.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from roadgrip.units import FloatArray
from training.study.recipes import Estimator, Learner

DEGREE_COUNT = 2
LEAST_DRIVES_COUNT = 7
"""On roads with fewer drives the parabola would follow their noise."""


def smoothed_features(features: FloatArray, *, label_mu: FloatArray, roads: Sequence[str]) -> FloatArray:
    """Return features as parabolas of ln friction, road by road; NaN on roads with too few drives. (n, columns)

    No parabola leaves the range of the road's drives.

    Args:
        features: (n, columns)
        label_mu: The friction that each drive found. (n,)
        roads: The road of each. (n,)
    """
    smoothed = np.full_like(features, np.nan)
    order = np.argsort(np.array(roads), kind="stable")
    _, starts = np.unique(np.array(roads)[order], return_index=True)
    for rows in np.split(order, starts[1:]):
        if len(rows) >= LEAST_DRIVES_COUNT:
            log_mu = np.log(label_mu[rows])
            powers = np.vander(log_mu - log_mu.mean(), DEGREE_COUNT + 1)
            parabolas = powers @ np.linalg.lstsq(powers, features[rows], rcond=None)[0]
            # A wild drive bends a parabola to where no feature can be, such as to a friction below zero.
            smoothed[rows] = np.clip(parabolas, features[rows].min(axis=0), features[rows].max(axis=0))
    return smoothed


def learned_for_windows(
    learn: Learner, features: FloatArray, *, label_mu: FloatArray, roads: Sequence[str]
) -> Estimator:
    """Return a regressor of the middle friction for mean features of a window; it knows single drives, too.

    Args:
        learn: How to learn.
        features: Of single drives. (n, columns)
        label_mu: What they found. (n,)
        roads: The road of each. (n,)
    """
    smoothed = smoothed_features(features, label_mu=label_mu, roads=roads)
    quiet = np.isfinite(smoothed).all(axis=1)
    return learn(np.vstack([smoothed[quiet], features]), np.concatenate([label_mu[quiet], label_mu]))

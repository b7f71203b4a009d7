"""Where a regressor may be believed: envelopes learned from ordinary drives alone, no manoeuvre among them.

Two questions, asked apart. Is the *road* like those that were learned from? That follows from the map, once for all
vehicles. Is the *driving* like that of ordinary drivers on any road? That is asked of every passage.

The limits are set by drives that the envelope in question has not seen: of random roads by whole roads, so that the
share of false flags that was asked for is that of the next road, not of the next car on a road that was learned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.mixture import GaussianMixture
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from roadgrip.bundle import Envelope, OrdinaryDriving
from roadgrip.envelope import DrivingEnvelope
from roadgrip.units import FloatArray
from rsu_app.domain.envelope import prepared, scaled_ratio, strangeness_level
from training.bundling import ROUNDING_RATIO

KINDS_COUNT = 4
"""Kinds of ordinary driving: 2 do hardly worse, 6 and more learn their roads by heart."""
FOLDS_COUNT = 4
MOST_ROWS_COUNT = 6000
"""Of known roads, and of random ones: a density of some thousand figures is not known better by more."""
KNOWN_FLAGGED_FRAC = 0.01
"""Share of ordinary drives on known roads that may be called strange."""
UNSEEN_FLAGGED_FRAC = 0.04
"""The same on roads of which nothing was learned, by envelopes of fewer roads: with all of them it becomes less."""
STRANGE_ROADS_FRAC = 0.01
"""Share of random roads that may be called strange."""
ROAD_MARGIN_FRAC = 0.05
"""Share of a feature's span by which a road may lie outside of those that were learned from."""
SCALED_CUT_RATIO = 5.0
_SCALE_TAIL_FRAC = 0.05
"""Features are scaled so that all but these shares of the drives lie within -1 and 1."""
_FLOOR_RATIO2 = 0.02
"""Added to every variance of scaled features, so that no kind is flat in any direction."""


@dataclass(frozen=True, slots=True)
class Ordinary:
    """Drives to learn an envelope from.

    Attributes:
        known_rows: Features of drives on roads whose next drives are to be ordinary. (n, features)
        unseen_rows: Features of drives on many roads that stand for any other. (m, features)
        unseen_road: The road of each of those. (m,)
        feature_names: Of the columns.
    """

    known_rows: FloatArray
    unseen_rows: FloatArray
    unseen_road: tuple[str, ...]
    feature_names: tuple[str, ...]

    def columns(self, names: Sequence[str]) -> Ordinary:
        """Return the same drives with some of their features."""
        places = [self.feature_names.index(name) for name in names]
        return Ordinary(self.known_rows[:, places], self.unseen_rows[:, places], self.unseen_road, tuple(names))


def learn_whole_envelope(
    drives: Ordinary, *, road_columns: Sequence[str], driving_columns: Sequence[str], seed: int
) -> OrdinaryDriving:
    """Return the envelope that ordinary drives span.

    Args:
        drives: What to learn from.
        road_columns: Features of the map.
        driving_columns: Features of the driving.
        seed: Chooses rows where there are too many, deals folds, starts the search for kinds.
    """
    roads = drives.columns(road_columns)
    return OrdinaryDriving(
        road_columns=tuple(road_columns),
        road=learn_road_box(np.unique(roads.known_rows, axis=0), np.unique(roads.unseen_rows, axis=0), seed=seed),
        driving=learn_driving_envelope(drives.columns(driving_columns), seed=seed),
    )


def learn_road_box(known_rows: FloatArray, random_rows: FloatArray, *, seed: int) -> Envelope:
    """Return the box that all given roads lie in, and how many features of another may lie outside of it.

    The number allowed is the smallest with which boxes of other random roads call at most `STRANGE_ROADS_FRAC` of
    the random ones strange.

    Args:
        known_rows: Features of known roads, one row a road. (n, features)
        random_rows: Features of random roads, at least `FOLDS_COUNT`. (m, features)
        seed: Deals folds.
    """
    fold = np.random.default_rng(seed).permutation(np.arange(len(random_rows)) % FOLDS_COUNT)
    outside_count = np.zeros(len(random_rows), dtype=np.intp)
    for k in range(FOLDS_COUNT):
        lower, upper = _edges(np.concatenate([known_rows, random_rows[fold != k]]))
        outside_count[fold == k] = ((random_rows[fold == k] < lower) | (random_rows[fold == k] > upper)).sum(axis=1)
    lower, upper = _edges(np.concatenate([known_rows, random_rows]))
    allowed_count = int(np.quantile(outside_count, 1.0 - STRANGE_ROADS_FRAC, method="higher"))
    return Envelope(tuple(lower.tolist()), tuple(upper.tolist()), allowed_count)


def _edges(roads: FloatArray) -> tuple[FloatArray, FloatArray]:
    low, high = roads.min(axis=0), roads.max(axis=0)
    # Features travel as 32-bit numbers: a length that never changes still differs by its rounding.
    margin = ROAD_MARGIN_FRAC * (high - low) + ROUNDING_RATIO * np.maximum(np.abs(low), np.abs(high))
    return low - margin, high + margin


def learn_driving_envelope(drives: Ordinary, *, seed: int) -> DrivingEnvelope:
    """Return the mixture of normal distributions that ordinary drives come from, and the limit of what is ordinary.

    The limit is the larger of two: beyond it lie `KNOWN_FLAGGED_FRAC` of the drives on known roads and
    `UNSEEN_FLAGGED_FRAC` of those on random ones, by mixtures that had not seen the drive, or the road.

    Args:
        drives: What to learn from; all their features are looked at.
        seed: As for `learn_whole_envelope`.
    """
    rng = np.random.default_rng(seed)
    known, unseen = _some(len(drives.known_rows), rng), _some(len(drives.unseen_rows), rng)
    known_values, unseen_values = drives.known_rows[known], drives.unseen_rows[unseen]
    road = np.array(drives.unseen_road)[unseen]
    names = rng.permutation(sorted(set(road.tolist())))
    fold_of_road = {name: i % FOLDS_COUNT for i, name in enumerate(names.tolist())}
    unseen_fold = np.array([fold_of_road[name] for name in road.tolist()], dtype=np.intp)
    known_fold = rng.permutation(np.arange(len(known_values)) % FOLDS_COUNT)
    known_level, unseen_level = np.empty(len(known_values)), np.empty(len(unseen_values))
    for k in range(FOLDS_COUNT):
        learned = np.concatenate([known_values[known_fold != k], unseen_values[unseen_fold != k]])
        fold = prepared(_mixture(learned, drives.feature_names, limit_level=np.inf, seed=seed), drives.feature_names)
        known_level[known_fold == k] = strangeness_level(known_values[known_fold == k], fold)
        unseen_level[unseen_fold == k] = strangeness_level(unseen_values[unseen_fold == k], fold)
    limit_level = max(
        float(np.quantile(known_level, 1.0 - KNOWN_FLAGGED_FRAC)),
        float(np.quantile(unseen_level, 1.0 - UNSEEN_FLAGGED_FRAC)),
    )
    everything = np.concatenate([known_values, unseen_values])
    return _mixture(everything, drives.feature_names, limit_level=limit_level, seed=seed)


def _some(count: int, rng: np.random.Generator) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    return np.sort(rng.permutation(count)[:MOST_ROWS_COUNT])


def _mixture(values: FloatArray, columns: tuple[str, ...], *, limit_level: float, seed: int) -> DrivingEnvelope:
    lower, upper = np.quantile(values, [_SCALE_TAIL_FRAC, 1.0 - _SCALE_TAIL_FRAC], axis=0)
    # A feature that hardly ever changes is taken in its own unit.
    lower, upper = np.where(upper > lower, [lower, upper], [lower - 1.0, upper + 1.0])
    scaled = np.clip(scaled_ratio(values, lower=lower, upper=upper), -SCALED_CUT_RATIO, SCALED_CUT_RATIO)
    # Matrices this small keep many threads waiting for each other, for twenty times the processor's time.
    with threadpool_limits(limits=1):
        mixture = GaussianMixture(KINDS_COUNT, reg_covar=_FLOOR_RATIO2, random_state=seed).fit(scaled)
    # Its factors P have P P' as the inverse of the covariance, so that P' whitens.
    whitening = np.swapaxes(mixture.precisions_cholesky_, 1, 2)
    return DrivingEnvelope(
        columns=columns,
        lower=tuple(lower.tolist()),
        upper=tuple(upper.tolist()),
        cut_ratio=SCALED_CUT_RATIO,
        share_frac=tuple(mixture.weights_.tolist()),
        middle_ratio=tuple(tuple(row) for row in mixture.means_.tolist()),
        whitening_ratio=tuple(tuple(tuple(row) for row in kind) for kind in whitening.tolist()),
        limit_level=limit_level,
    )

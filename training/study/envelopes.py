"""Where a regressor may be believed: envelopes learned from ordinary drives alone, no manoeuvre among them.

Two questions, asked apart. Is the *road* like those that were learned from? That follows from the map, once for all
vehicles. Is the *driving* like that of ordinary drivers on any road? That is asked of every passage.

The limits are set by drives that the envelope in question has not seen: of random roads by whole roads, so that the
share of false flags that was asked for is that of the next road, not of the next car on a road that was learned.

Its drives hold no manoeuvre. Its settings were chosen by other manoeuvres than any that it is judged by: by variants
of three kinds for the fourth (`training.manoeuvres.draw_manoeuvre`), in the same manner for each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from sklearn.mixture import GaussianMixture
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from roadgrip.bundle import Envelope, OrdinaryDriving
from roadgrip.envelope import DrivingEnvelope
from roadgrip.features import STATISTICS, FeatureTable
from roadgrip.units import FloatArray
from rsu_app.domain.envelope import prepared, scaled_ratio, strangeness_level
from training.bundling import ROUNDING_RATIO
from training.study.mirror import Mirror, mirror_of
from training.study.paper_features import statistic_of

KINDS_COUNT = 8
"""Kinds of ordinary driving, each to the left and to the right. With 4 the drives on other roads are clearly less
likely, with 12 hardly more so, and a unit asks each of them."""
FOLDS_COUNT = 4
LIMITING_FRAC = 0.25
"""Share of the drives, and of the random roads, that set the limit and are not learned from."""
MOST_ROWS_COUNT = 6000
"""Of known roads, and of random ones: a density of some thousand figures is not known better by more."""
KNOWN_FLAGGED_FRAC = 0.015
"""Share of ordinary drives on known roads whose driving may be called strange."""
UNSEEN_FLAGGED_FRAC = 0.04
"""The same on roads of which nothing was learned."""
STRANGE_ROADS_FRAC = 0.01
"""Share of random roads that may be called strange."""
ROAD_MARGIN_FRAC = 0.05
"""Share of a feature's span by which a road may lie outside of those that were learned from."""
SCALED_CUT_RATIO = 5.0
_SCALE_TAIL_FRAC = 0.05
"""Features are scaled so that all but these shares of the drives lie within -1 and 1."""
_FLOOR_RATIO2 = 0.02
"""Added to every variance of scaled features, so that no kind is flat in any direction. With less the next drives on
other roads are likelier, yet as many manoeuvres are found, and more drives of other cars are called strange."""
_DIGITS_COUNT = 7
"""Of a kind's figures: there are some ten thousand, and a bundle spells them out."""
_DEMAND_PREFIXES = ("demand_", "force_", "yaw_rate_max_")


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


def driving_columns(table: FeatureTable) -> tuple[str, ...]:
    """Return the features of a table by which driving is told from other driving.

    The statistics of the motion, and how much was asked of the road if the table tells: a bend driven at the limit
    differs from any other in little else. Not what the road seemed to give: more grip than ever is no other driving.
    """
    return tuple(
        feature.name
        for feature in table.kinematic
        if statistic_of(feature.name) in STATISTICS or feature.name.startswith(_DEMAND_PREFIXES)
    )


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

    A drive and its mirror image are as strange. The limit is the larger of two: beyond it lie `KNOWN_FLAGGED_FRAC` of
    the drives on known roads and `UNSEEN_FLAGGED_FRAC` of those on random ones, among drives and roads that were kept
    out of what was learned from.

    Args:
        drives: What to learn from; all their features are looked at.
        seed: As for `learn_whole_envelope`.
    """
    rng = np.random.default_rng(seed)
    known, unseen = _some(len(drives.known_rows), rng), _some(len(drives.unseen_rows), rng)
    known_values, unseen_values = drives.known_rows[known], drives.unseen_rows[unseen]
    road = np.array(drives.unseen_road)[unseen]
    names = rng.permutation(sorted(set(road.tolist())))
    limits_unseen = np.isin(road, names[: _limiting_count(len(names))])
    limits_known = rng.permutation(len(known_values)) < _limiting_count(len(known_values))
    learned = np.concatenate([known_values[~limits_known], unseen_values[~limits_unseen]])
    envelope = _mixture(learned, drives.feature_names, seed=seed)
    ready = prepared(envelope, drives.feature_names)
    limit_level = max(
        _limit(strangeness_level(known_values[limits_known], ready), beyond_frac=KNOWN_FLAGGED_FRAC),
        _limit(strangeness_level(unseen_values[limits_unseen], ready), beyond_frac=UNSEEN_FLAGGED_FRAC),
    )
    return replace(envelope, limit_level=limit_level)


def _limiting_count(count: int) -> int:
    return max(1, round(LIMITING_FRAC * count))


def _limit(level: FloatArray, *, beyond_frac: float) -> float:
    """Return the rank among one more, so that the next one lies beyond as seldom as asked; the largest if too few."""
    rank = min(int(np.ceil((1.0 - beyond_frac) * (len(level) + 1))), len(level))
    return float(np.sort(level)[rank - 1])


def _some(count: int, rng: np.random.Generator) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    return np.sort(rng.permutation(count)[:MOST_ROWS_COUNT])


def _mixture(values: FloatArray, columns: tuple[str, ...], *, seed: int) -> DrivingEnvelope:
    """Return a mixture of kinds and of their mirror images, without a limit."""
    mirror = mirror_of(columns)
    sided = mirror.to_one_side(values)
    both = np.concatenate([sided, mirror.of(sided)])
    lower, upper = np.quantile(both, [_SCALE_TAIL_FRAC, 1.0 - _SCALE_TAIL_FRAC], axis=0)
    # A feature that hardly ever changes is taken in its own unit.
    lower, upper = np.where(upper > lower, [lower, upper], [lower - 1.0, upper + 1.0])
    scaled = np.clip(scaled_ratio(sided, lower=lower, upper=upper), -SCALED_CUT_RATIO, SCALED_CUT_RATIO)
    # Matrices this small keep many threads waiting for each other, for twenty times the processor's time.
    with threadpool_limits(limits=1):
        mixture = GaussianMixture(KINDS_COUNT, reg_covar=_FLOOR_RATIO2, random_state=seed).fit(scaled)
    # Its factors P have P P' as the inverse of the covariance, so that P' whitens.
    share, middle, whitening = _with_mirror_images(
        mixture.weights_, mixture.means_, np.swapaxes(mixture.precisions_cholesky_, 1, 2), mirror
    )
    return DrivingEnvelope(
        columns=columns,
        lower=tuple(lower.tolist()),
        upper=tuple(upper.tolist()),
        cut_ratio=SCALED_CUT_RATIO,
        share_frac=tuple(share.tolist()),
        middle_ratio=tuple(_spelled(row) for row in middle),
        whitening_ratio=[[_spelled(row) for row in kind] for kind in whitening],
        limit_level=np.inf,
    )


def _with_mirror_images(
    share: FloatArray, middle: FloatArray, whitening: FloatArray, mirror: Mirror
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each kind with half of its share, and its mirror image with the other half; all features even: no image.

    Args:
        share: (k,)
        middle: (k, d)
        whitening: W of each. (k, d, d)
        mirror: Of the features.
    """
    if (mirror.sign_ratio > 0.0).all():
        return share, middle, whitening
    # |W (M x - m)| = |W M (x - M m)|, for M is its own inverse; its determinant may be -1, which a row's sign mends.
    image = whitening[:, :, mirror.partner] * mirror.sign_ratio[mirror.partner]
    image[:, 0] *= np.linalg.slogdet(image)[0][:, None]
    return (
        np.concatenate([share, share]) / 2.0,
        np.concatenate([middle, mirror.of(middle)]),
        np.concatenate([whitening, image]),
    )


def _spelled(figures: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{figure:.{_DIGITS_COUNT}g}") for figure in figures)

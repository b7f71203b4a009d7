"""How strange is a drive? A few kinds of ordinary driving, each a bell in many dimensions, and how far it is from all.

A box round every single feature does not see a combination that no ordinary drive has: as much steering at such a speed
with so little yaw. The density of a mixture of normal distributions does, and costs a unit a few thousand products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from roadgrip.bundle import Envelope, OrdinaryDriving
from roadgrip.envelope import DrivingEnvelope
from roadgrip.units import BoolArray, FloatArray

ROWS_AT_ONCE_COUNT = 512
"""Of so many rows the distances from all kinds are in memory at once: some 5 MB."""


@dataclass(frozen=True, slots=True)
class PreparedEnvelope:
    """A driving envelope as arrays, for many drives.

    Attributes:
        places: Where its columns stand in a row of features. (d,)
        lower: (d,)
        upper: (d,)
        cut_ratio: As in the record.
        whitening_ratio: Of all kinds beside each other. (d, k * d)
        middle_whitened_ratio: What becomes of the middle of each kind. (k * d,)
        height_level: Logarithm of share times density in the middle of each kind, of scaled features. (k,)
        limit_level: As in the record.
    """

    places: NDArray[np.intp]
    lower: FloatArray
    upper: FloatArray
    cut_ratio: float
    whitening_ratio: FloatArray
    middle_whitened_ratio: FloatArray
    height_level: FloatArray
    limit_level: float


def prepared(envelope: DrivingEnvelope, feature_names: Sequence[str]) -> PreparedEnvelope:
    """Return an envelope ready for rows of features in a given order.

    Args:
        envelope: As learned.
        feature_names: Of the columns of the rows.

    Raises:
        ValueError: The rows lack one of its columns.
    """
    place = {name: column for column, name in enumerate(feature_names)}
    missing = [name for name in envelope.columns if name not in place]
    if missing:
        raise ValueError(f"the driving envelope asks for {', '.join(missing)}, which a row does not have")
    whitening = np.asarray(envelope.whitening_ratio, dtype=np.float64)
    log_determinant = np.linalg.slogdet(whitening)[1]
    height_level = np.log(envelope.share_frac) + log_determinant - 0.5 * len(envelope.columns) * np.log(2.0 * np.pi)
    return PreparedEnvelope(
        places=np.array([place[name] for name in envelope.columns], dtype=np.intp),
        lower=np.asarray(envelope.lower, dtype=np.float64),
        upper=np.asarray(envelope.upper, dtype=np.float64),
        cut_ratio=envelope.cut_ratio,
        whitening_ratio=np.ascontiguousarray(whitening.reshape(-1, whitening.shape[2]).T),
        middle_whitened_ratio=np.einsum("kij,kj->ki", whitening, np.asarray(envelope.middle_ratio)).reshape(-1),
        height_level=np.asarray(height_level, dtype=np.float64),
        limit_level=envelope.limit_level,
    )


def scaled_ratio(rows: FloatArray, *, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return features scaled so that the range from `lower` to `upper` becomes -1 to 1. (n, d)"""
    scaled: FloatArray = (rows - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
    return scaled


def strangeness_level(rows: FloatArray, envelope: PreparedEnvelope) -> FloatArray:
    """Return minus the logarithm of the density of ordinary drives at each row: larger is stranger. (n,)

    Args:
        rows: Finite features, in the order the envelope was prepared for. (n, features)
        envelope: Ordinary driving.

    References:
        Bishop, Pattern Recognition and Machine Learning, section 9.2, Mixtures of Gaussians.
    """
    # Some rows after others, so that memory stays small for many.
    starts = range(0, len(rows), ROWS_AT_ONCE_COUNT)
    parts = [_strangeness_level(rows[start : start + ROWS_AT_ONCE_COUNT], envelope) for start in starts]
    return np.concatenate(parts) if parts else np.empty(0)


def _strangeness_level(rows: FloatArray, envelope: PreparedEnvelope) -> FloatArray:
    values = scaled_ratio(rows[:, envelope.places], lower=envelope.lower, upper=envelope.upper)
    np.clip(values, -envelope.cut_ratio, envelope.cut_ratio, out=values)
    # (n, k * d): one product for all kinds, since a few rows cost as many products as many.
    away = values @ envelope.whitening_ratio - envelope.middle_whitened_ratio
    squared = np.square(away, out=away).reshape(len(rows), len(envelope.height_level), -1).sum(axis=2)
    log_density = envelope.height_level - 0.5 * squared
    highest = log_density.max(axis=1)
    total: FloatArray = highest + np.log(np.exp(log_density - highest[:, None]).sum(axis=1))
    return -total


def is_strange(rows: FloatArray, envelope: PreparedEnvelope) -> BoolArray:
    """Return which rows are no ordinary drives; arguments as for `strangeness_level`. (n,)"""
    return np.asarray(strangeness_level(rows, envelope) > envelope.limit_level, dtype=np.bool_)


def outside_box(rows: FloatArray, box: Envelope) -> BoolArray:
    """Return which rows leave a box in more features than it allows. (n,)

    Args:
        rows: Features in the order of the box. (n, features)
        box: Where drives are expected.
    """
    outside = (rows < np.asarray(box.lower)) | (rows > np.asarray(box.upper))
    return np.asarray(outside.sum(axis=1) > box.outside_allowed_count, dtype=np.bool_)


def is_strange_road(rows: FloatArray, ordinary: OrdinaryDriving, feature_names: Sequence[str]) -> BoolArray:
    """Return which rows are of no road like those learned from. (n,)

    Args:
        rows: Finite features. (n, features)
        ordinary: Roads and driving that the model was made for.
        feature_names: Of the columns of the rows.
    """
    return outside_box(rows[:, _places(ordinary.road_columns, tuple(feature_names))], ordinary.road)


@lru_cache(maxsize=16)
def _places(wanted_names: tuple[str, ...], feature_names: tuple[str, ...]) -> NDArray[np.intp]:
    # Once for each model: looking names up takes longer than all that is asked of a single row.
    return np.array([feature_names.index(name) for name in wanted_names], dtype=np.intp)


def is_strange_driving(rows: FloatArray, ordinary: OrdinaryDriving, feature_names: Sequence[str]) -> BoolArray:
    """Return which rows are of no ordinary driving; arguments as for `is_strange_road`. (n,)"""
    return is_strange(rows, _prepared_once(ordinary.driving, tuple(feature_names)))


_KEPT_COUNT = 16
_kept: dict[tuple[int, tuple[str, ...]], tuple[DrivingEnvelope, PreparedEnvelope]] = {}
"""By identity, for an envelope has thousands of figures to compare; each is held, so that no other takes its place."""


def _prepared_once(envelope: DrivingEnvelope, feature_names: tuple[str, ...]) -> PreparedEnvelope:
    key = (id(envelope), feature_names)
    if key not in _kept:
        while len(_kept) >= _KEPT_COUNT:
            del _kept[next(iter(_kept))]
        _kept[key] = envelope, prepared(envelope, feature_names)
    return _kept[key][1]

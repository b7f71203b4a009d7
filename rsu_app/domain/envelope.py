"""How strange is a drive? A few kinds of ordinary driving, each a bell in many dimensions, and how far it is from all.

A box round every single feature does not see a combination that no ordinary drive has: as much steering at such a speed
with so little yaw. The density of a mixture of normal distributions does, and costs a unit a few thousand products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadgrip.units import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class DrivingEnvelope:
    """What ordinary driving looks like, as a manifest can hold it.

    Features are scaled so that the range from `lower` to `upper` becomes -1 to 1, and cut off at +-cut. Of each kind of
    driving there is a share, a middle, and a matrix W that turns the differences from the middle into independent ones
    of unit size.

    Attributes:
        columns: Names of the features that are looked at. (d,)
        lower: Value of each feature, in its unit, that becomes -1. (d,)
        upper: Value that becomes 1; above the lower one. (d,)
        cut_ratio: Largest magnitude of a scaled feature; what is further out counts as this far out.
        share_frac: How frequent each kind is; they sum to 1. (k,)
        middle_ratio: Scaled features in the middle of each kind. (k, d)
        whitening_ratio: W of each kind; its determinant is positive. (k, d, d)
        limit_level: Strangeness from which a drive counts as strange.
    """

    columns: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    cut_ratio: float
    share_frac: tuple[float, ...]
    middle_ratio: tuple[tuple[float, ...], ...]
    whitening_ratio: tuple[tuple[tuple[float, ...], ...], ...]
    limit_level: float

    def __post_init__(self) -> None:
        width, kinds = len(self.columns), len(self.share_frac)
        shapes = (np.shape(self.lower), np.shape(self.upper), np.shape(self.middle_ratio))
        if shapes != ((width,), (width,), (kinds, width)) or np.shape(self.whitening_ratio) != (kinds, width, width):
            raise ValueError(f"{kinds} kinds of driving in {width} features do not fit the sizes of their figures")
        if width == 0 or kinds == 0:
            raise ValueError("ordinary driving has at least one kind and one feature")
        figures = (self.lower, self.upper, self.share_frac, self.middle_ratio, self.whitening_ratio)
        if not all(np.isfinite(np.asarray(figure)).all() for figure in figures):
            raise ValueError("a figure of the driving envelope is not a finite number")
        if not (np.asarray(self.lower) < np.asarray(self.upper)).all():
            raise ValueError("a lower value of the driving envelope is not below the upper one")
        if min(self.share_frac) <= 0.0 or not self.cut_ratio > 0.0:
            raise ValueError("shares and the cut are positive")
        if any(sign <= 0.0 for sign, _ in map(np.linalg.slogdet, np.asarray(self.whitening_ratio))):
            raise ValueError("the matrix of a kind of driving has no positive determinant")


@dataclass(frozen=True, slots=True)
class PreparedEnvelope:
    """A driving envelope as arrays, for many drives.

    Attributes:
        places: Where its columns stand in a row of features. (d,)
        lower: (d,)
        upper: (d,)
        cut_ratio: As in the record.
        middle_ratio: (k, d)
        whitening_ratio: (k, d, d)
        height_level: Logarithm of share times density in the middle of each kind, of scaled features. (k,)
        limit_level: As in the record.
    """

    places: NDArray[np.intp]
    lower: FloatArray
    upper: FloatArray
    cut_ratio: float
    middle_ratio: FloatArray
    whitening_ratio: FloatArray
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
        middle_ratio=np.asarray(envelope.middle_ratio, dtype=np.float64),
        whitening_ratio=whitening,
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
    values = scaled_ratio(rows[:, envelope.places], lower=envelope.lower, upper=envelope.upper)
    values = np.clip(values, -envelope.cut_ratio, envelope.cut_ratio)
    # (n, k): one kind after another, so that memory stays small for many rows.
    log_density = np.column_stack(
        [
            height - 0.5 * np.square((values - middle) @ whitening.T).sum(axis=1)
            for height, middle, whitening in zip(
                envelope.height_level, envelope.middle_ratio, envelope.whitening_ratio, strict=True
            )
        ]
    )
    highest = log_density.max(axis=1)
    total: FloatArray = highest + np.log(np.exp(log_density - highest[:, None]).sum(axis=1))
    return -total


def is_strange(rows: FloatArray, envelope: PreparedEnvelope) -> BoolArray:
    """Return which rows are no ordinary drives; arguments as for `strangeness_level`. (n,)"""
    return np.asarray(strangeness_level(rows, envelope) > envelope.limit_level, dtype=np.bool_)

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

    A feature x is taken as z = (x - center) / spread, cut off at +-cut. Of each kind of driving there is a share, a
    middle, and a matrix W that turns the differences from the middle into independent ones of unit size.

    Attributes:
        columns: Names of the features that are looked at. (d,)
        center: Subtracted from each feature, in its unit. (d,)
        spread: Divides each, in its unit; positive. (d,)
        cut_ratio: Largest magnitude of a scaled feature; what is further out counts as this far out.
        share_frac: How frequent each kind is; they sum to 1. (k,)
        middle_ratio: Scaled features in the middle of each kind. (k, d)
        whitening_ratio: W of each kind; its determinant is positive. (k, d, d)
        limit_level: Strangeness from which a drive counts as strange.
    """

    columns: tuple[str, ...]
    center: tuple[float, ...]
    spread: tuple[float, ...]
    cut_ratio: float
    share_frac: tuple[float, ...]
    middle_ratio: tuple[tuple[float, ...], ...]
    whitening_ratio: tuple[tuple[tuple[float, ...], ...], ...]
    limit_level: float

    def __post_init__(self) -> None:
        width, kinds = len(self.columns), len(self.share_frac)
        shapes = (np.shape(self.center), np.shape(self.spread), np.shape(self.middle_ratio))
        if shapes != ((width,), (width,), (kinds, width)) or np.shape(self.whitening_ratio) != (kinds, width, width):
            raise ValueError(f"{kinds} kinds of driving in {width} features do not fit the sizes of their figures")
        if width == 0 or kinds == 0:
            raise ValueError("ordinary driving has at least one kind and one feature")
        figures = (self.center, self.spread, self.share_frac, self.middle_ratio, self.whitening_ratio)
        if not all(np.isfinite(np.asarray(figure)).all() for figure in figures):
            raise ValueError("a figure of the driving envelope is not a finite number")
        if min(self.spread) <= 0.0 or min(self.share_frac) <= 0.0 or not self.cut_ratio > 0.0:
            raise ValueError("spreads, shares and the cut are positive")
        if any(sign <= 0.0 for sign, _ in map(np.linalg.slogdet, np.asarray(self.whitening_ratio))):
            raise ValueError("the matrix of a kind of driving has no positive determinant")


@dataclass(frozen=True, slots=True)
class PreparedEnvelope:
    """A driving envelope as arrays, for many drives.

    Attributes:
        places: Where its columns stand in a row of features. (d,)
        center: (d,)
        spread: (d,)
        cut_ratio: As in the record.
        middle_ratio: (k, d)
        whitening_ratio: (k, d, d)
        log_height: Logarithm of share times density in the middle of each kind. (k,)
        limit_level: As in the record.
    """

    places: NDArray[np.intp]
    center: FloatArray
    spread: FloatArray
    cut_ratio: float
    middle_ratio: FloatArray
    whitening_ratio: FloatArray
    log_height: FloatArray
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
    log_height = np.log(envelope.share_frac) + log_determinant - 0.5 * len(envelope.columns) * np.log(2.0 * np.pi)
    return PreparedEnvelope(
        places=np.array([place[name] for name in envelope.columns], dtype=np.intp),
        center=np.asarray(envelope.center, dtype=np.float64),
        spread=np.asarray(envelope.spread, dtype=np.float64),
        cut_ratio=envelope.cut_ratio,
        middle_ratio=np.asarray(envelope.middle_ratio, dtype=np.float64),
        whitening_ratio=whitening,
        log_height=np.asarray(log_height, dtype=np.float64),
        limit_level=envelope.limit_level,
    )


def strangeness_level(rows: FloatArray, envelope: PreparedEnvelope) -> FloatArray:
    """Return minus the logarithm of the density of ordinary drives at each row: larger is stranger. (n,)

    Args:
        rows: Finite features, in the order the envelope was prepared for. (n, features)
        envelope: Ordinary driving.

    References:
        Bishop, Pattern Recognition and Machine Learning, section 9.2, Mixtures of Gaussians.
    """
    values = (rows[:, envelope.places] - envelope.center) / envelope.spread
    values = np.clip(values, -envelope.cut_ratio, envelope.cut_ratio)
    # (n, k): one kind after another, so that memory stays small for many rows.
    log_density = np.column_stack(
        [
            height - 0.5 * np.square((values - middle) @ whitening.T).sum(axis=1)
            for height, middle, whitening in zip(
                envelope.log_height, envelope.middle_ratio, envelope.whitening_ratio, strict=True
            )
        ]
    )
    highest = log_density.max(axis=1)
    total: FloatArray = highest + np.log(np.exp(log_density - highest[:, None]).sum(axis=1))
    return -total


def is_strange(rows: FloatArray, envelope: PreparedEnvelope) -> BoolArray:
    """Return which rows are no ordinary drives; arguments as for `strangeness_level`. (n,)"""
    return np.asarray(strangeness_level(rows, envelope) > envelope.limit_level, dtype=np.bool_)

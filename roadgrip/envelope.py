"""What ordinary driving looks like, as a bundle's manifest can hold it: a few kinds, each a bell in many dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from roadgrip.units import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
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
        whitening_ratio: W of each kind; its determinant is positive. Kept as an array that nobody can change: as
            numbers of their own these matrices take a unit seven times the memory. (k, d, d)
        limit_level: Strangeness from which a drive counts as strange.
    """

    columns: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    cut_ratio: float
    share_frac: tuple[float, ...]
    middle_ratio: tuple[tuple[float, ...], ...]
    whitening_ratio: FloatArray | Sequence[Sequence[Sequence[float]]]
    limit_level: float

    def __post_init__(self) -> None:
        whitening = np.array(self.whitening_ratio, dtype=np.float64)
        whitening.setflags(write=False)
        object.__setattr__(self, "whitening_ratio", whitening)
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

    def __eq__(self, other: object) -> bool:
        """Return whether all figures are the same."""
        if not isinstance(other, DrivingEnvelope):
            return NotImplemented
        return all(np.array_equal(getattr(self, each.name), getattr(other, each.name)) for each in fields(self))

    def __hash__(self) -> int:
        """Return what two envelopes of the same figures have in common."""
        return hash((self.columns, self.share_frac, self.limit_level))

"""How trees are grown, as a record that needs no library to be read."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Target(StrEnum):
    """What the trees add up to."""

    MU = "mu"
    """Friction; squared errors of friction weigh slippery roads little."""
    LOG_MU = "log_mu"
    """Its logarithm; squared errors are then, to first order, those relative to the truth."""


@dataclass(frozen=True, slots=True)
class FitParameters:
    """How the trees are grown.

    Attributes:
        trees_count: Boosting rounds.
        depth_count: Levels of one tree.
        learning_rate_ratio: Share of each tree's correction that is taken.
        row_share_frac: Share of the rows each tree sees.
        column_share_frac: Share of the features each tree sees.
        seed: Of the split and of the trees.
        target: What the trees add up to.
        base_column: With a logarithm as target: trees add up to how far the answer lies from this column, a first guess
            that they mend; None: from nothing.
        bins_count: Into how many values each feature is sorted at most; fewer are faster and coarser.
    """

    trees_count: int = 500
    depth_count: int = 6
    learning_rate_ratio: float = 0.05
    row_share_frac: float = 0.6
    column_share_frac: float = 0.5
    seed: int = 1
    target: Target = Target.MU
    base_column: int | None = None
    bins_count: int = 256

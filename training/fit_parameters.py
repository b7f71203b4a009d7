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
        node_column_share_frac: Share of those that each branching chooses from.
        leaf_rows_count: Fewest rows in a leaf, weights counted in units of their mean.
        seed: Of the split and of the trees.
        target: What the trees add up to.
        base_column: With a logarithm as target: trees add up to how far the answer lies from this column, a first guess
            that they mend; None: from nothing.
        certainty_power_ratio: Each row weighs by the error to expect of it to minus this power: what a passage cannot
            tell is not worth branches that others need. 0: all weigh alike.
        bins_count: Into how many values each feature is sorted at most; fewer are faster and coarser.
    """

    trees_count: int = 500
    depth_count: int = 6
    learning_rate_ratio: float = 0.05
    row_share_frac: float = 0.6
    column_share_frac: float = 0.5
    node_column_share_frac: float = 1.0
    leaf_rows_count: float = 1.0
    seed: int = 1
    target: Target = Target.MU
    base_column: int | None = None
    certainty_power_ratio: float = 0.0
    bins_count: int = 256

"""How trees are grown, as a record that needs no library to be read."""

from __future__ import annotations

from dataclasses import dataclass


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
    """

    trees_count: int = 500
    depth_count: int = 6
    learning_rate_ratio: float = 0.05
    row_share_frac: float = 0.6
    column_share_frac: float = 0.5
    seed: int = 1

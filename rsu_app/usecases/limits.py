"""Everything of a unit that could grow, and how far it may."""

from __future__ import annotations

from dataclasses import dataclass

from roadgrip.errors import ConfigurationError
from roadgrip.units import WINDOW_S
from rsu_app.domain.window import CAPACITY_COUNT


@dataclass(frozen=True, slots=True)
class UnitLimits:
    """Everything that could grow, and how far it may.

    Attributes:
        window_s: How long an estimate counts.
        window_capacity_count: Estimates per section that are counted at once.
        recall_count: Passages remembered in memory to recognise repetitions; the store recognises older ones.
        restored_count: Passages that are read back from the store after a restart, over all sections, the newest.
        subscribers_count: Listeners to changes, over all sections.
        retention_s: How long passages stay in the store.
        rows_count: Passages that may stay in the store.
    """

    window_s: float = WINDOW_S
    window_capacity_count: int = CAPACITY_COUNT
    recall_count: int = 20_000
    restored_count: int = 100_000
    subscribers_count: int = 200
    retention_s: float = 30 * 86_400.0
    rows_count: int = 1_000_000

    def __post_init__(self) -> None:
        counts = (
            self.window_capacity_count,
            self.recall_count,
            self.restored_count,
            self.subscribers_count,
            self.rows_count,
        )
        if min(counts) < 1 or not self.window_s > 0.0:
            raise ConfigurationError("every limit of the unit must be above zero")
        if not self.retention_s >= self.window_s:
            raise ConfigurationError("passages must be kept at least as long as they count")

"""Friction over time as a few lines of text: estimates, the published interval, the truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rich.text import Text

from deploy.demo.story import WORN_FACTOR
from roadgrip.records import Confidence

if TYPE_CHECKING:
    from deploy.demo.story import Story

CHART_COLUMNS, CHART_ROWS = 72, 15
CHART_TOP_MU = 0.65
CONFIDENCE_STYLE = {
    Confidence.INSUFFICIENT: "bright_black",
    Confidence.PROVISIONAL: "yellow",
    Confidence.RECOMMENDED: "green",
}
TRUTH_STYLE = "on grey42"
INTERVAL_MARK, ESTIMATE_MARK, NOT_COUNTED_MARK = "▒", "•", "x"


@dataclass(slots=True)
class _Cell:
    mark: str = " "
    colour: str = ""
    ground: str = ""


@dataclass(slots=True)
class _Grid:
    end_s: float
    rows_count: int
    columns_count: int
    columns: list[list[_Cell]] = field(default_factory=list)

    def column(self, at_s: float) -> int:
        return min(self.columns_count - 1, int(at_s / self.end_s * self.columns_count))

    def row(self, mu: float) -> int:
        return min(self.rows_count - 1, max(0, int(mu / CHART_TOP_MU * self.rows_count)))

    def rows(self, low_mu: float, high_mu: float) -> range:
        return range(self.row(low_mu), self.row(high_mu) + 1)


def chart(story: Story, *, rows_count: int = CHART_ROWS, columns_count: int = CHART_COLUMNS) -> Text:
    """Return estimates, interval and truth over time as text: the truth as background, the interval on it.

    What has passed so far fills the width.
    """
    end_s = max([r.at_s for r in story.readings] + [v.at_s for v in story.vehicles.values()] + [1.0])
    grid = _Grid(end_s, rows_count, columns_count)
    grid.columns = [[_Cell() for _ in range(rows_count)] for _ in range(columns_count)]
    _put_readings(grid, story)
    for vehicle, estimate in story.estimated():
        if estimate.mu is not None:
            cell = grid.columns[grid.column(vehicle.at_s)][grid.row(estimate.mu)]
            cell.mark = ESTIMATE_MARK if estimate.counted else NOT_COUNTED_MARK
            cell.colour = "bold white" if estimate.counted else "bold red"
    text = Text()
    for y in reversed(range(rows_count)):
        text.append(f"{(y + 0.5) * CHART_TOP_MU / rows_count:5.2f} ")
        for cells in grid.columns:
            cell = cells[y]
            text.append(cell.mark, style=f"{cell.colour} {cell.ground}".strip() or None)
        text.append("\n")
    return text.append(" " * 6 + f"0:00{clock_text(end_s):>{columns_count - 4}}")


def legend() -> Text:
    """Return what the signs mean."""
    text = Text(" " * 6)
    text.append("  ", style=TRUTH_STYLE)
    text.append(" truth, worn to new tyres  ")
    for confidence, style in CONFIDENCE_STYLE.items():
        text.append(INTERVAL_MARK * 2, style=style)
        text.append(f" {confidence.value}  ")
    return text.append(f"{ESTIMATE_MARK} estimate  {NOT_COUNTED_MARK} not counted")


def clock_text(at_s: float) -> str:
    """Return a time of the fleet's clock as hours and minutes."""
    return f"{int(at_s // 3600)}:{int(at_s % 3600 // 60):02d} h"


def _put_readings(grid: _Grid, story: Story) -> None:
    following_s = [*(r.at_s for r in story.readings[1:]), grid.end_s]
    for reading, next_s in zip(story.readings, following_s, strict=False):
        interval, true_mu = reading.advisory.interval, reading.base_friction_mu
        colour = CONFIDENCE_STYLE[reading.advisory.confidence]
        # A reading holds until the next one, so that a column without one is no gap.
        for x in range(grid.column(reading.at_s), grid.column(next_s) + 1):
            cells = grid.columns[x] = [_Cell() for _ in range(grid.rows_count)]
            for y in grid.rows(WORN_FACTOR * true_mu, true_mu):
                cells[y].ground = TRUTH_STYLE
            for y in () if interval is None else grid.rows(interval.mu_low, interval.mu_new):
                cells[y].mark, cells[y].colour = INTERVAL_MARK, colour

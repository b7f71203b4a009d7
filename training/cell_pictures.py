"""Heat maps of designs: which share of the drives was kept, and how much of the grip they used."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from roadgrip.units import FloatArray
from training.cells import Cell

_STYLE = {"svg.fonttype": "none", "svg.hashsalt": "roadgrip", "font.size": 8.0, "font.sans-serif": ["DejaVu Sans"]}
_PANELS: tuple[tuple[str, Callable[[Cell], float]], ...] = (
    ("share of drives kept, %", lambda cell: 100.0 * cell.kept_frac),
    (
        "median peak utilisation of kept drives, %",
        lambda cell: np.nan if cell.utilisation_ratio is None else 100.0 * cell.utilisation_ratio["q50"],
    ),
)


def draw_cells(tables: Mapping[str, tuple[Cell, ...]], path: Path) -> None:
    """Write a picture of the cells of some data sets, a row for each: scenarios over base frictions.

    Infeasible cells have a star.

    Args:
        tables: Cells by the title of their data set.
        path: The file; its ending names the format. An SVG is the same for the same cells, byte for byte.
    """
    heights = [1.2 + 0.32 * len({cell.scenario for cell in cells}) for cells in tables.values()]
    with rc_context(_STYLE):
        figure = Figure(figsize=(11.0, 0.4 + sum(heights)), layout="constrained")
        axes = figure.subplots(len(tables), len(_PANELS), squeeze=False, height_ratios=heights)
        for row, (title, cells) in zip(axes, tables.items(), strict=True):
            for panel, (what, value_of) in zip(row, _PANELS, strict=True):
                _draw_map(panel, cells, value_of)
                panel.set_title(f"{title}\n{what}")
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def _draw_map(panel: Axes, cells: tuple[Cell, ...], value_of: Callable[[Cell], float]) -> None:
    scenarios = list(dict.fromkeys(cell.scenario for cell in cells))
    frictions = sorted({cell.base_friction_mu for cell in cells})
    values: FloatArray = np.full((len(scenarios), len(frictions)), np.nan)
    for cell in cells:
        i, j = scenarios.index(cell.scenario), frictions.index(cell.base_friction_mu)
        values[i, j] = value_of(cell)
        text = "-" if np.isnan(values[i, j]) else f"{values[i, j]:.0f}{'' if cell.feasible else '*'}"
        dark = values[i, j] < 50.0
        panel.text(j, i, text, ha="center", va="center", color="white" if dark else "black")
    panel.imshow(values, vmin=0.0, vmax=100.0, cmap="viridis", aspect="auto")
    panel.set_xticks(np.arange(len(frictions)), [f"{mu:.2f}" for mu in frictions])
    panel.set_yticks(np.arange(len(scenarios)), scenarios)
    panel.tick_params(length=0.0)
    panel.set_xlabel("base friction")

"""How every validation picture looks: one style, direct labels, units, the same bytes for the same numbers."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterMathtext, ScalarFormatter
from numpy.typing import NDArray

from roadgrip.units import FloatArray

OURS, THEORY, THIRD, FOURTH, QUIET, BAND = "#1f5fa8", "#c65a11", "#3a9d5d", "#7b4fa3", "#6b6b6b", "#d9d9d9"
SERIES = ("#0b2e59", OURS, "#5b9bd5", "#3a9d5d", "#c9a227", THEORY)
"""From little to much: friction, load or class."""
PANEL_INCHES = (4.3, 3.2)
_RC: dict[str, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Arial", "Helvetica"],
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a8a8a",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#ececec",
    "grid.linewidth": 0.8,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "svg.fonttype": "none",  # text stays text: small files that one can search
    "svg.hashsalt": "roadgrip",
}
_FEW_POINTS_COUNT = 60
_SIX_DIGITS = re.compile(r"(\d\.\d\d)\d+(?=[ \n\"),])")
"""A hundredth of a point is finer than any screen."""


def panels(rows_count: int, columns_count: int, *, title: str) -> tuple[Figure, list[Any]]:
    """Return a figure and its empty panels, row by row.

    Args:
        rows_count: Of panels.
        columns_count: Of panels.
        title: Of the figure.
    """
    with mpl.rc_context(_RC):
        width, height = PANEL_INCHES
        figure = Figure(figsize=(width * columns_count, height * rows_count + 0.35), layout="constrained")
        figure.suptitle(title, x=0.01, ha="left", fontsize=12, fontweight="bold")
        axes = figure.subplots(rows_count, columns_count, squeeze=False)
    return figure, list(axes.ravel())


def label(axes: Any, title: str, *, x: str, y: str) -> None:
    """Name a panel and its axes, units included."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)


def line(axes: Any, x: FloatArray, y: FloatArray, colour: str, *, tolerance_ratio: float = 1e-3, **style: Any) -> None:
    """Draw a curve with no more points than its shape needs."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    kept = telling_points(x, y, tolerance_ratio=tolerance_ratio) if len(x) > _FEW_POINTS_COUNT else np.arange(len(x))
    axes.plot(x[kept], y[kept], color=colour, **style)


def telling_points(x: FloatArray, y: FloatArray, *, tolerance_ratio: float) -> NDArray[np.intp]:
    """Return which points of a curve to keep so that straight lines between them stay near it.

    Args:
        x: (n,)
        y: (n,)
        tolerance_ratio: Largest distance, over the size of the curve.

    References:
        Douglas and Peucker, Algorithms for the reduction of the number of points, Cartographica 10 (1973).
    """
    scaled = [(v - v.min()) / max(float(np.ptp(v)), 1e-12) for v in (x, y)]
    kept = np.zeros(len(x), dtype=np.bool_)
    kept[[0, -1]] = True
    open_ends = [(0, len(x) - 1)]
    while open_ends:
        first, last = open_ends.pop()
        if last - first < 2:
            continue
        along = [v[last] - v[first] for v in scaled]
        away = [v[first + 1 : last] - v[first] for v in scaled]
        length = float(np.hypot(*along))
        distance = np.abs(along[0] * away[1] - along[1] * away[0]) / length if length > 1e-9 else np.hypot(*away)
        worst = int(np.argmax(distance))
        if distance[worst] > tolerance_ratio:
            middle = first + 1 + worst
            kept[middle] = True
            open_ends += [(first, middle), (middle, last)]
    return np.flatnonzero(kept)


def name(axes: Any, x: float, y: float, text: str, colour: str, **style: Any) -> None:
    """Write a name beside a curve, in its colour."""
    axes.annotate(
        text,
        (x, y),
        xytext=style.pop("xytext", (3, 3)),
        textcoords="offset points",
        color=colour,
        fontsize=style.pop("fontsize", 8),
        **style,
    )


def legend(axes: Any, *entries: tuple[str, str], x: float = 0.03, top: float = 0.93) -> None:
    """Write what the colours mean, one line each, where no curve is.

    Args:
        axes: The panel.
        entries: Text and colour.
        x: Left edge, share of the panel.
        top: Upper edge, share of the panel.
    """
    for k, (text, colour) in enumerate(entries):
        axes.text(x, top - 0.075 * k, text, color=colour, fontsize=8, transform=axes.transAxes)


def headroom(axes: Any, frac: float = 0.3) -> None:
    """Leave room above the curves."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + frac * (high - low))


def plain_log_axes(axes: Any, *, x: bool = False, y: bool = False) -> None:
    """Make axes logarithmic with plain figures on x and powers on y."""
    if x:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(ScalarFormatter())
    if y:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(LogFormatterMathtext())


def write(figure: Figure, folder: Path, file_name: str) -> str:
    """Write a figure as SVG and return its file name.

    Args:
        figure: From `panels`.
        folder: Exists.
        file_name: Without ending.
    """
    with mpl.rc_context(_RC):
        path = folder / f"{file_name}.svg"
        drawn = io.StringIO()
        figure.savefig(drawn, format="svg", metadata={"Date": None, "Creator": None})
        path.write_text(_SIX_DIGITS.sub(r"\1", drawn.getvalue()), encoding="utf-8")
    return path.name

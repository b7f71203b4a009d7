"""The pictures of the study as SVG files: small, and the same for the same picture, byte for byte."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis as DrawnAxis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from training.report.colours import GREY, palette_colour
from training.study.picture import Axis, Bars, Boxes, Cloud, Line, Lines, Picture, Scatter

MOST_POINTS_COUNT = 2000
"""A scatter has no more: nobody sees more."""
MOST_DRAWN_POINTS_COUNT = 200
"""A cloud of more is an image inside the file, which is ten times smaller than as many circles."""
_DOTS_PER_INCH = 130
_MOST_UPRIGHT_LETTERS_COUNT = 60
_MOST_LABELS_INSIDE_COUNT = 6
"""More of them would hide what is drawn, so they go below it."""
_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "roadgrip",
    "font.size": 9.0,
    "font.sans-serif": ["DejaVu Sans"],
    "axes.grid": True,
    "grid.color": "#dddddd",
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "path.simplify_threshold": 0.5,
}


def svg_of(picture: Picture) -> bytes:
    """Return a picture as an SVG file."""
    with rc_context(_STYLE):
        figure = Figure(figsize=(7.2, 4.2), layout="constrained")
        axes = figure.subplots()
        axes.set_title(picture.title, loc="left", wrap=True)
        match picture:
            case Lines():
                _draw_lines(axes, picture.lines)
                _set(axes, picture.x_axis, picture.y_axis)
            case Scatter():
                _draw_scatter(axes, picture)
                _set(axes, picture.x_axis, picture.y_axis)
            case Boxes():
                _draw_boxes(axes, picture)
                _set_ordinate(axes, picture.y_axis)
                axes.set_xlabel(picture.x_title)
            case Bars():
                _draw_bars(axes, picture)
                _set_ordinate(axes, picture.y_axis)
                axes.set_xlabel(picture.x_title)
        labels_count = len(axes.get_legend_handles_labels()[1])
        if labels_count > _MOST_LABELS_INSIDE_COUNT:
            figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=8.0)
        elif labels_count > 1:
            axes.legend(frameon=False, fontsize=8.0)
        file = BytesIO()
        figure.savefig(file, format="svg", dpi=_DOTS_PER_INCH, metadata={"Date": None})
    return file.getvalue()


def thinned(cloud: Cloud, *, most_count: int) -> Cloud:
    """Return a cloud with no more points than that, taken at even steps."""
    if len(cloud.x) <= most_count:
        return cloud
    chosen = np.linspace(0, len(cloud.x) - 1, max(1, most_count)).round().astype(int).tolist()
    return Cloud(cloud.name, tuple(cloud.x[i] for i in chosen), tuple(cloud.y[i] for i in chosen))


def _draw_lines(axes: Axes, lines: tuple[Line, ...]) -> None:
    for i, line in enumerate(lines):
        colour = palette_colour(i)
        if line.low:
            axes.fill_between(line.x, line.low, line.high, color=colour, alpha=0.18, linewidth=0.0)
        marker = "o" if len(line.x) <= 40 and not line.dashed else None
        style = "--" if line.dashed else "-"
        axes.plot(line.x, line.y, style, color=colour, marker=marker, markersize=3.5, linewidth=1.5, label=line.name)


def _draw_scatter(axes: Axes, picture: Scatter) -> None:
    for line in picture.references:
        axes.plot(line.x, line.y, "--" if line.dashed else "-", color=GREY, linewidth=1.0, label=line.name)
    points_count = sum(len(cloud.x) for cloud in picture.clouds)
    for i, cloud in enumerate(picture.clouds):
        share = max(1, MOST_POINTS_COUNT * len(cloud.x) // max(points_count, MOST_POINTS_COUNT))
        shown = thinned(cloud, most_count=share)
        colour, many = palette_colour(i), len(shown.x) > MOST_DRAWN_POINTS_COUNT
        axes.plot(shown.x, shown.y, "o", color=colour, markersize=2.5, alpha=0.5, markeredgewidth=0.0, rasterized=many)
        # An empty cloud for the legend: it stays sharp, and can be seen.
        axes.plot([], [], "o", color=colour, markersize=4.0, markeredgewidth=0.0, label=cloud.name)


def _draw_boxes(axes: Axes, picture: Boxes) -> None:
    names = list(dict.fromkeys(box.name for box in picture.boxes))
    groups = list(dict.fromkeys(box.group for box in picture.boxes))
    width = 0.8 / len(groups) if groups else 0.8
    for i, group in enumerate(groups):
        boxes = [box for box in picture.boxes if box.group == group]
        places = [names.index(box.name) + (i - (len(groups) - 1) / 2.0) * width for box in boxes]
        drawn = axes.bxp(
            [dict(zip(("whislo", "q1", "med", "q3", "whishi"), box.quantiles, strict=True)) for box in boxes],
            positions=places,
            widths=0.8 * width,
            showfliers=False,
            patch_artist=True,
            manage_ticks=False,
            medianprops={"color": "black"},
            boxprops={"facecolor": palette_colour(i), "alpha": 0.6},
        )
        if drawn["boxes"] and len(groups) > 1:
            drawn["boxes"][0].set_label(group)
    _name_places(axes, names)


def _draw_bars(axes: Axes, picture: Bars) -> None:
    width = 0.8 / len(picture.groups) if picture.groups else 0.8
    places = np.arange(len(picture.names), dtype=float)
    for i, (group, heights) in enumerate(picture.groups):
        offset = (i - (len(picture.groups) - 1) / 2.0) * width
        axes.bar(places + offset, heights, width, color=palette_colour(i), label=group)
    axes.grid(visible=False, axis="x")
    _name_places(axes, list(picture.names))


def _name_places(axes: Axes, names: list[str]) -> None:
    """Write names under their places: aslant where they are long, some left out where they are too many."""
    step = max(1, -(-len(names) // 30))
    shown = names[::step]
    aslant = sum(len(name) for name in shown) > _MOST_UPRIGHT_LETTERS_COUNT
    labels = axes.set_xticks(np.arange(0, len(names), step), shown)
    if aslant:
        for tick in labels:
            tick.label1.set(rotation=35.0, ha="right", rotation_mode="anchor")


def _set(axes: Axes, x_axis: Axis, y_axis: Axis) -> None:
    axes.set_xlabel(x_axis.title)
    if x_axis.logarithmic:
        axes.set_xscale("log")
        _number_plainly(axes.xaxis)
    if x_axis.low is not None or x_axis.high is not None:
        axes.set_xlim(x_axis.low, x_axis.high)
    _set_ordinate(axes, y_axis)


def _set_ordinate(axes: Axes, y_axis: Axis) -> None:
    axes.set_ylabel(y_axis.title)
    if y_axis.logarithmic:
        axes.set_yscale("log")
        _number_plainly(axes.yaxis)
    if y_axis.low is not None or y_axis.high is not None:
        axes.set_ylim(y_axis.low, y_axis.high)


def _number_plainly(axis: DrawnAxis) -> None:
    """Number a logarithmic axis 1, 2, 5, 10 and so on, without exponents."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())

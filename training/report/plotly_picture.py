"""The pictures of the study as plotly figures: data and layout as plotly's own JSON has them."""

from __future__ import annotations

import math
from typing import Any

from training.report.colours import GREY, faint, palette_colour
from training.study.picture import Axis, Bars, Boxes, Line, Lines, Picture, Scatter

FigureSpec = dict[str, Any]


def plotly_of(picture: Picture) -> FigureSpec:
    """Return a picture as plotly's data and layout, without its title: that stands above it on the page."""
    layout: dict[str, Any] = {
        "margin": {"l": 58, "r": 12, "t": 12, "b": 52},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": "#1d2733"},
        "legend": {"orientation": "h", "yanchor": "bottom", "y": 1.01, "x": 0},
        "hovermode": "closest",
    }
    match picture:
        case Lines():
            data = [trace for i, line in enumerate(picture.lines) for trace in _line(line, colour=palette_colour(i))]
            layout |= {"xaxis": _axis(picture.x_axis), "yaxis": _axis(picture.y_axis)}
        case Scatter():
            data = [trace for line in picture.references for trace in _line(line, colour=GREY)]
            data += [
                {
                    "type": "scattergl" if len(cloud.x) > 3000 else "scatter",
                    "mode": "markers",
                    "name": cloud.name,
                    "x": _shown(cloud.x),
                    "y": _shown(cloud.y),
                    "marker": {"size": 4, "opacity": 0.5, "color": palette_colour(i)},
                }
                for i, cloud in enumerate(picture.clouds)
            ]
            layout |= {"xaxis": _axis(picture.x_axis), "yaxis": _axis(picture.y_axis)}
        case Boxes():
            data = _boxes(picture)
            layout |= {"xaxis": _names(picture.x_title), "yaxis": _axis(picture.y_axis), "boxmode": "group"}
        case Bars():
            data = [
                {
                    "type": "bar",
                    "name": group,
                    "x": list(picture.names),
                    "y": _shown(heights),
                    "marker": {"color": palette_colour(i)},
                }
                for i, (group, heights) in enumerate(picture.groups)
            ]
            layout |= {"xaxis": _names(picture.x_title), "yaxis": _axis(picture.y_axis), "barmode": "group"}
    layout["showlegend"] = sum(trace.get("showlegend", True) for trace in data) > 1
    return {"data": data, "layout": layout}


def _line(line: Line, *, colour: str) -> list[dict[str, Any]]:
    traces: list[dict[str, Any]] = []
    if line.low:
        edge = {"type": "scatter", "mode": "lines", "x": _shown(line.x), "line": {"width": 0}, "showlegend": False}
        edge |= {"hoverinfo": "skip", "legendgroup": line.name}
        traces.append({**edge, "y": _shown(line.low)})
        traces.append({**edge, "y": _shown(line.high), "fill": "tonexty", "fillcolor": faint(colour, 0.18)})
    traces.append(
        {
            "type": "scatter",
            "mode": "lines+markers" if len(line.x) <= 40 and not line.dashed else "lines",
            "name": line.name,
            "legendgroup": line.name,
            "x": _shown(line.x),
            "y": _shown(line.y),
            "line": {"color": colour, "width": 2, "dash": "dash" if line.dashed else "solid"},
            "marker": {"size": 5},
        }
    )
    return traces


def _boxes(picture: Boxes) -> list[dict[str, Any]]:
    traces = []
    for i, group in enumerate(dict.fromkeys(box.group for box in picture.boxes)):
        boxes = [box for box in picture.boxes if box.group == group]
        columns = [_shown(column) for column in zip(*(box.quantiles for box in boxes), strict=True)]
        traces.append(
            {
                "type": "box",
                "name": group,
                "x": [box.name for box in boxes],
                **dict(zip(("lowerfence", "q1", "median", "q3", "upperfence"), columns, strict=True)),
                "marker": {"color": palette_colour(i)},
            }
        )
    return traces


def _names(title: str) -> dict[str, Any]:
    return {"title": {"text": title}, "type": "category", "automargin": True}


def _axis(axis: Axis) -> dict[str, Any]:
    shape: dict[str, Any] = {"title": {"text": axis.title}, "automargin": True, "gridcolor": "#dddddd"}
    shape |= {"zeroline": False, "type": "log" if axis.logarithmic else "linear"}
    ends = [_end(end, logarithmic=axis.logarithmic) for end in (axis.low, axis.high)]
    if ends != [None, None]:
        shape["range"] = ends  # an end that is None follows from the data
    return shape


def _end(end: float | None, *, logarithmic: bool) -> float | None:
    return end if end is None or not logarithmic else math.log10(end)


def _shown(values: tuple[float, ...]) -> list[float | None]:
    """Return values to five digits, which no screen can tell from more; a gap for what is no number."""
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values]

"""Pictures as data: what is drawn, not how, so that page and print show the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis.

    Attributes:
        title: Quantity and unit.
        low: Lower end; None lets the data say.
        high: Upper end; None lets the data say.
        logarithmic: Whether equal ratios are equally far apart.
    """

    title: str
    low: float | None = None
    high: float | None = None
    logarithmic: bool = False


@dataclass(frozen=True, slots=True)
class Line:
    """Points joined in order, with an optional band around them.

    Attributes:
        name: In the legend.
        x: Abscissae. (n,)
        y: Ordinates. (n,)
        low: Lower edge of the band; empty without one. (n,)
        high: Upper edge. (n,)
        dashed: For references such as a target or a floor.
    """

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    low: tuple[float, ...] = ()
    high: tuple[float, ...] = ()
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Lines:
    """Curves over one abscissa."""

    title: str
    x_axis: Axis
    y_axis: Axis
    lines: tuple[Line, ...]


@dataclass(frozen=True, slots=True)
class Box:
    """The distribution of some values as five numbers: 5, 25, 50, 75 and 95 %.

    Attributes:
        name: Which column of the picture it stands in.
        group: Which colour it has; boxes of one name and different groups stand side by side.
        quantiles: Five ascending values.
    """

    name: str
    group: str
    quantiles: tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Boxes:
    """Boxes side by side, in the order in which their names first come."""

    title: str
    x_title: str
    y_axis: Axis
    boxes: tuple[Box, ...]


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points of one colour; at most a few thousand, thinned by who makes them."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Scatter:
    """Points, with reference lines behind them."""

    title: str
    x_axis: Axis
    y_axis: Axis
    clouds: tuple[Cloud, ...]
    references: tuple[Line, ...] = ()


@dataclass(frozen=True, slots=True)
class Bars:
    """Bars or a histogram: one height per name (or bin) and group.

    Attributes:
        title: Above the picture.
        x_title: What the names are.
        y_axis: What the heights are.
        names: Of the places, in order.
        groups: Heights by group, each as many as there are names.
    """

    title: str
    x_title: str
    y_axis: Axis
    names: tuple[str, ...]
    groups: tuple[tuple[str, tuple[float, ...]], ...]


Picture: TypeAlias = Lines | Boxes | Scatter | Bars

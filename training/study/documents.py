"""Results as JSON and back: what the caches hold, and what is committed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from training.rounding import rounded
from training.study.chapter import Cell, Result, Table
from training.study.picture import Axis, Bars, Box, Boxes, Cloud, Line, Lines, Picture, Scatter

DIGITS_COUNT = 6
_KINDS: Mapping[str, type[Picture]] = {"lines": Lines, "boxes": Boxes, "scatter": Scatter, "bars": Bars}


def document_of(result: Result) -> dict[str, Any]:
    """Return a result as JSON has it; figures that are no finite numbers become null."""
    return {
        "figures": {name: _plain(value) for name, value in result.figures.items()},
        "sizes": {name: int(count) for name, count in result.sizes.items()},
        "tables": [_plain(asdict(table)) for table in result.tables],
        "pictures": [document_of_picture(picture) for picture in result.pictures],
    }


def result_of(document: Mapping[str, Any]) -> Result:
    """Return the result of a document; a figure that is null is NaN.

    Raises:
        KeyError: It is no document of a result.
    """
    return Result(
        figures={name: math.nan if value is None else float(value) for name, value in document["figures"].items()},
        sizes=dict(document["sizes"]),
        tables=tuple(_table(table) for table in document["tables"]),
        pictures=tuple(picture_of(picture) for picture in document["pictures"]),
    )


def document_of_picture(picture: Picture) -> dict[str, Any]:
    """Return a picture as JSON has it, with a word for its kind."""
    kind = next(name for name, made in _KINDS.items() if isinstance(picture, made))
    return {"kind": kind, **_plain(asdict(picture))}


def picture_of(document: Mapping[str, Any]) -> Picture:
    """Return the picture of a document.

    Raises:
        KeyError: It is no document of a picture.
    """
    title = document["title"]
    y_axis = Axis(**document["y_axis"])
    match document["kind"]:
        case "lines":
            return Lines(title, Axis(**document["x_axis"]), y_axis, _lines(document["lines"]))
        case "boxes":
            return Boxes(title, document["x_title"], y_axis, tuple(_box(box) for box in document["boxes"]))
        case "scatter":
            clouds = tuple(
                Cloud(cloud["name"], _numbers(cloud["x"]), _numbers(cloud["y"])) for cloud in document["clouds"]
            )
            return Scatter(title, Axis(**document["x_axis"]), y_axis, clouds, _lines(document["references"]))
        case "bars":
            groups = tuple((name, _numbers(heights)) for name, heights in document["groups"])
            return Bars(title, document["x_title"], y_axis, tuple(document["names"]), groups)
        case kind:
            raise KeyError(f"no kind of picture: {kind}")


def in_short(document: Any) -> Any:
    """Return a document with its numbers rounded to six digits, for files that people compare."""
    return rounded(document, digits_count=DIGITS_COUNT)


def _plain(value: Any) -> Any:
    """Return a value as JSON knows it, whichever library's number or sequence it was."""
    if isinstance(value, dict):
        return {str(name): _plain(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(inner) for inner in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return None if value is None else str(value)


def _table(document: Mapping[str, Any]) -> Table:
    rows = tuple(tuple[Cell, ...](row) for row in document["rows"])
    return Table(document["title"], tuple(document["columns"]), rows, document["note"])


def _lines(documents: list[Mapping[str, Any]]) -> tuple[Line, ...]:
    return tuple(
        Line(
            line["name"],
            _numbers(line["x"]),
            _numbers(line["y"]),
            _numbers(line["low"]),
            _numbers(line["high"]),
            dashed=line["dashed"],
        )
        for line in documents
    )


def _box(document: Mapping[str, Any]) -> Box:
    q05, q25, q50, q75, q95 = _numbers(document["quantiles"])
    return Box(document["name"], document["group"], (q05, q25, q50, q75, q95))


def _numbers(values: list[float | None]) -> tuple[float, ...]:
    return tuple(math.nan if value is None else float(value) for value in values)

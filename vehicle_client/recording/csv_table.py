"""CSV as columns of numbers, both ways; an empty cell is NaN."""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import TraceError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from roadgrip.units import FloatArray

_GZIP_MAGIC = b"\x1f\x8b"


def columns_of_csv(data: bytes, *, place: str) -> dict[str, FloatArray]:
    """Return the columns of a CSV file with one header row, gzipped or not; all arrays (n,). Empty lines are skipped.

    Args:
        data: The file's bytes.
        place: What the file is called, for messages.

    Raises:
        TraceError: It is no such file; the message says which line.
    """
    try:
        text = (gzip.decompress(data) if data.startswith(_GZIP_MAGIC) else data).decode("utf-8-sig")
    except (UnicodeDecodeError, EOFError, OSError, zlib.error) as error:
        message = f"{place} is no CSV file: {error}"
        raise TraceError(message) from error
    rows = csv.reader(io.StringIO(text, newline=""))
    try:
        names = [name.strip() for name in next(rows, [])]
        table = _numbers(rows, width=len(names), place=place)
    except csv.Error as error:
        message = f"{place}, line {rows.line_num}: {error}"
        raise TraceError(message) from error
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        message = f"{place}: more than one column {', '.join(repeated)}"
        raise TraceError(message)
    return {name: table[:, i] for i, name in enumerate(names)}


def csv_of_columns(columns: Mapping[str, FloatArray]) -> bytes:
    """Return a CSV file of columns of equal length; reading it back gives the same numbers to the last bit."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(_cells(values) for values in columns.values()), strict=True))
    return text.getvalue().encode()


def _cells(values: FloatArray) -> list[str]:
    whole = values.dtype != np.float64
    return ["" if v != v else repr(int(v)) if whole else repr(v) for v in values.tolist()]  # noqa: PLR0124 - NaN


def _numbers(rows: Iterable[list[str]], *, width: int, place: str) -> FloatArray:
    numbers: list[list[float]] = []
    for line, row in enumerate(rows, start=2):
        if not row:
            continue
        if len(row) != width:
            message = f"{place}, line {line}: {len(row)} cells under {width} columns"
            raise TraceError(message)
        try:
            numbers.append([float(cell) if cell else np.nan for cell in row])
        except ValueError as error:
            message = f"{place}, line {line}: {error}"
            raise TraceError(message) from error
    return np.array(numbers, dtype=np.float64).reshape(len(numbers), width)

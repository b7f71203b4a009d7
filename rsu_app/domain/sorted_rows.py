"""Rows of numbers in the order of their time, in hardly more memory than the numbers take."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from sortedcontainers import SortedList

from roadgrip.units import FloatArray

_SIGN = 1 << 63
_NUMBER = struct.Struct(">d")
_BITS = struct.Struct(">q")


class SortedRows:
    """Rows of as many numbers each, ordered by the first of them, equal ones by the next.

    What it holds does not depend on the order in which rows were added. Adding one, dropping the first and reading the
    newest take as long with a hundred thousand rows as with a thousand.

    A row is kept as bytes that are ordered as its numbers are, so that finding its place is a few comparisons of
    memory, and takes less than half the memory of a Python record.

    Args:
        columns_count: Numbers of a row, two at least.
    """

    def __init__(self, columns_count: int) -> None:
        self._columns_count = columns_count
        self._spelling = struct.Struct(f">Q{columns_count - 1}d")
        self._lines: SortedList = SortedList()

    def __len__(self) -> int:
        """Return how many rows are held."""
        return len(self._lines)

    @property
    def first(self) -> FloatArray:
        """The first row. (columns,)"""
        return self._read([self._lines[0]]).ravel()

    @property
    def last(self) -> FloatArray:
        """The last row. (columns,)"""
        return self._read([self._lines[-1]]).ravel()

    @property
    def first_number(self) -> float:
        """The first number of the first row."""
        return _number_of(self._lines[0])

    def add(self, row: Sequence[float]) -> None:
        """Put a row into its place.

        Args:
            row: Its first number is any, the second not negative; behind them NaN may stand, too. What is equal so far
                has a place that the others decide, always the same one. (columns,)
        """
        self._lines.add(self._spelling.pack(_ordered_bits(row[0]), *row[1:]))

    def pop_first(self) -> FloatArray:
        """Forget the first row, and return it. (columns,)"""
        return self._read([self._lines.pop(0)]).ravel()

    def newest(self, limit_count: int) -> FloatArray:
        """Return the last rows in their order, at most so many: a table of its own. (n, columns)"""
        return self._read(self._lines[max(0, len(self._lines) - limit_count) :])

    def _read(self, lines: Sequence[bytes]) -> FloatArray:
        words = np.frombuffer(b"".join(lines), dtype=">u8").reshape(-1, self._columns_count).astype(np.uint64)
        first = words[:, 0]
        words[:, 0] = np.where(first >= _SIGN, first ^ np.uint64(_SIGN), ~first)
        rows: FloatArray = words.view(np.float64)
        return rows


def _ordered_bits(value: float) -> int:
    """Return a whole number below 2**64 that is ordered as numbers are; IEEE 754, totalOrder, zero without its sign."""
    (bits,) = _BITS.unpack(_NUMBER.pack(value + 0.0))
    return int(bits + _SIGN if bits >= 0 else ~bits)


def _number_of(line: bytes) -> float:
    bits = int.from_bytes(line[:8], "big")
    (value,) = _NUMBER.unpack((bits ^ _SIGN if bits >= _SIGN else bits ^ (2 * _SIGN - 1)).to_bytes(8, "big"))
    return float(value)

"""Rows of numbers in the order of their time, in as little memory as the numbers take."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from roadgrip.units import FloatArray

BLOCK_COUNT = 1024
"""Rows that lie side by side. A row is put into its place by moving some of them, never more."""
ORDERED_COLUMNS_COUNT = 2
"""Columns that hold no NaN."""
FIRST_BLOCK_COUNT = 64
"""Room that the first block begins with: a unit in a data centre has thousands of sections, most of them quiet."""


class _Block:
    """Some neighbouring rows: those of `table` from `start` to before `stop`, at least one."""

    __slots__ = ("start", "stop", "table")

    def __init__(self, table: FloatArray, start: int, stop: int) -> None:
        self.table = table
        self.start = start
        self.stop = stop

    @property
    def rows(self) -> FloatArray:
        return self.table[self.start : self.stop]


class SortedRows:
    """Rows of as many numbers each, ordered by the first of them, equal ones by the next.

    The first two of a row can be ordered; behind them NaN may stand, and comes before all numbers.

    What it holds does not depend on the order in which rows were added. Adding one, dropping the first and reading the
    newest take as long with a hundred thousand rows as with a thousand: the rows lie in blocks, and a table of
    64-bit numbers takes a fifth of the memory of as many Python records.

    Args:
        columns_count: Numbers of a row.
    """

    def __init__(self, columns_count: int) -> None:
        self._columns_count = columns_count
        self._blocks: list[_Block] = []
        self._count = 0

    def __len__(self) -> int:
        """Return how many rows are held."""
        return self._count

    @property
    def first(self) -> FloatArray:
        """The first row; to be read, not changed, and not after the next change. (columns,)"""
        row: FloatArray = self._blocks[0].rows[0]
        return row

    @property
    def last(self) -> FloatArray:
        """The last row; to be read, not changed, and not after the next change. (columns,)"""
        row: FloatArray = self._blocks[-1].rows[-1]
        return row

    def add(self, row: Sequence[float]) -> None:
        """Put a row into its place.

        Args:
            row: Its first two numbers can be ordered. (columns,)
        """
        self._count += 1
        if not self._blocks:
            table = np.empty((FIRST_BLOCK_COUNT, self._columns_count))
            table[0] = row
            self._blocks.append(_Block(table, 0, 1))
            return
        number = max(0, bisect_left(self._blocks, row[0], key=lambda block: float(block.table[block.start, 0])) - 1)
        place = _place(self._blocks[number], row)
        while place == self._blocks[number].stop and number + 1 < len(self._blocks):
            # Rows of one time may fill several blocks.
            following = _place(self._blocks[number + 1], row)
            if following == self._blocks[number + 1].start:
                break
            number, place = number + 1, following
        self._insert(number, place, row)

    def pop_first(self) -> FloatArray:
        """Forget the first row, and return it. (columns,)"""
        block = self._blocks[0]
        row: FloatArray = block.table[block.start].copy()
        block.start += 1
        self._count -= 1
        if block.start == block.stop:
            del self._blocks[0]
        return row

    def newest(self, limit_count: int) -> FloatArray:
        """Return the last rows in their order, at most so many: a table of its own. (n, columns)"""
        parts: list[FloatArray] = []
        missing_count = min(limit_count, self._count)
        for block in reversed(self._blocks):
            if missing_count == 0:
                break
            parts.append(block.rows[-missing_count:])
            missing_count -= len(parts[-1])
        return np.concatenate(parts[::-1]) if parts else np.empty((0, self._columns_count))

    def _insert(self, number: int, place: int, row: Sequence[float]) -> None:
        block = self._blocks[number]
        if block.stop == len(block.table) < BLOCK_COUNT:
            block.table = np.concatenate([block.table, np.empty_like(block.table)])
        if block.stop == BLOCK_COUNT and block.start > 0:
            moved_count = block.start
            block.table[: block.stop - moved_count] = block.rows.copy()
            block.start, block.stop, place = 0, block.stop - moved_count, place - moved_count
        if block.stop == BLOCK_COUNT:
            # Rows come mostly in order: a full last block stays full, and only one in the middle is halved.
            middle = BLOCK_COUNT if number + 1 == len(self._blocks) and place == BLOCK_COUNT else BLOCK_COUNT // 2
            table = np.empty_like(block.table)
            table[: BLOCK_COUNT - middle] = block.table[middle:]
            self._blocks.insert(number + 1, _Block(table, 0, BLOCK_COUNT - middle))
            block.stop = middle
            if place >= middle:
                number, place = number + 1, place - middle
            block = self._blocks[number]
        if place < block.stop:
            block.table[place + 1 : block.stop + 1] = block.table[place : block.stop].copy()
        block.table[place] = row
        block.stop += 1


def _place(block: _Block, row: Sequence[float]) -> int:
    """Return where a row belongs in the table of a block, between its start and its stop."""
    place, behind = block.start, block.stop
    # Passages that arrive together with one age have one time: many of these, but hardly two with one friction.
    for column in range(ORDERED_COLUMNS_COUNT):
        values = block.table[place:behind, column]
        first = int(values.searchsorted(row[column]))
        if first == len(values) or values[first] != row[column]:
            return place + first
        behind = place + int(values.searchsorted(row[column], side="right"))
        place += first
    ties = block.table[place:behind]
    return place + bisect_left(range(len(ties)), _rank(row), key=lambda number: _rank(ties[number]))


def _rank(row: Sequence[float] | FloatArray) -> list[float]:
    return [float("-inf") if value != value else float(value) for value in row]  # noqa: PLR0124 - NaN alone differs from itself

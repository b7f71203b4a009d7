"""Quantiles and distinct values by plain sorting.

numpy's own functions for these load its masked arrays at their first call, 7 MB that a car never uses otherwise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray


def quantile(values: FloatArray, share: float) -> float:
    """Return the quantile of values, linear between neighbours; NaN if one of them is.

    Args:
        values: In any order, at least one. (n,)
        share: 0 is the least of them, 1 the largest.

    References:
        Hyndman and Fan, Sample quantiles in statistical packages, definition 7.
    """
    ordered = np.sort(values)
    position = share * (len(ordered) - 1)
    below = int(position)
    above = min(below + 1, len(ordered) - 1)
    if np.isnan(ordered[-1]):
        return float("nan")
    return float(ordered[below] + (position - below) * (ordered[above] - ordered[below]))


def median(values: FloatArray) -> float:
    """Return the middle of values, or the mean of the two in the middle; NaN if one of them is. (n,), n > 0"""
    ordered = np.sort(values)
    if np.isnan(ordered[-1]):
        return float("nan")
    return float((ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2.0)


def first_of_each(values: FloatArray) -> BoolArray:
    """Return which of values in ascending order are larger than the one before; the first is. (n,)"""
    result: BoolArray = np.ones(len(values), dtype=np.bool_)
    result[1:] = values[1:] > values[:-1]
    return result


def distinct(values: FloatArray) -> FloatArray:
    """Return the values in ascending order, each once. (m,)"""
    ordered = np.sort(values)
    return ordered[first_of_each(ordered)]

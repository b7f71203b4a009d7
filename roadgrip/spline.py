"""The cubic spline behind every centre line, in numpy alone: a vehicle carries no scipy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from roadgrip.units import FloatArray


def second_derivatives(knots: FloatArray, values: FloatArray) -> FloatArray:
    """Return the second derivatives at the knots of the cubic spline through the values. (n, k)

    The first and the last piece are parabolas, so that a section cut in the middle of a curve keeps its curvature to
    the end; natural ends would straighten it.

    Args:
        knots: Increasing, at least four. (n,)
        values: Any number of coordinates per knot. (n, k)

    References:
        de Boor, A Practical Guide to Splines, chapter IV; the tridiagonal system is solved by elimination.
    """
    h = np.diff(knots)
    slope = np.diff(values, axis=0) / h[:, None]
    right = 6.0 * np.diff(slope, axis=0)
    diagonal = 2.0 * (h[:-1] + h[1:])
    diagonal[0] += h[0]
    diagonal[-1] += h[-1]
    n = len(diagonal)
    for i in range(1, n):
        factor = h[i] / diagonal[i - 1]
        diagonal[i] -= factor * h[i]
        right[i] -= factor * right[i - 1]
    second = np.zeros_like(values)
    for i in range(n - 1, -1, -1):
        following = h[i + 1] * second[i + 2] if i + 1 < n else 0.0
        second[i + 1] = (right[i] - following) / diagonal[i]
    second[0], second[-1] = second[1], second[-2]
    return second


def evaluate(
    knots: FloatArray, values: FloatArray, second: FloatArray, at: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return value, first and second derivative of the spline. Each (m, k)

    Args:
        knots: As for `second_derivatives`. (n,)
        values: The same values. (n, k)
        second: What `second_derivatives` returned. (n, k)
        at: Where to evaluate; outside the knots the end pieces go on. (m,)
    """
    i = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
    h = (knots[i + 1] - knots[i])[:, None]
    b = (at - knots[i])[:, None] / h
    a = 1.0 - b
    value = a * values[i] + b * values[i + 1] + ((a**3 - a) * second[i] + (b**3 - b) * second[i + 1]) * h**2 / 6.0
    first = (values[i + 1] - values[i]) / h + ((3 * b**2 - 1) * second[i + 1] - (3 * a**2 - 1) * second[i]) * h / 6.0
    return value, first, a * second[i] + b * second[i + 1]

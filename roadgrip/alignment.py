"""Centre lines from the elements road designers use: straights, arcs, and the clothoids between them.

The plan is a list of elements along which the curvature changes linearly; the profile a list of grades between
which the grade changes linearly (parabolic crests and sags). Headings and heights are then exact polynomials, and
only the positions need a sum.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import SectionError
from roadgrip.order_statistics import distinct

if TYPE_CHECKING:
    from collections.abc import Sequence

    from roadgrip.units import FloatArray

RUNOFF_S = 0.5
"""Standard deviation, in time at the rated speed, with which a bank follows the curvature. A carriageway cannot
jump from flat to banked; spread like this 8 % come within about a second and a half of travel."""

_CELL_M = 0.5
_GAUSS_AT, _GAUSS_WEIGHT = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, slots=True)
class Element:
    """A stretch along which the curvature changes linearly.

    Attributes:
        length_m: Horizontal length, positive.
        start_curvature_1pm: Left turn positive.
        end_curvature_1pm: The same for a straight (zero) or an arc.
    """

    length_m: float
    start_curvature_1pm: float
    end_curvature_1pm: float


@dataclass(frozen=True, slots=True)
class GradePoint:
    """The grade at one station; between two of them it changes linearly, outside it stays.

    Attributes:
        station_m: Horizontal distance from the start.
        grade_ratio: Rise over horizontal distance, uphill positive.
    """

    station_m: float
    grade_ratio: float


@dataclass(frozen=True, slots=True)
class CentreLine:
    """A designed line at equal steps of its length. All arrays (n,), but `nodes_m` (n, 3).

    Attributes:
        station_m: Horizontal distance from the start.
        nodes_m: East, north, up relative to the start.
        heading_rad: Counter-clockwise from east, not wrapped.
        curvature_1pm: Left turn positive.
        grade_ratio: Uphill positive.
    """

    station_m: FloatArray
    nodes_m: FloatArray
    heading_rad: FloatArray
    curvature_1pm: FloatArray
    grade_ratio: FloatArray


def straight(length_m: float) -> Element:
    """Return a straight element."""
    return Element(length_m, 0.0, 0.0)


def arc(length_m: float, *, radius_m: float) -> Element:
    """Return a circular element; a negative radius turns right."""
    return Element(length_m, 1.0 / radius_m, 1.0 / radius_m)


def clothoid(length_m: float, *, start_curvature_1pm: float, end_curvature_1pm: float) -> Element:
    """Return a transition along which the curvature changes linearly."""
    return Element(length_m, start_curvature_1pm, end_curvature_1pm)


def mirrored_elements(elements: Sequence[Element]) -> tuple[Element, ...]:
    """Return the same road with left and right exchanged."""
    return tuple(Element(e.length_m, -e.start_curvature_1pm, -e.end_curvature_1pm) for e in elements)


def centre_line(
    elements: Sequence[Element],
    *,
    node_step_m: float,
    start_heading_rad: float = 0.0,
    grades: Sequence[GradePoint] = (),
) -> CentreLine:
    """Return the line that the elements describe, sampled at equal steps of its length.

    Positions are good to a tenth of a millimetre on roads (radius above 5 m, element ends anywhere).

    Args:
        elements: In the direction of travel.
        node_step_m: About how far apart the points shall lie; the steps are made equal.
        start_heading_rad: Counter-clockwise from east.
        grades: In order of station; none means level.

    Raises:
        SectionError: There is no element, a length is not positive, or the grades are not in order.
    """
    if not elements or not all(e.length_m > 0.0 for e in elements) or not node_step_m > 0.0:
        message = "an alignment needs elements of positive length and a positive step"
        raise SectionError(message)
    if any(b.station_m <= a.station_m for a, b in pairwise(grades)):
        message = "grades must be in the order of their stations"
        raise SectionError(message)
    starts = np.concatenate([[0.0], np.cumsum([e.length_m for e in elements])])
    count = max(1, round(float(starts[-1]) / node_step_m))
    station = np.linspace(0.0, starts[-1], count + 1)

    # Heading is a polynomial on each element; east and north are Gauss sums of its cosine and sine over cells that
    # never span an element's end.
    cells = distinct(np.concatenate([station, starts, np.arange(0.0, starts[-1], _CELL_M)]))
    width = np.diff(cells)
    at = cells[:-1, None] + width[:, None] * (_GAUSS_AT + 1.0) / 2.0
    heading, _ = _heading_and_curvature(elements, starts, at.ravel())
    heading = start_heading_rad + heading.reshape(at.shape)
    east = np.concatenate([[0.0], np.cumsum(width / 2.0 * (np.cos(heading) @ _GAUSS_WEIGHT))])
    north = np.concatenate([[0.0], np.cumsum(width / 2.0 * (np.sin(heading) @ _GAUSS_WEIGHT))])
    turned, curvature = _heading_and_curvature(elements, starts, station)
    grade, height = _grade_and_height(grades, station)
    nodes = np.column_stack([np.interp(station, cells, east), np.interp(station, cells, north), height])
    return CentreLine(station, nodes, start_heading_rad + turned, curvature, grade)


def smoothed_along(values: FloatArray, *, step_m: float, sigma_m: float) -> FloatArray:
    """Return values on an even grid, smoothed with a Gaussian along the line.

    The ends are continued by point reflection, so that a straight trend stays what it is and the first and the
    last value do not move. A `sigma_m` of zero changes nothing.

    Args:
        values: One row per grid point. (n,) or (n, k)
        step_m: Distance between grid points.
        sigma_m: Standard deviation of the Gaussian. It lowers the peak of a sinus of wavelength L by
            exp(-2 (pi sigma / L)^2).
    """
    n = len(values)
    if n < 2 or sigma_m < 0.1 * step_m:  # a neighbour would weigh less than exp(-50)
        return values.copy()
    reach = min(n - 1, int(np.ceil(4.0 * sigma_m / step_m)))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step_m / sigma_m) ** 2)
    kernel /= kernel.sum()
    before = 2.0 * values[0] - values[reach:0:-1]
    after = 2.0 * values[-1] - values[-2 : -reach - 2 : -1]
    extended = np.concatenate([before, values, after]).reshape(n + 2 * reach, -1)
    columns = [np.convolve(extended[:, k], kernel, mode="valid") for k in range(extended.shape[1])]
    return np.column_stack(columns).reshape(values.shape)


def runoff_sigma_m(speed_limit_mps: float) -> float:
    """Return over what length a bank follows the curvature: half a second of travel at the rated speed."""
    return RUNOFF_S * speed_limit_mps


def _heading_and_curvature(
    elements: Sequence[Element], starts: FloatArray, station_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    length = np.array([e.length_m for e in elements])
    first = np.array([e.start_curvature_1pm for e in elements])
    slope = (np.array([e.end_curvature_1pm for e in elements]) - first) / length
    turned = np.concatenate([[0.0], np.cumsum(first * length + slope * length**2 / 2.0)])
    i = np.clip(np.searchsorted(starts, station_m, side="right") - 1, 0, len(elements) - 1)
    along = station_m - starts[i]
    return turned[i] + first[i] * along + slope[i] * along**2 / 2.0, first[i] + slope[i] * along


def _grade_and_height(grades: Sequence[GradePoint], station_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    if not grades:
        return np.zeros_like(station_m), np.zeros_like(station_m)
    at = np.array([g.station_m for g in grades])
    value = np.array([g.grade_ratio for g in grades])
    # The grade is piecewise linear, so the trapezium rule is exact as long as its corners are on the grid.
    grid = distinct(np.concatenate([station_m, at[(at > station_m[0]) & (at < station_m[-1])]]))
    grade = np.interp(grid, at, value)
    height = np.concatenate([[0.0], np.cumsum(np.diff(grid) * (grade[1:] + grade[:-1]) / 2.0)])
    return np.interp(station_m, at, value), np.interp(station_m, grid, height)

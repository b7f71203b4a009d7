"""The waypoints of a map: where a road bends most, which way, and how far apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray

PROMINENCE_FRAC = 0.25
"""An extreme counts if curvature falls by this share of the section's largest on both sides of it."""
CURVATURE_MIN_1PM = 1.0 / 1000.0
SMOOTHING_M = 15.0
"""Vehicles cut corners: curvature is compared as means over this length."""

RIGHT_STD_FRAC, RIGHT_STD_1PM = 0.4, 0.003
"""Of the difference between driven and mapped curvature at a waypoint: a driver's own line through a bend."""
OTHER_STD_FRAC, OTHER_STD_1PM = 1.0, 0.01
"""The same where the road is another one."""
VOTE_MIN = -4.0
"""One waypoint alone, such as one at which somebody swerved, can say no more against a road."""


@dataclass(frozen=True, slots=True)
class Waypoints:
    """Points of greatest curvature in the order of the road. Both arrays (k,).

    Attributes:
        station_m: Along the section.
        curvature_1pm: Mean over 15 m, left turn positive.
    """

    station_m: FloatArray
    curvature_1pm: FloatArray


def section_waypoints(section: RoadSection) -> Waypoints:
    """Return the waypoints of a section; there are none on a road that is straight."""
    profile = section.profile
    curvature = mean_curvature_1pm(profile.station_m, profile.heading_rad, at_m=profile.station_m)
    return curvature_extremes(profile.station_m, curvature)


def vote_of_waypoints(driven_1pm: FloatArray, *, mapped_1pm: FloatArray) -> float:
    """Return how much the waypoints speak for a road: the sum of their log likelihood ratios.

    Every waypoint where the drive bends the way the map says adds up to about 1, every other one takes away up to 4.
    Since it is looked for where the map has it, its distances from the others, from start and end count as well.

    Args:
        driven_1pm: Curvature of the drive where the waypoints should lie, left turn positive. (k,)
        mapped_1pm: Curvature of the map at its waypoints. (k,)
    """
    off = driven_1pm - mapped_1pm
    right = RIGHT_STD_1PM + RIGHT_STD_FRAC * np.abs(mapped_1pm)
    other = OTHER_STD_1PM + OTHER_STD_FRAC * np.abs(mapped_1pm)
    ratios = np.log(other / right) - 0.5 * (off / right) ** 2 + 0.5 * (off / other) ** 2
    return float(np.sum(np.maximum(ratios, VOTE_MIN)))


def mean_curvature_1pm(station_m: FloatArray, heading_rad: FloatArray, *, at_m: FloatArray) -> FloatArray:
    """Return heading gained per metre over the 15 m around each position; near the ends over what there is. (m,)

    Args:
        station_m: Increasing. (n,)
        heading_rad: Unwrapped. (n,)
        at_m: Positions asked for. (m,)
    """
    low = np.clip(at_m - SMOOTHING_M / 2.0, station_m[0], station_m[-1] - SMOOTHING_M / 2.0)
    high = np.clip(at_m + SMOOTHING_M / 2.0, station_m[0] + SMOOTHING_M / 2.0, station_m[-1])
    return (np.interp(high, station_m, heading_rad) - np.interp(low, station_m, heading_rad)) / (high - low)


def curvature_extremes(station_m: FloatArray, curvature_1pm: FloatArray) -> Waypoints:
    """Return one waypoint per bend: the largest magnitude between two places where the road straightens or turns over.

    A bend ends where the curvature changes sign, or where it falls and rises again by a quarter of the largest
    curvature of the section.

    Args:
        station_m: Increasing. (n,)
        curvature_1pm: Smooth. (n,)
    """
    largest = float(np.abs(curvature_1pm).max())
    swing = max(PROMINENCE_FRAC * largest, CURVATURE_MIN_1PM)
    found: list[int] = []
    peak, valley = 0, 0
    rising = True
    # Signed turning points that differ by at least the swing; those that bend away from straight are waypoints.
    for k, value in enumerate(curvature_1pm.tolist()):
        if value > curvature_1pm[peak]:
            peak = k
        if value < curvature_1pm[valley]:
            valley = k
        if rising and value < curvature_1pm[peak] - swing:
            found.append(peak)
            rising, valley = False, k
        elif not rising and value > curvature_1pm[valley] + swing:
            found.append(valley)
            rising, peak = True, k
    found.append(peak if rising else valley)
    kept = [k for i, k in enumerate(found) if abs(curvature_1pm[k]) >= swing and _bends_away(curvature_1pm, found, i)]
    return Waypoints(station_m=station_m[kept], curvature_1pm=curvature_1pm[kept])


def _bends_away(curvature_1pm: FloatArray, turning_points: list[int], i: int) -> bool:
    """Return whether the curvature at a turning point is larger in magnitude than at both neighbours of its sign."""
    here = curvature_1pm[turning_points[i]]
    neighbours = [turning_points[j] for j in (i - 1, i + 1) if 0 <= j < len(turning_points)]
    return all(curvature_1pm[j] * np.sign(here) < abs(here) for j in neighbours)

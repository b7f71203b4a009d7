"""The heading a vehicle gained inside a section against the map's, once something else has said where it was.

Position fixes find a road without the gyro. Afterwards the gyro can be held to the map: over a section the integrated
yaw rate follows the heading of the road, but for an offset, a drift, and a lane that is not kept exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.plausibility import Finding, Level, Sensor

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray
    from vehicle_client.mapmatch.driven_line import DrivenLine
    from vehicle_client.mapmatch.match import SectionMatch

STRIDE_COUNT = 25
"""A heading every quarter of a second: a car turns no faster than that tells."""
WANDER_STD_RAD = 0.1
"""Residuals between neighbouring headings are not independent of each other; this is what one of them is worth."""
DRIFT_STD_RADPS = 0.003
GAIN_STD_RATIO = 0.3
SHIFT_STD_M = 10.0
ROWS_MIN_COUNT = 8
GAIN_KNOWN_STD_RATIO = 0.025
"""A gain that is known no better counts less: a car on a slalom need not follow the line."""
MAP_GAIN = Level(0.09, 0.3)
MAP_RMS_RAD = Level(0.2, 0.4)


@dataclass(frozen=True, slots=True)
class HeadingFit:
    """How the gained heading follows the map's.

    Attributes:
        gain_error_ratio: 0 if the gyro shows all of the map's turns, -1 if none, -2 if mirrored.
        gain_error_std_ratio: How well that is known.
        shift_m: So many metres further along the road the headings agree best; the match is behind by that much.
        shift_std_m: How well that is known.
        rms_rad: What remains.
    """

    gain_error_ratio: float
    gain_error_std_ratio: float
    shift_m: float
    shift_std_m: float
    rms_rad: float


def heading_fit(line: DrivenLine, time_s: FloatArray, match: SectionMatch, section: RoadSection) -> HeadingFit | None:
    """Return how the heading of a matched drive follows that of the map; None if it was too short to say.

    Ridge regression of the difference of headings on an offset, a drift, the map's heading (a gain) and the map's
    curvature (a shift along the road), each but the offset with a prior around zero.

    Args:
        line: The drive.
        time_s: Of its samples. (n,)
        match: Where it was.
        section: The map.
    """
    first, beyond = np.searchsorted(time_s, [match.entry_s, match.exit_s])
    rows = slice(int(first), int(beyond), STRIDE_COUNT)
    station, heading = match.station_m[rows], line.heading_rad[rows]
    count = len(station)
    if count < ROWS_MIN_COUNT:
        return None
    profile = section.profile
    mapped = np.interp(station, profile.station_m, profile.heading_rad)
    # The curvature over the same few metres ahead and behind, so that a shift of that size is what it says.
    ahead = np.interp(station + SHIFT_STD_M / 2.0, profile.station_m, profile.heading_rad)
    behind = np.interp(station - SHIFT_STD_M / 2.0, profile.station_m, profile.heading_rad)
    at_s = (np.arange(count) - (count - 1) / 2.0) * (STRIDE_COUNT * SAMPLE_S)
    design = np.column_stack([np.ones(count), at_s, mapped - mapped.mean(), (ahead - behind) / SHIFT_STD_M])
    deviations = np.array([np.inf, DRIFT_STD_RADPS, GAIN_STD_RATIO, SHIFT_STD_M])
    difference = heading - mapped
    difference -= difference.mean()
    normal = design.T @ design / WANDER_STD_RAD**2 + np.diag(deviations**-2.0)
    covariance = np.linalg.inv(normal)
    found = covariance @ (design.T @ difference) / WANDER_STD_RAD**2
    spread = np.sqrt(np.diag(covariance))
    return HeadingFit(
        gain_error_ratio=float(found[2]),
        gain_error_std_ratio=float(spread[2]),
        shift_m=float(found[3]),
        shift_std_m=float(spread[3]),
        rms_rad=float(np.sqrt(np.mean((difference - design @ found) ** 2))),
    )


def heading_findings(fit: HeadingFit | None) -> tuple[Finding, ...]:
    """Return what the map says of the gyro, on a match that does not rest on the gyro."""
    if fit is None:
        return ()
    known = min(1.0, (GAIN_KNOWN_STD_RATIO / fit.gain_error_std_ratio) ** 2)
    return (
        Finding(
            Sensor.GYRO, "turns more or less than the map, as a share", known * abs(fit.gain_error_ratio), MAP_GAIN
        ),
        Finding(Sensor.GYRO, "strays from the heading of the map, rad", fit.rms_rad, MAP_RMS_RAD),
    )

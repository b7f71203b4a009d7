"""The road as it is driven: the section with a straight approach before it and a straight exit behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray
    from vehicle_client.simulator.plan import PassagePlan

EASING_M = 30.0
"""Length over which approach and exit ease into a curve that the map cuts; nothing where the section ends straight."""
RUN_IN_M = 10.0
"""Road behind the start, for the rear axle."""
RUN_OUT_M = 150.0
"""Road beyond the exit, so that the driver sees no end of the world."""

# Columns of `Track.lines`: the first five are what `chassis` reads.
LEFT_MU, RIGHT_MU = 5, 6
COLUMNS_COUNT = 7


@dataclass(frozen=True, slots=True)
class Track:
    """Samples of equal step along the road; stations count from the start of the section.

    Attributes:
        start_m: Station of the first sample.
        step_m: Between samples, about a metre.
        lines: Curvature, grade, cross slope, change of grade and of cross slope per metre, friction times wear on the
            left and on the right. (n, 7)
        x_m: Centre line, east. (n,)
        y_m: North. (n,)
        heading_rad: Unwrapped. (n,)
    """

    start_m: float
    step_m: float
    lines: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray

    @property
    def station_m(self) -> FloatArray:
        """Stations of the samples. (n,)"""
        return self.start_m + self.step_m * np.arange(len(self.x_m), dtype=np.float64)


def track_of(section: RoadSection, plan: PassagePlan) -> Track:
    """Return the road to drive.

    Approach and exit keep the grade of the section's ends. Where the section starts or ends inside a curve, curvature
    and cross slope fade to zero over 30 m (a clothoid), or half the approach if that is shorter.

    Args:
        section: The road.
        plan: For the lengths of approach and exit, and for friction and wear.
    """
    profile = section.profile
    step = float(profile.station_m[1] - profile.station_m[0])
    before = int(np.ceil((plan.approach_m + RUN_IN_M) / step))
    after = int(np.ceil((plan.exit_m + RUN_OUT_M) / step))
    station = np.concatenate(
        [
            step * np.arange(-before, 0),
            profile.station_m,
            profile.station_m[-1] + step * np.arange(1, after + 1),
        ]
    )
    ease_in = min(EASING_M, 0.5 * plan.approach_m + 1e-9)
    ease_out = min(EASING_M, 0.5 * plan.exit_m + 1e-9)
    fade = np.interp(station, [-ease_in, 0.0, section.length_m, section.length_m + ease_out], [0.0, 1.0, 1.0, 0.0])
    curvature = fade * _extended(profile.curvature_1pm, before=before, after=after)
    cross_slope = fade * _extended(profile.cross_slope_ratio, before=before, after=after)
    grade = _extended(profile.grade_ratio, before=before, after=after)

    # Outside the section the line follows from its curvature; inside it is the map's own.
    turned = _integral(curvature, step)
    heading = turned - turned[before] + profile.heading_rad[0]
    heading[before:-after] = profile.heading_rad
    heading[-after:] = turned[-after:] - turned[-after - 1] + profile.heading_rad[-1]
    x = _line(np.cos(heading), profile.x_m, step, before=before, after=after)
    y = _line(np.sin(heading), profile.y_m, step, before=before, after=after)

    if plan.friction_profile is None:
        left = right = np.full(len(station), plan.base_friction_mu)
    else:
        known = plan.friction_profile
        left = np.interp(station, known.station_m, known.left_mu)
        right = np.interp(station, known.station_m, known.right_mu)
    lines = np.column_stack(
        [
            curvature,
            grade,
            cross_slope,
            np.gradient(grade, step),
            np.gradient(cross_slope, step),
            left * plan.tyre_factor,
            right * plan.tyre_factor,
        ]
    )
    return Track(start_m=float(station[0]), step_m=step, lines=lines, x_m=x, y_m=y, heading_rad=heading)


def _extended(values: FloatArray, *, before: int, after: int) -> FloatArray:
    return np.pad(values, (before, after), mode="edge")


def _integral(values: FloatArray, step: float) -> FloatArray:
    integral = np.zeros(len(values))
    np.cumsum(0.5 * (values[1:] + values[:-1]) * step, out=integral[1:])
    return integral


def _line(direction: FloatArray, known: FloatArray, step: float, *, before: int, after: int) -> FloatArray:
    travelled = _integral(direction, step)
    line: FloatArray = travelled - travelled[before] + known[0]
    line[before:-after] = known
    line[-after:] = travelled[-after:] - travelled[-after - 1] + known[-1]
    return line

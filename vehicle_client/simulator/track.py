"""The road as it is driven: the section with a straight approach before it and a straight exit behind it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import GRAVITY_MPS2

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

STRAIGHT_1PM = 1e-4
"""A curvature below which the driver sees a straight road."""

# Columns of `Track.lines`.
TRACK_CURVATURE, TRACK_GRADE, TRACK_CROSS_SLOPE, TRACK_GRADE_CHANGE, TRACK_CROSS_CHANGE = 0, 1, 2, 3, 4
LEFT_MU, RIGHT_MU = 5, 6
RADIUS, BANK_HELP = 7, 8  # of the curve; and what gravity on the bank adds to the square of a safe speed
TRACK_X, TRACK_Y, TRACK_HEADING = 9, 10, 11
COLUMNS_COUNT = 12


@dataclass(frozen=True, slots=True)
class Track:
    """Samples of equal step along the road; stations count from the start of the section.

    Attributes:
        start_m: Station of the first sample.
        step_m: Between samples, about a metre.
        lines: Curvature, grade, cross slope, change of grade and of cross slope per metre, friction times wear on the
            left and on the right, radius, help of the bank, centre line east and north, unwrapped heading. (n, 12)
    """

    start_m: float
    step_m: float
    lines: FloatArray

    @property
    def length_m(self) -> float:
        """From the first to the last sample."""
        return self.step_m * (len(self.lines) - 1)


def track_of(section: RoadSection, plan: PassagePlan) -> Track:
    """Return the road to drive.

    Approach and exit keep the grade of the section's ends. Where the section starts or ends inside a curve, curvature
    and cross slope fade to zero over 30 m (a clothoid), or half the approach if that is shorter.

    Args:
        section: The road.
        plan: For the lengths of approach and exit, and for friction and wear.
    """
    return with_friction(bare_track_of(section, approach_m=plan.approach_m, exit_m=plan.exit_m), plan)


def with_friction(bare: Track, plan: PassagePlan) -> Track:
    """Return a track with the friction that a plan asks for.

    Args:
        bare: From `bare_track_of`.
        plan: For friction, wear and pressure.
    """
    lines = bare.lines.copy()
    known = plan.friction_profile
    if known is None:
        lines[:, LEFT_MU : RIGHT_MU + 1] = plan.base_friction_mu * plan.tyre_factor
    else:
        station = bare.start_m + bare.step_m * np.arange(len(lines), dtype=np.float64)
        lines[:, LEFT_MU] = np.interp(station, known.station_m, known.left_mu) * plan.tyre_factor
        lines[:, RIGHT_MU] = np.interp(station, known.station_m, known.right_mu) * plan.tyre_factor
    return replace(bare, lines=lines)


def bare_track_of(section: RoadSection, *, approach_m: float, exit_m: float) -> Track:
    """Return the road to drive without friction, the same for all who drive it from and to the same places.

    Args:
        section: The road.
        approach_m: Driven before the section starts.
        exit_m: Driven beyond its end.
    """
    profile = section.profile
    step = float(profile.station_m[1] - profile.station_m[0])
    before = int(np.ceil((approach_m + RUN_IN_M) / step))
    after = int(np.ceil((exit_m + RUN_OUT_M) / step))
    station = np.concatenate(
        [
            step * np.arange(-before, 0),
            profile.station_m,
            profile.station_m[-1] + step * np.arange(1, after + 1),
        ]
    )
    ease_in = min(EASING_M, 0.5 * approach_m + 1e-9)
    ease_out = min(EASING_M, 0.5 * exit_m + 1e-9)
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

    radius = 1.0 / np.maximum(np.abs(curvature), STRAIGHT_1PM)
    bank_help = -GRAVITY_MPS2 * cross_slope * np.sign(curvature) * radius
    friction = np.full(len(station), np.nan)  # none yet
    columns = [
        *(curvature, grade, cross_slope, np.gradient(grade, step), np.gradient(cross_slope, step)),
        *(friction, friction, radius, bank_help, x, y, heading),
    ]
    return Track(start_m=float(station[0]), step_m=step, lines=np.column_stack(columns))


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

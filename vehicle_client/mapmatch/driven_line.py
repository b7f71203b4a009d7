"""The line that a car drove, in its own coordinates: from speed and yaw rate, and what else is known of its motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vehicle_client.estimation.filters import integral

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

COURSE_SPEED_MIN_MPS = 2.0
"""Slower than this a course is taken as of that speed: a little lateral velocity would turn a standing car around."""


@dataclass(frozen=True, slots=True)
class DrivenLine:
    """A drive in its own coordinates: the first sample lies at the origin and heads along x. All arrays (n,).

    Attributes:
        distance_m: Travelled.
        heading_rad: Gained since the first sample, left positive.
        x_m: Position.
        y_m: Position.
        height_m: Gained since the first sample, if it is known.
        course_rad: Where the car moved to, if its lateral velocity is known: a car that slides does not follow its
            nose. From where the nose first pointed, left positive.
    """

    distance_m: FloatArray
    heading_rad: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    height_m: FloatArray | None = None
    course_rad: FloatArray | None = None


def driven_line(
    speed_mps: FloatArray,
    yaw_rate_radps: FloatArray,
    velocity_y_mps: FloatArray | None = None,
    vertical_velocity_mps: FloatArray | None = None,
) -> DrivenLine:
    """Return the line of a vehicle from its speed and yaw rate; what is no number stays none, without a warning.

    Args:
        speed_mps: Forward. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        velocity_y_mps: Left, if it is known. (n,)
        vertical_velocity_mps: Up, if it is known. (n,)
    """
    left = np.zeros_like(speed_mps) if velocity_y_mps is None else velocity_y_mps
    with np.errstate(invalid="ignore", over="ignore"):
        heading = integral(yaw_rate_radps)
        cos_h, sin_h = np.cos(heading), np.sin(heading)
        return DrivenLine(
            distance_m=integral(np.hypot(np.maximum(speed_mps, 0.0), left)),
            heading_rad=heading,
            x_m=integral(speed_mps * cos_h - left * sin_h),
            y_m=integral(speed_mps * sin_h + left * cos_h),
            height_m=None if vertical_velocity_mps is None else integral(vertical_velocity_mps),
        )


def with_course(line: DrivenLine, *, speed_mps: FloatArray, velocity_y_mps: FloatArray | None) -> DrivenLine:
    """Return a line that knows which way the car moved, unless its lateral velocity is not known throughout.

    Distance and positions stay those of the nose: an estimate that went astray harms the course alone.

    Args:
        line: From `driven_line`.
        speed_mps: Forward. (n,)
        velocity_y_mps: Left, as estimated. (n,)
    """
    if velocity_y_mps is None or not np.isfinite(velocity_y_mps).all():
        return line
    return replace(
        line, course_rad=line.heading_rad + np.arctan2(velocity_y_mps, np.maximum(speed_mps, COURSE_SPEED_MIN_MPS))
    )

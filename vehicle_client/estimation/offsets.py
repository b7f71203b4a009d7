"""What the sensors read when they should read zero, estimated on the straight before the section."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import GRAVITY_MPS2, SAMPLE_S
from vehicle_client.estimation.filters import smoothed

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray

STRAIGHT_CURVATURE_1PM = 1.0 / 800.0
"""A driven line that bends less than this counts as straight."""
STRAIGHT_S_MIN = 1.0
"""Shorter straights say nothing."""
SPEED_MIN_MPS = 5.0
WANDER_RAD = 0.008
"""How far the heading of a car that keeps its lane on a straight strays between two moments; one standard deviation."""
CROSS_FALL_MPS2 = 0.2
"""Gravity along the cross fall of an unmapped straight: 2 %. The map's bank where the section starts does not tell it:
a road turns its surface within some ten metres before a curve."""
GRADE_MPS2 = 0.15
"""Gravity along what the grade of an unmapped approach differs from the map's at its start: 1.5 %."""
SPEED_NOISE_MPS = 0.05
"""Of the smoothed speed at either end of the straight."""
STEER_NOISE_RAD = 0.001
"""Steps of the sensor, and what holds the car against a cross fall."""

PRIOR_YAW_RATE_STD_RADPS = 0.002
"""What is left after a calibration at standstill: 0.1 degrees per second."""
PRIOR_ACCEL_STD_MPS2 = 0.1
PRIOR_STEER_STD_RAD = 0.009
UNCERTAIN_YAW_RATE_STD_RADPS = 0.0019
"""Hardly better than the prior: the summary is flagged."""


@dataclass(frozen=True, slots=True)
class SensorOffsets:
    """Offsets to subtract, each with one standard deviation of what remains.

    Attributes:
        yaw_rate_radps: Of the gyro.
        yaw_rate_std_radps: How well it is known.
        accel_x_mps2: Of the forward accelerometer.
        accel_x_std_mps2: How well it is known.
        accel_y_mps2: Of the lateral accelerometer.
        accel_y_std_mps2: How well it is known.
        steer_rad: Of the steering angle.
        steer_std_rad: How well it is known.
        straight_s: Duration of the straight they come from; 0 if there was none, and the offsets are then 0.
    """

    yaw_rate_radps: float
    yaw_rate_std_radps: float
    accel_x_mps2: float
    accel_x_std_mps2: float
    accel_y_mps2: float
    accel_y_std_mps2: float
    steer_rad: float
    steer_std_rad: float
    straight_s: float

    @property
    def uncertain(self) -> bool:
        """Whether the approach added next to nothing to what was known before."""
        return self.yaw_rate_std_radps > UNCERTAIN_YAW_RATE_STD_RADPS


NO_OFFSETS = SensorOffsets(
    yaw_rate_radps=0.0,
    yaw_rate_std_radps=PRIOR_YAW_RATE_STD_RADPS,
    accel_x_mps2=0.0,
    accel_x_std_mps2=PRIOR_ACCEL_STD_MPS2,
    accel_y_mps2=0.0,
    accel_y_std_mps2=PRIOR_ACCEL_STD_MPS2,
    steer_rad=0.0,
    steer_std_rad=PRIOR_STEER_STD_RAD,
    straight_s=0.0,
)


def sensor_offsets(
    accel_y_mps2: FloatArray,
    yaw_rate_radps: FloatArray,
    steer_rad: FloatArray,
    speed_mps: FloatArray,
    approach: BoolArray,
    *,
    accel_x_mps2: FloatArray,
    climb_rad: float,
    wheelbase_m: float,
) -> SensorOffsets:
    """Return the offsets seen on the longest straight stretch of the approach, shrunk by how little it tells.

    On a straight the mean yaw rate is the gyro's offset plus a heading that wandered; the lateral force beyond the
    centripetal one is the lateral accelerometer's offset plus the cross fall of a road that no map describes; the
    forward force beyond the change of speed is the forward accelerometer's offset plus a grade that is about the one
    with which the map starts; the steering beyond what the yaw rate needs is the steering's offset. Each measurement is
    combined with a prior around zero, both Gaussian, so a short straight corrects little, and an offset that cannot be
    told from the road is corrected by a part only. Zero stays zero and mirrored signals give mirrored offsets.

    Args:
        accel_y_mps2: Specific force to the left. (n,)
        yaw_rate_radps: Left turn positive. (n,)
        steer_rad: Mean angle of the front wheels. (n,)
        speed_mps: Forward. (n,)
        approach: True before the section starts, in samples that are not missing. (n,)
        accel_x_mps2: Specific force forward. (n,)
        climb_rad: Grade of the road where the map starts, as an angle, uphill positive.
        wheelbase_m: Front to rear axle.
    """
    if approach.sum() * SAMPLE_S < STRAIGHT_S_MIN:
        return NO_OFFSETS
    fast = speed_mps > SPEED_MIN_MPS
    bend = np.abs(smoothed(yaw_rate_radps)) / np.maximum(speed_mps, SPEED_MIN_MPS)
    start, end = _longest_run(approach & fast & (bend < STRAIGHT_CURVATURE_1PM))
    count = end - start
    duration = count * SAMPLE_S
    if duration < STRAIGHT_S_MIN:
        return NO_OFFSETS
    here = slice(start, end)
    yaw_rate, yaw_rate_std = _combined(
        float(np.mean(yaw_rate_radps[here])),
        measured_std=float(np.hypot(WANDER_RAD / duration, np.std(yaw_rate_radps[here]) / np.sqrt(count))),
        prior_std=PRIOR_YAW_RATE_STD_RADPS,
    )
    turning = yaw_rate_radps[here] - yaw_rate
    accel_y, accel_y_std = _combined(
        float(np.mean(accel_y_mps2[here] - speed_mps[here] * turning)),
        measured_std=float(np.hypot(CROSS_FALL_MPS2, np.mean(speed_mps[here]) * yaw_rate_std)),
        prior_std=PRIOR_ACCEL_STD_MPS2,
    )
    gained = float(speed_mps[end - 1] - speed_mps[start]) / duration
    accel_x, accel_x_std = _combined(
        float(np.mean(accel_x_mps2[here])) - gained - GRAVITY_MPS2 * float(np.sin(climb_rad)),
        measured_std=float(np.hypot(GRADE_MPS2, np.sqrt(2.0) * SPEED_NOISE_MPS / duration)),
        prior_std=PRIOR_ACCEL_STD_MPS2,
    )
    lever = wheelbase_m / speed_mps[here]
    steer, steer_std = _combined(
        float(np.mean(steer_rad[here] - lever * turning)),
        measured_std=float(np.hypot(STEER_NOISE_RAD, np.mean(lever) * yaw_rate_std)),
        prior_std=PRIOR_STEER_STD_RAD,
    )
    return SensorOffsets(
        yaw_rate_radps=yaw_rate,
        yaw_rate_std_radps=yaw_rate_std,
        accel_x_mps2=accel_x,
        accel_x_std_mps2=accel_x_std,
        accel_y_mps2=accel_y,
        accel_y_std_mps2=accel_y_std,
        steer_rad=steer,
        steer_std_rad=steer_std,
        straight_s=duration,
    )


def _combined(measured: float, *, measured_std: float, prior_std: float) -> tuple[float, float]:
    """Return mean and standard deviation of a Gaussian measurement with a Gaussian prior around zero."""
    weight = prior_std**2 / (prior_std**2 + measured_std**2)
    return weight * measured, float(np.sqrt(weight) * measured_std)


def _longest_run(mask: BoolArray) -> tuple[int, int]:
    """Return start and end of the longest run of true; 0, 0 if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    if len(edges) == 0:
        return 0, 0
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest])

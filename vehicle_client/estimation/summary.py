"""From the signals inside a section to the kinematic summary."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.features import NEWEST_TABLE, statistics_of
from roadgrip.records import KinematicSummary, QualityFlag

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class KinematicSignals:
    """What the onboard client estimates, at every sample of the trace. All arrays (n,).

    Attributes:
        steer_rad: Mean angle of the front wheels, left positive, smoothed.
        sideslip_rad: Left positive.
        sideslip_rate_radps: As the paper estimates it.
        yaw_rate_excess_radps: Positive in a left turn means oversteer.
        speed_mps: Forward, from the encoders, smoothed.
        velocity_x_mps: Forward, from the observer.
        velocity_y_mps: Left, from the observer.
        yaw_rate_radps: Left turn positive, offset taken out.
        chassis_roll_rad: Body against road, left side up positive.
        straightness_1ps: F(t) of the observer.
    """

    steer_rad: FloatArray
    sideslip_rad: FloatArray
    sideslip_rate_radps: FloatArray
    yaw_rate_excess_radps: FloatArray
    speed_mps: FloatArray
    velocity_x_mps: FloatArray
    velocity_y_mps: FloatArray
    yaw_rate_radps: FloatArray
    chassis_roll_rad: FloatArray
    straightness_1ps: FloatArray


def kinematic_summary(
    signals: KinematicSignals,
    inside: BoolArray,
    *,
    grip_features: FloatArray,
    duration_s: float,
    quality: QualityFlag = QualityFlag.NONE,
) -> KinematicSummary:
    """Return the summary: statistics of the bag of samples inside the section, whatever their order, and the grip.

    Args:
        signals: Over the whole trace.
        inside: True for the samples that count, at least one. (n,)
        grip_features: In the order of the table (`vehicle_client.estimation.grip`).
        duration_s: Time between the two ends of the section.
        quality: What the vehicle says about it.

    Raises:
        ValueError: No sample counts, or one of them is not finite.
    """
    bags = (
        signals.steer_rad,
        signals.sideslip_rad,
        signals.sideslip_rate_radps,
        signals.yaw_rate_excess_radps,
        signals.speed_mps,
    )
    values = np.concatenate([*(statistics_of(bag[inside]) for bag in bags), grip_features])
    return KinematicSummary(
        values=tuple(values.tolist()), table_digest=NEWEST_TABLE.digest, duration_s=duration_s, quality=quality
    )

"""What the physical inverse looks at: forces and motion of the car, sampled about ten times a second."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import GRAVITY_MPS2, SAMPLE_S
from vehicle_client.estimation.filters import EDGE_SAMPLES_COUNT, rate_of_change, smoothed
from vehicle_client.estimation.trace import WHEELS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from roadgrip.section import RoadSection
    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.estimation.handling import Handling
    from vehicle_client.estimation.mounting import InertialSignals

SPEED_MIN_MPS = 2.0
"""Below it angles of velocities mean nothing; divisions use this instead."""
MEAN_OF_COUNT = 20
"""Samples that are averaged: 0.2 s, in which a driver changes little, and noise much."""
STEP_MIN_COUNT = 10
SAMPLES_LIMIT_COUNT = 300
"""Longer passages are sampled more coarsely, so that the work has a bound."""
NORMAL_MIN_MPS2 = 3.0
"""Cars do not fly; a map that says so has a kink."""
_MARGIN_COUNT = 50
"""Samples before and after the section: slow parts need some room to be told from ends."""
_REACH_COUNT = EDGE_SAMPLES_COUNT + 1 + MEAN_OF_COUNT // 2
"""How far from a sample the values lie that its smoothed rate's mean is made of."""


class Evidence(StrEnum):
    """Where slip shows, or that a force could not be more."""

    LIMIT = "limit"
    STEERING = "steering"
    DRIFT = "drift"
    WHEELS = "wheels"


_TURNING = frozenset({"accel_y_mps2", "yaw_rate_radps"})
_NEEDED = {
    Evidence.LIMIT: _TURNING,
    Evidence.STEERING: _TURNING | {"steer_rad"},
    Evidence.DRIFT: _TURNING,
    # Front wheels roll along a path that the steering tells.
    Evidence.WHEELS: _TURNING | {"steer_rad", "accel_x_mps2"} | {f"wheel_{wheel}_mps" for wheel in WHEELS},
}


@dataclass(frozen=True, slots=True)
class Motion:
    """The motion of a car over a section. All arrays (n,) unless said.

    Attributes:
        step_s: Time between samples.
        inside: Whether a sample lies inside the section.
        counted_weight: How many independent samples each one inside stands for; 0 outside.
        speed_mps: Forward, from the encoders.
        yaw_rate_radps: Left turn positive.
        yaw_accel_radps2: Its rate.
        steer_rad: Mean angle of the front wheels as sensed, offset taken out.
        force_x_mps2: Longitudinal force of the tyres and the air per mass.
        force_y_mps2: Lateral force of the tyres per mass.
        force_y_rate_mps3: Its rate.
        normal_mps2: Force of the road per mass, at right angles to it.
        bank_rad: Cross slope of the road, left edge up positive.
        front_wheels_mps: Mean of both front wheels.
        rear_wheels_mps: Mean of both rear wheels.
        silent: What tells nothing of friction, since a sensor that it needs is absent.
    """

    step_s: float
    inside: BoolArray
    counted_weight: FloatArray
    speed_mps: FloatArray
    yaw_rate_radps: FloatArray
    yaw_accel_radps2: FloatArray
    steer_rad: FloatArray
    force_x_mps2: FloatArray
    force_y_mps2: FloatArray
    force_y_rate_mps3: FloatArray
    normal_mps2: FloatArray
    bank_rad: FloatArray
    front_wheels_mps: FloatArray
    rear_wheels_mps: FloatArray
    silent: frozenset[Evidence] = frozenset()


def silent_without(absent: tuple[str, ...]) -> frozenset[Evidence]:
    """Return what tells nothing of friction on a car that lacks some sensors.

    Without the lateral force or the turning nothing does: whatever stands in for one of them is made of the other.

    Args:
        absent: As in `Trace`.
    """
    return frozenset(evidence for evidence, needed in _NEEDED.items() if needed & set(absent))


def motion_over(
    section: RoadSection,
    measured: InertialSignals,
    *,
    station_m: FloatArray,
    inside: BoolArray,
    speed_mps: FloatArray,
    steer_rad: FloatArray,
    wheel_speed_mps: FloatArray,
    handling: Handling,
    level_gain_ratio: float,
    absent: tuple[str, ...] = (),
) -> Motion:
    """Return the motion over a section, from signals every 10 ms.

    The lateral accelerometer tells well how the force changes, but hides an offset; turning and map tell the mean of
    the force, but not its changes. So the accelerometer's mean over the section is drawn to theirs.

    Args:
        section: The map, for bank, grade and crests.
        measured: Specific force and rates at the centre of gravity, offsets taken out.
        station_m: Position along the section. (n,)
        inside: Which samples lie inside the section, at least one. (n,)
        speed_mps: Forward, from the encoders. (n,)
        steer_rad: Mean angle of the front wheels, offset taken out. (n,)
        wheel_speed_mps: Columns as in `WHEELS`. (n, 4)
        handling: Of the own car.
        level_gain_ratio: Which share of the difference between both means is taken off.
        absent: Channels that the car lacks, as in `Trace`; turning, change of speed and map then stand in for forces.
    """
    first, last = np.flatnonzero(inside)[[0, -1]]
    start, end = max(0, int(first) - _MARGIN_COUNT), min(len(inside), int(last) + _MARGIN_COUNT + 1)
    step = max(STEP_MIN_COUNT, -(-(end - start) // SAMPLES_LIMIT_COUNT))
    # What lies farther away than filters and means reach is nobody's concern.
    here = slice(max(0, start - _REACH_COUNT), end + _REACH_COUNT)
    speed, yaw_rate, counted = speed_mps[here], measured.yaw_rate_radps[here], inside[here]
    profile = section.profile
    crest_1pm = np.gradient(profile.grade_ratio, profile.station_m)
    slope, grade, crest = (
        np.interp(station_m[here], profile.station_m, values)
        for values in (profile.cross_slope_ratio, profile.grade_ratio, crest_1pm)
    )
    bank = np.arctan(slope)
    # The body leans out of the turn and takes its sensor along, which then feels a share of gravity; it nods likewise.
    force_y = measured.accel_y_mps2[here] / (1.0 + GRAVITY_MPS2 * handling.roll_gradient_s2pm)
    force_x = measured.accel_x_mps2[here] / (1.0 + GRAVITY_MPS2 * handling.pitch_gradient_s2pm)
    turning = yaw_rate * speed + GRAVITY_MPS2 * np.sin(bank)
    if "accel_y_mps2" in absent:
        force_y = turning
    if "accel_x_mps2" in absent:
        force_x = rate_of_change(speed) + GRAVITY_MPS2 * np.sin(np.arctan(grade))
    force_y = force_y + level_gain_ratio * float((turning - force_y)[counted].mean())
    # Banked inwards (negative in a left turn), or in a dip, a road bears more than the car's weight.
    normal = GRAVITY_MPS2 * np.cos(bank) / np.sqrt(1.0 + grade**2) + speed**2 * crest
    normal = np.maximum(normal - speed * yaw_rate * slope, NORMAL_MIN_MPS2)
    wheels = wheel_speed_mps[here]
    signals = (
        speed,
        yaw_rate,
        rate_of_change(smoothed(yaw_rate)),
        steer_rad[here],
        force_x,
        force_y,
        rate_of_change(smoothed(force_y)),
        normal,
        bank,
        0.5 * (wheels[:, 0] + wheels[:, 1]),
        0.5 * (wheels[:, 2] + wheels[:, 3]),
    )
    rows = np.arange(start + step // 2, end, step)
    mean_speed, turn, turn_rate, steer, along, across, across_rate, upward, banked, front, rear = _means_at(
        rows - here.start, signals
    )
    sampled = inside[rows]
    return Motion(
        step_s=step * SAMPLE_S,
        inside=sampled,
        counted_weight=np.where(sampled, min(1.0, step / MEAN_OF_COUNT), 0.0),
        speed_mps=np.maximum(mean_speed, SPEED_MIN_MPS),
        yaw_rate_radps=turn,
        yaw_accel_radps2=turn_rate,
        steer_rad=steer,
        force_x_mps2=along,
        force_y_mps2=across,
        force_y_rate_mps3=across_rate,
        normal_mps2=upward,
        bank_rad=banked,
        front_wheels_mps=front,
        rear_wheels_mps=rear,
        silent=silent_without(absent),
    )


def _means_at(places: NDArray[np.intp], signals: tuple[FloatArray, ...]) -> FloatArray:
    """Return centred moving means at some places, ends held. (signals, places)"""
    half, count = MEAN_OF_COUNT // 2, len(signals[0])
    sums = np.zeros((len(signals), count + MEAN_OF_COUNT))
    for total, signal in zip(sums, signals, strict=True):
        total[1 : half + 1] = signal[0]
        total[half + 1 : half + 1 + count] = signal
        total[half + 1 + count :] = signal[-1]
    np.cumsum(sums, axis=1, out=sums)
    means: FloatArray = (sums[:, places + MEAN_OF_COUNT] - sums[:, places]) / MEAN_OF_COUNT
    return means

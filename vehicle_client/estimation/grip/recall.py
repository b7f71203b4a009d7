"""The motion over a section as a car sees it that remembers what its sensors get wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from vehicle_client.estimation.grip.memory import handling_with, noise_with
from vehicle_client.estimation.grip.motion import motion_over

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.estimation.grip.memory import CarMemory
    from vehicle_client.estimation.grip.motion import Motion
    from vehicle_client.estimation.grip.noise import GripNoise
    from vehicle_client.estimation.handling import Handling
    from vehicle_client.estimation.mounting import InertialSignals
    from vehicle_client.estimation.offsets import SensorOffsets


@dataclass(frozen=True, slots=True)
class Sensed:
    """What was sensed over a section, every 10 ms, the offsets taken out that the approach showed.

    Attributes:
        section: The map.
        measured: At the centre of gravity.
        offsets: What was taken out.
        station_m: Position along the section. (n,)
        inside: Which samples lie inside the section, at least one. (n,)
        speed_mps: Forward, from the encoders. (n,)
        steer_rad: Mean angle of the front wheels. (n,)
        wheel_speed_mps: Columns as in `WHEELS`. (n, 4)
        absent: Channels that the car lacks, as in `Trace`.
    """

    section: RoadSection
    measured: InertialSignals
    offsets: SensorOffsets
    station_m: FloatArray
    inside: BoolArray
    speed_mps: FloatArray
    steer_rad: FloatArray
    wheel_speed_mps: FloatArray
    absent: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Recalled:
    """What the physical inverse starts from.

    Attributes:
        motion: Of the car over the section.
        handling: Of the car.
        noise: Of its sensors.
    """

    motion: Motion
    handling: Handling
    noise: GripNoise


def recalled(
    sensed: Sensed, *, handling: Handling, noise: GripNoise, memory: CarMemory | None, approach_counts: bool = True
) -> Recalled:
    """Return what a car makes of what it sensed, by what it remembers; as declared if it remembers nothing.

    Offsets of the accelerometers are those remembered, since an unmapped approach hides them behind its own slopes.
    That of the steering is both: the approach shows it, too.

    Args:
        sensed: Over the section.
        handling: As declared.
        noise: As declared.
        memory: Of the car.
        approach_counts: Whether what the approach says of the steering is heard beside the memory.
    """
    if memory is not None:
        steer_std_rad = sensed.offsets.steer_std_rad
        steer_rad = memory.value("steer_offset_rad")
        if approach_counts:
            variance = memory.std("steer_offset_rad") ** 2
            steer_rad += variance / (variance + steer_std_rad**2) * (sensed.offsets.steer_rad - steer_rad)
        sensed = _without_remembered(sensed, memory, steer_offset_rad=steer_rad)
        handling = handling_with(handling, memory)
        noise = noise_with(noise, memory, approach_steer_std_rad=steer_std_rad)
    motion = motion_over(
        sensed.section,
        sensed.measured,
        station_m=sensed.station_m,
        inside=sensed.inside,
        speed_mps=sensed.speed_mps,
        steer_rad=sensed.steer_rad,
        wheel_speed_mps=sensed.wheel_speed_mps,
        handling=handling,
        level_gain_ratio=noise.level_gain_ratio,
        absent=sensed.absent,
    )
    return Recalled(motion, handling, noise)


def _without_remembered(sensed: Sensed, memory: CarMemory, *, steer_offset_rad: float) -> Sensed:
    measured, offsets = sensed.measured, sensed.offsets
    accel_y = measured.accel_y_mps2 + offsets.accel_y_mps2 - memory.value("accel_y_offset_mps2")
    wheels = sensed.wheel_speed_mps.copy()
    wheels[:, :2] /= 1.0 + memory.value("front_radius_ratio")
    return replace(
        sensed,
        measured=replace(
            measured,
            accel_x_mps2=measured.accel_x_mps2 + offsets.accel_x_mps2 - memory.value("accel_x_offset_mps2"),
            accel_y_mps2=accel_y / (1.0 + memory.value("accel_y_scale_ratio")),
            yaw_rate_radps=measured.yaw_rate_radps / (1.0 + memory.value("yaw_rate_scale_ratio")),
        ),
        steer_rad=sensed.steer_rad + offsets.steer_rad - steer_offset_rad,
        wheel_speed_mps=wheels,
    )

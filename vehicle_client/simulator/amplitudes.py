"""How large the errors of sensors and map are: one record, two grades, and a way to scale them all.

The automotive numbers are those of the project's starting table, checked against what makers publish (decision 0008);
they change only with a written decision, before any training.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vehicle_client.simulator.plan import SensorGrade

if TYPE_CHECKING:
    from collections.abc import Mapping


class Sensors(NamedTuple):
    """Amplitudes of all errors. One standard deviation unless said; zero means exact.

    Attributes:
        gyro_noise_radps: Per sample.
        gyro_bias_radps: What standstill calibration leaves.
        gyro_scale_ratio: Of the rate.
        accel_noise_mps2: Per sample.
        accel_bias_mps2: Residual.
        accel_scale_ratio: Of the acceleration.
        misalignment_rad: Of the unit, about each axis.
        mount_m: Where the unit sits by design, forward and to the left of the centre of gravity (not a deviation).
        mount_error_m: How well that is known, forward and left each.
        steer_offset_rad: At the road wheel.
        steer_quantum_rad: Resolution (not a deviation).
        radius_common_ratio: Of all four rolling radii together.
        radius_each_ratio: Of each.
        wheel_noise_ratio: Of the wheel speed, per sample.
        wheel_quantum_mps: Resolution (not a deviation).
        jitter_s: Of the time stamps, for every sender by itself.
        gnss_position_m: Per horizontal axis; drifts over `gnss_memory_s`.
        gnss_speed_mps: Of the ground speed, per fix.
        gnss_memory_s: Correlation time of the position error.
        gnss_rate_hz: Fixes per second (not a deviation).
        map_bank_rad: Of the cross slope that the map says.
        map_grade_rad: Of the grade that the map says.
        map_memory_m: Correlation length of that half of the map's errors which varies along the road.
    """

    gyro_noise_radps: float = 0.0
    gyro_bias_radps: float = 0.0
    gyro_scale_ratio: float = 0.0
    accel_noise_mps2: float = 0.0
    accel_bias_mps2: float = 0.0
    accel_scale_ratio: float = 0.0
    misalignment_rad: float = 0.0
    mount_m: float = 0.0
    mount_error_m: float = 0.0
    steer_offset_rad: float = 0.0
    steer_quantum_rad: float = 0.0
    radius_common_ratio: float = 0.0
    radius_each_ratio: float = 0.0
    wheel_noise_ratio: float = 0.0
    wheel_quantum_mps: float = 0.0
    jitter_s: float = 0.0
    gnss_position_m: float = 0.0
    gnss_speed_mps: float = 0.0
    gnss_memory_s: float = 120.0
    gnss_rate_hz: float = 10.0
    map_bank_rad: float = 0.0
    map_grade_rad: float = 0.0
    map_memory_m: float = 100.0


_DEG = float(np.pi / 180.0)
_NO_AMPLITUDES = ("gnss_memory_s", "gnss_rate_hz", "map_memory_m")

IDEAL = Sensors()
"""Exact sensors and an exact map, on a real road surface: the paper's setting."""
AUTOMOTIVE = Sensors(
    gyro_noise_radps=0.1 * _DEG,
    gyro_bias_radps=0.1 * _DEG,
    gyro_scale_ratio=0.01,
    accel_noise_mps2=0.03,
    accel_bias_mps2=0.05,
    accel_scale_ratio=0.01,
    misalignment_rad=0.5 * _DEG,
    mount_m=0.1,
    mount_error_m=0.02,
    steer_offset_rad=0.05 * _DEG,
    steer_quantum_rad=0.1 * _DEG,
    radius_common_ratio=0.003,
    radius_each_ratio=0.002,
    wheel_noise_ratio=0.003,
    wheel_quantum_mps=0.0156,
    jitter_s=0.002,
    gnss_position_m=1.5,
    gnss_speed_mps=0.1,
    map_bank_rad=0.3 * _DEG,
    map_grade_rad=0.2 * _DEG,
)
"""What a production car carries, and the map a road authority can give it."""
SENSORS: Mapping[SensorGrade, Sensors] = {SensorGrade.IDEAL: IDEAL, SensorGrade.AUTOMOTIVE: AUTOMOTIVE}


def scaled(sensors: Sensors, ratio: float) -> Sensors:
    """Return sensors with every error so many times as large: 0.5 and 2 for a sensitivity table, 0 for exact ones.

    Rates and memories stay, since they are no amplitudes.

    Args:
        sensors: A grade.
        ratio: Not negative.

    Raises:
        ValueError: The ratio is negative or not finite.
    """
    if not 0.0 <= ratio < np.inf:
        message = f"errors cannot be {ratio} times as large"
        raise ValueError(message)
    changed = {name: float(ratio * value) for name, value in sensors._asdict().items() if name not in _NO_AMPLITUDES}
    return sensors._replace(**changed)

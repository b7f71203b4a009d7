"""How far the physical inverse trusts its sensors: deviations and priors, declared with a grade of sensors."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GripNoise:
    """One standard deviation of everything, of means over 0.2 s where it is noise.

    Attributes:
        steer_rad: What the steering says beyond the model: steps of the sensor, small motions of the wheels.
        force_y_mps2: Noise of the lateral force per mass.
        force_x_mps2: Noise of the longitudinal one.
        velocity_y_mps: What the integrated lateral velocity says beyond the model.
        wheels_ratio: Noise of the difference between front and rear wheel speeds over the speed.
        steer_offset_rad: What the approach leaves of the steering's offset.
        yaw_rate_offset_radps: Of the gyro's.
        yaw_rate_scale_ratio: Of the gyro's scale, and of the speed's.
        force_y_offset_mps2: Of the lateral force's.
        force_x_offset_mps2: Of the longitudinal one's.
        accel_offset_mps2: Of gravity taken out: bank, lean, accelerometer together.
        lean_ratio: Of the share of gravity that goes with the force.
        radius_ratio: Of front over rear rolling radius.
        stiffness_ratio: How well the declared stiffness of the tyres is known.
        level_gain_ratio: How far the accelerometer's mean is drawn to that of turning and map.
    """

    steer_rad: float = 0.6e-3
    force_y_mps2: float = 0.016
    force_x_mps2: float = 0.02
    velocity_y_mps: float = 0.008
    wheels_ratio: float = 0.8e-3
    steer_offset_rad: float = 0.8e-3
    yaw_rate_offset_radps: float = 1.2e-3
    yaw_rate_scale_ratio: float = 0.011
    force_y_offset_mps2: float = 0.045
    force_x_offset_mps2: float = 0.06
    accel_offset_mps2: float = 0.05
    lean_ratio: float = 0.1
    radius_ratio: float = 1.5e-3
    stiffness_ratio: float = 0.01
    level_gain_ratio: float = 0.7


AUTOMOTIVE_NOISE = GripNoise()
"""Sensors of a production car, as measured on simulated drives with the declared amplitudes."""
IDEAL_NOISE = GripNoise(
    steer_rad=0.06e-3,
    force_y_mps2=0.008,
    force_x_mps2=0.01,
    velocity_y_mps=0.002,
    wheels_ratio=0.06e-3,
    steer_offset_rad=0.1e-3,
    yaw_rate_offset_radps=0.1e-3,
    yaw_rate_scale_ratio=0.5e-3,
    force_y_offset_mps2=0.003,
    force_x_offset_mps2=0.002,
    accel_offset_mps2=0.01,
    lean_ratio=0.02,
    radius_ratio=0.03e-3,
    stiffness_ratio=0.003,
    level_gain_ratio=0.7,
)
"""Exact sensors on a rough road: what remains is the road and the model."""

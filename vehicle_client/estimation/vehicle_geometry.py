"""What the onboard client must know of its own car."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class VehicleGeometry:
    """Where wheels and sensors sit; ISO 8855 axes from the centre of gravity.

    Attributes:
        wheelbase_m: Front to rear axle.
        track_m: Left to right wheel, mean of both axles.
        front_axle_m: Centre of gravity to front axle.
        imu_x_m: Position of the accelerometer, forward of the centre of gravity.
        imu_y_m: The same, to the left. Its height is not corrected for.
        imu_roll_rad: How the sensor's axes are turned against the car's: first yaw, then pitch, then roll.
        imu_pitch_rad: The same, nose down positive.
        imu_yaw_rad: The same, turned to the left positive.
    """

    wheelbase_m: float
    track_m: float
    front_axle_m: float
    imu_x_m: float = 0.0
    imu_y_m: float = 0.0
    imu_roll_rad: float = 0.0
    imu_pitch_rad: float = 0.0
    imu_yaw_rad: float = 0.0

    @property
    def rear_axle_m(self) -> float:
        """Centre of gravity to rear axle."""
        return self.wheelbase_m - self.front_axle_m


XC90 = VehicleGeometry(wheelbase_m=2.984, track_m=1.670, front_axle_m=1.43)
"""Volvo XC90 (2015), the car of the paper. Wheelbase and track are the maker's, the centre of gravity an estimate."""

"""How to read three public recordings of real cars."""

from __future__ import annotations

import numpy as np

from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.recording.channels import WHEEL_COLUMNS
from vehicle_client.recording.foreign import Channel, ColumnMapping

_WHEELS_FL_FR_RL_RR = {
    name: Channel(column)
    for name, column in zip(
        WHEEL_COLUMNS, ("wheel_fl_mps", "wheel_fr_mps", "wheel_rl_mps", "wheel_rr_mps"), strict=True
    )
}

FERRARI_250LM = ColumnMapping(
    time_column="t_s",
    channels={
        "accel_x_mps2": Channel("ax"),
        "accel_y_mps2": Channel("ay"),
        "yaw_rate_radps": Channel("yaw_rate"),
        "steer_rad": Channel("delta"),
    },
    reference={
        "velocity_x_mps": Channel("vx_ref"),
        "velocity_y_mps": Channel("vy_ref"),
        "sideslip_rad": Channel("beta_ref"),
    },
    reference_speed="velocity_x_mps",
    vehicle=VehicleGeometry(wheelbase_m=2.40, track_m=1.35, front_axle_m=1.34),
)
"""A 1965 racing car of the Stanford Revs Program; no wheel speeds and no roll rate. Its wheelbase is the maker's; the
centre of gravity of the mid-engined car is an estimate."""

IAC_AV21 = ColumnMapping(
    time_column="t_s",
    channels={
        "accel_x_mps2": Channel("ax"),
        "yaw_rate_radps": Channel("yaw_rate"),
        "steer_rad": Channel("delta"),
        **_WHEELS_FL_FR_RL_RR,
    },
    reference={"velocity_x_mps": Channel("vx_ref"), "velocity_y_mps": Channel("vy_ref")},
    vehicle=VehicleGeometry(wheelbase_m=2.97, track_m=1.6, front_axle_m=1.72),
)
"""The racing car of the Indy Autonomous Challenge; 25 rows a second, no lateral accelerometer and no roll rate."""

_RAV4_STEERING_RATIO = 16.9

COMMA2K19_RAV4 = ColumnMapping(
    time_column="t_s",
    channels={
        "accel_x_mps2": Channel("imu_fwd"),
        "accel_y_mps2": Channel("imu_right", gain=-1.0),
        "roll_rate_radps": Channel("gyro_fwd"),
        "yaw_rate_radps": Channel("gyro_down", gain=-1.0),
        "steer_rad": Channel("steer_wheel_deg", gain=float(np.deg2rad(1.0)) / _RAV4_STEERING_RATIO),
        **_WHEELS_FL_FR_RL_RR,
    },
    reference={
        "velocity_x_mps": Channel("v_fwd_ref"),
        "velocity_y_mps": Channel("v_right_ref", gain=-1.0),
        "imu_up_mps2": Channel("imu_down", gain=-1.0),
    },
    vehicle=VehicleGeometry(wheelbase_m=2.66, track_m=1.57, front_axle_m=1.20),
)
"""A production car on a motorway; axes forward, right, down turned to forward, left, up."""

"""From where and how the inertial sensor is mounted to what it would read at the centre of gravity."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.estimation.filters import LowPass, rate_of_change, smoothed

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry


@dataclass(frozen=True, slots=True)
class InertialSignals:
    """Specific force and turning rates in the car's axes. All arrays (n,).

    Attributes:
        accel_x_mps2: Forward.
        accel_y_mps2: Left.
        roll_rate_radps: Left side up positive.
        yaw_rate_radps: Left turn positive.
    """

    accel_x_mps2: FloatArray
    accel_y_mps2: FloatArray
    roll_rate_radps: FloatArray
    yaw_rate_radps: FloatArray


def in_car_axes(trace: Trace, vehicle: VehicleGeometry) -> Trace:
    """Return the trace with what the inertial unit sensed turned into the car's axes, offsets still in it.

    The very same trace for zero mounting angles.
    """
    signals = InertialSignals(
        accel_x_mps2=trace.accel_x_mps2,
        accel_y_mps2=trace.accel_y_mps2,
        roll_rate_radps=trace.roll_rate_radps,
        yaw_rate_radps=trace.yaw_rate_radps,
    )
    turned = levelled(signals, vehicle)
    if turned is signals:
        return trace
    return replace(
        trace,
        accel_x_mps2=turned.accel_x_mps2,
        accel_y_mps2=turned.accel_y_mps2,
        roll_rate_radps=turned.roll_rate_radps,
        yaw_rate_radps=turned.yaw_rate_radps,
    )


def levelled(signals: InertialSignals, vehicle: VehicleGeometry) -> InertialSignals:
    """Return the signals turned from the sensor's axes into the car's.

    The channels a trace does not hold are taken as they are on a level road at steady pitch: specific force g
    upwards, pitch rate zero. Exact for zero mounting angles, where the very same record comes back.
    """
    if vehicle.imu_roll_rad == vehicle.imu_pitch_rad == vehicle.imu_yaw_rad == 0.0:
        return signals
    turn = mounting_rotation(vehicle)
    # The sensor's own vertical reading is not recorded; it is what makes the car's vertical specific force g.
    up = (GRAVITY_MPS2 - turn[2, 0] * signals.accel_x_mps2 - turn[2, 1] * signals.accel_y_mps2) / turn[2, 2]
    force = turn @ np.vstack([signals.accel_x_mps2, signals.accel_y_mps2, up])
    pitch = -(turn[1, 0] * signals.roll_rate_radps + turn[1, 2] * signals.yaw_rate_radps) / turn[1, 1]
    rates = turn @ np.vstack([signals.roll_rate_radps, pitch, signals.yaw_rate_radps])
    return InertialSignals(
        accel_x_mps2=force[0], accel_y_mps2=force[1], roll_rate_radps=rates[0], yaw_rate_radps=rates[2]
    )


def at_centre_of_gravity(
    signals: InertialSignals, vehicle: VehicleGeometry, *, lowpass: LowPass = LowPass.HAMMING_FIR
) -> InertialSignals:
    """Return the signals an accelerometer at the centre of gravity would read, for planar motion.

    References:
        Rigid body: a_cog = a_imu - dw/dt x r - w x (w x r) with w = (0, 0, yaw rate) and r = (x, y, 0).
    """
    x, y = vehicle.imu_x_m, vehicle.imu_y_m
    if x == y == 0.0:
        return signals
    w = smoothed(signals.yaw_rate_radps, lowpass)
    dw = rate_of_change(w)
    return InertialSignals(
        accel_x_mps2=signals.accel_x_mps2 + dw * y + w**2 * x,
        accel_y_mps2=signals.accel_y_mps2 - dw * x + w**2 * y,
        roll_rate_radps=signals.roll_rate_radps,
        yaw_rate_radps=signals.yaw_rate_radps,
    )


def mounting_rotation(vehicle: VehicleGeometry) -> FloatArray:
    """Return the matrix that takes components along the sensor's axes to components along the car's. (3, 3)"""
    cr, sr = np.cos(vehicle.imu_roll_rad), np.sin(vehicle.imu_roll_rad)
    cp, sp = np.cos(vehicle.imu_pitch_rad), np.sin(vehicle.imu_pitch_rad)
    cy, sy = np.cos(vehicle.imu_yaw_rad), np.sin(vehicle.imu_yaw_rad)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)

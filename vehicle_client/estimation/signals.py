"""From sensors to everything the client estimates: the virtual sensor as one function."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.estimation.filters import smoothed
from vehicle_client.estimation.mounting import InertialSignals, at_centre_of_gravity
from vehicle_client.estimation.observer import (
    ObserverParameters,
    gripping_velocity_y_mps,
    sideslip_rad,
    sideslip_rate_radps,
    straightness_1ps,
    two_way_velocity_mps,
)
from vehicle_client.estimation.offsets import NO_OFFSETS
from vehicle_client.estimation.roll import chassis_roll_rad, reckoned_roll_rate_radps, road_accel_y_mps2
from vehicle_client.estimation.summary import KinematicSignals
from vehicle_client.estimation.wheel_speed import encoder_speed_mps
from vehicle_client.estimation.yaw_rate import yaw_rate_excess_radps

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.offsets import SensorOffsets
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry


def kinematic_signals(
    trace: Trace,
    section: RoadSection,
    *,
    station_m: FloatArray,
    vehicle: VehicleGeometry,
    parameters: ObserverParameters,
    offsets: SensorOffsets,
) -> KinematicSignals:
    """Return everything the client estimates, at every sample.

    Args:
        trace: Without gaps (bridged), in the car's axes (`in_car_axes`), more than 30 samples.
        section: The map, for bank and grade; beyond its ends they are held.
        station_m: Position along the section. (n,)
        vehicle: The own car.
        parameters: Constants of the estimation.
        offsets: To subtract from the sensors.
    """
    profile = section.profile
    bank = np.arctan(np.interp(station_m, profile.station_m, profile.cross_slope_ratio))
    climb = np.arctan(np.interp(station_m, profile.station_m, profile.grade_ratio))
    measured = inertial_signals(trace, vehicle, offsets, parameters)
    return _signals(
        trace, measured, bank, climb, vehicle=vehicle, parameters=parameters, steer_offset_rad=offsets.steer_rad
    )


def unmapped_speed_mps(trace: Trace, *, vehicle: VehicleGeometry, parameters: ObserverParameters) -> FloatArray:
    """Return the encoder speed before offsets, bank and grade are known; good enough to find the section. (n,)

    Args:
        trace: Without gaps (bridged), in the car's axes (`in_car_axes`), more than 30 samples.
        vehicle: The own car.
        parameters: Constants of the estimation.
    """
    return encoder_speed_mps(
        trace.wheel_speed_mps,
        trace.yaw_rate_radps,
        smoothed(trace.steer_rad, parameters.lowpass),
        smoothed(trace.accel_x_mps2, parameters.lowpass),
        np.zeros_like(trace.yaw_rate_radps),
        vehicle=vehicle,
        parameters=parameters,
    )


def unmapped_velocity_y_mps(
    trace: Trace, *, vehicle: VehicleGeometry, parameters: ObserverParameters
) -> FloatArray | None:
    """Return the lateral velocity before it is known where the car is; None without a lateral accelerometer. (n,)

    As on a level road and with nothing subtracted: the roll filter takes bank and offsets, as all that lasts, for a
    tilt of the car. Enough to see which way a sliding car moves.

    Args:
        trace: Without gaps (bridged), in the car's axes (`in_car_axes`), more than 30 samples.
        vehicle: The own car.
        parameters: Constants of the estimation.
    """
    if "accel_y_mps2" in trace.absent:
        return None
    level = np.zeros_like(trace.time_s)
    measured = inertial_signals(trace, vehicle, NO_OFFSETS, parameters)
    estimated = _signals(
        trace, measured, level, level, vehicle=vehicle, parameters=parameters, steer_offset_rad=NO_OFFSETS.steer_rad
    )
    return estimated.velocity_y_mps


def _signals(
    trace: Trace,
    measured: InertialSignals,
    bank: FloatArray,
    climb: FloatArray,
    *,
    vehicle: VehicleGeometry,
    parameters: ObserverParameters,
    steer_offset_rad: float,
) -> KinematicSignals:
    lowpass = parameters.lowpass
    yaw_rate = measured.yaw_rate_radps
    accel_y = smoothed(measured.accel_y_mps2, lowpass)
    steer = smoothed(trace.steer_rad - steer_offset_rad, lowpass)
    accel_x = smoothed(measured.accel_x_mps2, lowpass) - GRAVITY_MPS2 * np.sin(climb)

    def speed_given(velocity_y_mps: FloatArray) -> FloatArray:
        return encoder_speed_mps(
            trace.wheel_speed_mps, yaw_rate, steer, accel_x, velocity_y_mps, vehicle=vehicle, parameters=parameters
        )

    speed = speed_given(np.zeros_like(yaw_rate))
    gripping = gripping_velocity_y_mps(accel_y, yaw_rate, speed, rear_axle_m=vehicle.rear_axle_m, parameters=parameters)
    # The front wheels roll partly sideways: with about the right lateral velocity the encoders tell a better speed.
    speed = speed_given(gripping)
    roll_rate = measured.roll_rate_radps
    if "roll_rate_radps" in trace.absent:
        roll_rate = reckoned_roll_rate_radps(
            accel_y, yaw_rate, bank, climb_rad=climb, roll_gradient_s2pm=parameters.roll_gradient_s2pm
        )
    roll = chassis_roll_rad(
        accel_y,
        yaw_rate,
        speed,
        roll_rate,
        bank,
        climb_rad=climb,
        gripping_velocity_y_mps=gripping,
        crossover_hz=parameters.roll_crossover_hz,
    )
    road_accel_y = road_accel_y_mps2(accel_y, chassis_roll_rad=roll, bank_rad=bank)
    rate = sideslip_rate_radps(road_accel_y, yaw_rate, speed, lowpass=lowpass)
    straight = straightness_1ps(yaw_rate, steer, rate, parameters=parameters)

    velocity_x, velocity_y = two_way_velocity_mps(
        accel_x,
        road_accel_y,
        yaw_rate,
        speed,
        straight,
        parameters=parameters,
        gripping_velocity_y_mps=gripping,
    )
    velocity_x, velocity_y = smoothed(velocity_x, lowpass), smoothed(velocity_y, lowpass)
    return KinematicSignals(
        steer_rad=steer,
        sideslip_rad=sideslip_rad(velocity_x, velocity_y),
        sideslip_rate_radps=rate,
        yaw_rate_excess_radps=yaw_rate_excess_radps(
            yaw_rate, speed, steer, wheelbase_m=vehicle.wheelbase_m, track_m=vehicle.track_m
        ),
        speed_mps=np.maximum(speed, 0.0),
        velocity_x_mps=velocity_x,
        velocity_y_mps=velocity_y,
        yaw_rate_radps=yaw_rate,
        chassis_roll_rad=roll,
        straightness_1ps=straight,
    )


def inertial_signals(
    trace: Trace, vehicle: VehicleGeometry, offsets: SensorOffsets, parameters: ObserverParameters
) -> InertialSignals:
    """Return what sensors without offsets would have sensed at the centre of gravity.

    Args:
        trace: Without gaps (bridged), in the car's axes (`in_car_axes`).
        vehicle: The own car.
        offsets: To subtract from the sensors.
        parameters: Which filter smooths.
    """
    signals = InertialSignals(
        accel_x_mps2=trace.accel_x_mps2 - offsets.accel_x_mps2,
        accel_y_mps2=trace.accel_y_mps2 - offsets.accel_y_mps2,
        roll_rate_radps=trace.roll_rate_radps,
        yaw_rate_radps=trace.yaw_rate_radps - offsets.yaw_rate_radps,
    )
    return at_centre_of_gravity(signals, vehicle, lowpass=parameters.lowpass)

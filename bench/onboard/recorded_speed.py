"""The speed that four wheels tell against a reference, on two recorded cars; and the offsets of a production car."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench.onboard.recorded_sideslip import LARGE, PULLS, SMALL, rms
from bench.onboard.variants import with_widths
from roadgrip.units import SAMPLE_S, BoolArray, FloatArray
from training.reference_drives import MOVING_MPS, level_road
from vehicle_client.estimation.filters import rate_of_change, smoothed
from vehicle_client.estimation.observer import XC90_PARAMETERS
from vehicle_client.estimation.offsets import NO_OFFSETS, sensor_offsets
from vehicle_client.estimation.signals import kinematic_signals
from vehicle_client.estimation.trace import WHEELS
from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.estimation.wheel_speed import encoder_speed_mps
from vehicle_client.recording.foreign import Recording

ACCELERATING_MPS2 = 1.0
"""The paper's threshold between steady and not."""
CORNERING_MPS2 = 2.0
FEWEST_SECONDS = 2.0
_PROBE_MPS = 1e-4
PULL = "to_gripping_car"
ADDED_OFFSET_MPS2 = -0.26
"""As some production cars carry."""


def speeds_of(recording: Recording, vehicle: VehicleGeometry) -> dict[str, FloatArray]:
    """Return the contenders' speeds, each with its best rolling radius: block, mean, and the smoothed mean. (n,)"""
    reference = recording.reference["velocity_x_mps"]
    moving = _moving(recording)
    mean = recording.trace.wheel_speed_mps.mean(axis=1)
    raw = {"block": _block_mps(recording, vehicle), "mean": mean, "mean_smoothed": smoothed(mean)}
    return {name: speed * _radius_ratio(speed[moving], reference[moving]) for name, speed in raw.items()}


def speed_figures(recording: Recording, vehicle: VehicleGeometry) -> dict[str, Any]:
    """Return errors by contender and regime, best rolling radii, and how much each wheel counts."""
    reference = recording.reference["velocity_x_mps"]
    moving = _moving(recording)
    regimes = regimes_of(recording)
    errors = {name: speed - reference for name, speed in speeds_of(recording, vehicle).items()}
    block = _block_mps(recording, vehicle)
    weights = _weights(recording, vehicle, block)
    mean = recording.trace.wheel_speed_mps.mean(axis=1)
    return {
        "rms_error_mps": {
            name: {regime: rms(error[where]) for regime, where in regimes.items()} for name, error in errors.items()
        },
        "seconds": {regime: float(np.count_nonzero(where)) * SAMPLE_S for regime, where in regimes.items()},
        "best_radius_over_nominal_ratio": {
            "block": _radius_ratio(block[moving], reference[moving]),
            "mean": _radius_ratio(mean[moving], reference[moving]),
            **{
                wheel: _radius_ratio(recording.trace.wheel_speed_mps[moving, i], reference[moving])
                for i, wheel in enumerate(WHEELS)
            },
        },
        "weight_frac": {
            regime: dict(zip(WHEELS, weights[where].mean(axis=0).tolist(), strict=True))
            for regime, where in regimes.items()
        },
    }


def regimes_of(recording: Recording) -> dict[str, BoolArray]:
    """Return masks over the samples: everything in motion, and what the car is doing, where it does it long enough."""
    reference = recording.reference["velocity_x_mps"]
    moving = _moving(recording)
    gained = rate_of_change(smoothed(reference))
    across = np.abs(smoothed(recording.trace.yaw_rate_radps) * reference) > CORNERING_MPS2
    steady = np.abs(gained) <= ACCELERATING_MPS2
    masks: dict[str, BoolArray] = {
        "all": moving,
        "braking": moving & (gained < -ACCELERATING_MPS2),
        "accelerating": moving & (gained > ACCELERATING_MPS2),
        "cornering": moving & steady & across,
        "steady": moving & steady & ~across,
    }
    return {name: where for name, where in masks.items() if np.count_nonzero(where) * SAMPLE_S >= FEWEST_SECONDS}


def offset_figures(recording: Recording, vehicle: VehicleGeometry) -> dict[str, Any]:
    """Return what the offset estimation makes of a production car's sensors, and what the sideslip makes of that."""
    trace, reference = recording.trace, recording.reference
    velocity_x, velocity_y = reference["velocity_x_mps"], reference["velocity_y_mps"]
    moving = _moving(recording)
    told = smoothed(trace.accel_y_mps2) - rate_of_change(smoothed(velocity_y))
    told -= smoothed(trace.yaw_rate_radps) * smoothed(velocity_x)
    offsets = sensor_offsets(
        trace.accel_y_mps2,
        trace.yaw_rate_radps,
        trace.steer_rad,
        velocity_x,
        moving,
        accel_x_mps2=trace.accel_x_mps2,
        climb_rad=0.0,
        wheelbase_m=vehicle.wheelbase_m,
    )
    truth = np.arctan2(velocity_y, velocity_x)
    pointing = float(np.mean(truth[moving]))
    still_offset = replace(offsets, accel_y_mps2=float(np.mean(told[moving])))
    ways = {"none": NO_OFFSETS, "straight": offsets, "by_reference": still_offset, "added": NO_OFFSETS}
    constants = {
        "f_zero": with_widths(PULLS[PULL], SMALL),
        "our_f": PULLS[PULL],
        "f_one": with_widths(PULLS[PULL], LARGE),
    }
    more = replace(trace, accel_y_mps2=trace.accel_y_mps2 + ADDED_OFFSET_MPS2)

    def error_rad(name: str, way: str) -> float:
        found = kinematic_signals(
            more if way == "added" else trace,
            level_road(),
            station_m=np.zeros(trace.samples_count),
            vehicle=vehicle,
            parameters=constants[name],
            offsets=ways[way],
        ).sideslip_rad
        return rms(found[moving] - (truth[moving] - pointing))

    return {
        "seconds": float(np.count_nonzero(moving)) * SAMPLE_S,
        "straight_s": offsets.straight_s,
        "accel_y_by_reference_mps2": float(np.mean(told[moving])),
        "accel_y_estimated_mps2": offsets.accel_y_mps2,
        "accel_y_estimated_std_mps2": offsets.accel_y_std_mps2,
        "yaw_rate_estimated_radps": offsets.yaw_rate_radps,
        "yaw_rate_estimated_std_radps": offsets.yaw_rate_std_radps,
        "steer_estimated_rad": offsets.steer_rad,
        "steer_estimated_std_rad": offsets.steer_std_rad,
        "reference_points_aside_rad": pointing,
        "rms_truth_rad": rms(truth[moving] - pointing),
        "rms_error_rad": {way: {name: error_rad(name, way) for name in constants} for way in ways},
    }


def _moving(recording: Recording) -> BoolArray:
    moving: BoolArray = recording.trace.valid & (recording.reference["velocity_x_mps"] > MOVING_MPS)
    return moving


def _radius_ratio(speed_mps: FloatArray, reference_mps: FloatArray) -> float:
    """Return the rolling radius over the nominal one that leaves the least error."""
    return float(speed_mps @ reference_mps / (speed_mps @ speed_mps))


def _block_mps(recording: Recording, vehicle: VehicleGeometry, wheel_speed_mps: FloatArray | None = None) -> FloatArray:
    trace = recording.trace
    return encoder_speed_mps(
        trace.wheel_speed_mps if wheel_speed_mps is None else wheel_speed_mps,
        trace.yaw_rate_radps,
        smoothed(trace.steer_rad),
        smoothed(trace.accel_x_mps2),
        np.zeros(trace.samples_count),
        vehicle=vehicle,
        parameters=XC90_PARAMETERS,
    )


def _weights(recording: Recording, vehicle: VehicleGeometry, block_mps: FloatArray) -> FloatArray:
    """Return how far the block's speed follows each wheel, as the change with a change of that wheel alone. (n, 4)"""
    result = np.empty_like(recording.trace.wheel_speed_mps)
    for i in range(result.shape[1]):
        probed = recording.trace.wheel_speed_mps.copy()
        probed[:, i] += _PROBE_MPS
        result[:, i] = (_block_mps(recording, vehicle, probed) - block_mps) / _PROBE_MPS
    return result

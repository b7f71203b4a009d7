"""What one passage teaches a car about itself.

The map teaches the sensors that know no friction: over a section the car turns as far as the road does, the mean
lateral force is that of turning and bank, the mean forward force that of gaining speed and grade. The physical inverse
teaches the rest: its three channels are made linear in all constants, in the logarithm of the friction and in what is
new in every passage, about the best friction; then friction and what is new are taken out, so that only what no
friction could explain counts as the car's. Slopes are differences: each constant is changed a little.

References:
    Golub and Pereyra, Separable nonlinear least squares: the variable projection method, Inverse Problems 19 (2003):
    unknowns of no interest are projected out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import GRAVITY_MPS2, SAMPLE_S
from vehicle_client.estimation.grip.channels import channels
from vehicle_client.estimation.grip.forces import axle_forces
from vehicle_client.estimation.grip.likelihood import TAIL_DEGREES
from vehicle_client.estimation.grip.memory import CONSTANTS, COUNT, PLACES, Lesson, scaled_handling
from vehicle_client.estimation.grip.recall import recalled

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.grip.channels import Channels
    from vehicle_client.estimation.grip.memory import CarMemory
    from vehicle_client.estimation.grip.motion import Motion
    from vehicle_client.estimation.grip.noise import GripNoise
    from vehicle_client.estimation.grip.recall import Recalled, Sensed
    from vehicle_client.estimation.handling import Handling
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

INVERSE_TRUST_RATIO = 0.25
"""How much of the channels' information counts: what a two-axle model leaves unexplained lasts longer than 0.2 s."""
FRICTION_STD_RATIO = 0.35
"""How well friction is known before the passage, about its best value."""
HEADING_STD_RAD = 0.012
"""By how much a car's course differs from the road's at either end of a section, together."""
BANK_STD_MPS2 = 0.055
"""Of the map's bank over a section, as gravity along it."""
GRADE_STD_MPS2 = 0.035
"""Of its grade likewise."""
VELOCITY_Y_STD_MPS = 0.15
"""Of the lateral velocity at either end."""
SPEED_STD_MPS = 0.07
"""Of the gain of speed over a section."""
COUPLING_STD_MPS2 = 0.03
"""Of the forward force that sliding sideways in a turn takes, which is left out."""
LONGEST_TURN_S = 120.0
_STEP_LOG = 0.02
_STEPS = {
    "steer_offset_rad": 1e-4,
    "yaw_rate_scale_ratio": 1e-3,
    "accel_y_scale_ratio": 1e-3,
    "accel_x_offset_mps2": 0.02,
    "front_radius_ratio": 1e-4,
}
_ROUNDS_COUNT = 3


def passage_lesson(
    sensed: Sensed,
    *,
    friction_mu: float,
    handling: Handling,
    geometry: VehicleGeometry,
    noise: GripNoise,
    memory: CarMemory,
) -> Lesson:
    """Return what a passage says of the car's constants.

    Args:
        sensed: Over the section.
        friction_mu: That explains the passage best.
        handling: As declared.
        geometry: Of the car.
        noise: As declared.
        memory: Of the car, before the passage.
    """
    seen = recalled(sensed, handling=handling, noise=noise, memory=memory, approach_counts=False)
    information, pull = by_inverse(seen, friction_mu, geometry, memory)
    for slopes, missed, std in _by_map(sensed, seen, memory):
        information += np.outer(slopes, slopes) / std**2
        pull += slopes * missed / std**2
    steer = PLACES["steer_offset_rad"]
    approach_variance = sensed.offsets.steer_std_rad**2
    information[steer, steer] += 1.0 / approach_variance
    pull[steer] += (sensed.offsets.steer_rad - memory.mean[steer]) / approach_variance
    return Lesson(information, pull)


def _by_map(sensed: Sensed, seen: Recalled, memory: CarMemory) -> list[tuple[FloatArray, float, float]]:
    """Return slopes, misses and standard deviations of what the map tells."""
    inside, profile, offsets = sensed.inside, sensed.section.profile, sensed.offsets
    duration_s = SAMPLE_S * float(np.count_nonzero(inside))
    station_m, speed = sensed.station_m[inside], sensed.speed_mps[inside]
    yaw_rate = sensed.measured.yaw_rate_radps[inside] / (1.0 + memory.value("yaw_rate_scale_ratio"))

    def told(values: FloatArray) -> FloatArray:
        return np.interp(station_m, profile.station_m, values)

    road_heading = told(profile.heading_rad)
    turned_rad = float(road_heading[-1] - road_heading[0])
    heading = np.zeros(COUNT)
    heading[PLACES["yaw_rate_scale_ratio"]] = turned_rad
    wander_rad = offsets.yaw_rate_std_radps * min(duration_s, LONGEST_TURN_S)
    missed_rad = float(yaw_rate.sum()) * SAMPLE_S - turned_rad

    gravity_y = GRAVITY_MPS2 * float(np.sin(np.arctan(told(profile.cross_slope_ratio))).mean())
    turning = float((yaw_rate * speed).mean())
    lean_ratio = 1.0 + GRAVITY_MPS2 * seen.handling.roll_gradient_s2pm
    accel_y = float(sensed.measured.accel_y_mps2[inside].mean()) + offsets.accel_y_mps2
    accel_y = (accel_y - memory.value("accel_y_offset_mps2")) / (1.0 + memory.value("accel_y_scale_ratio"))
    force_y = accel_y / lean_ratio
    level = np.zeros(COUNT)
    level[PLACES["accel_y_offset_mps2"]] = 1.0 / lean_ratio
    level[PLACES["accel_y_scale_ratio"]] = force_y
    level[PLACES["yaw_rate_scale_ratio"]] = -turning
    level_std = np.sqrt(
        BANK_STD_MPS2**2
        + (float(speed.mean()) * offsets.yaw_rate_std_radps) ** 2
        + (VELOCITY_Y_STD_MPS / duration_s) ** 2
    )

    grade = told(profile.grade_ratio)
    climbing = GRAVITY_MPS2 * float((grade / np.sqrt(1.0 + grade**2)).mean())
    accel_x = float(sensed.measured.accel_x_mps2[inside].mean()) + offsets.accel_x_mps2
    accel_x -= memory.value("accel_x_offset_mps2")
    nod_ratio = 1.0 + GRAVITY_MPS2 * seen.handling.pitch_gradient_s2pm
    gained = float(speed[-1] - speed[0]) / duration_s
    along = np.zeros(COUNT)
    along[PLACES["accel_x_offset_mps2"]] = 1.0
    along_std = np.sqrt(GRADE_STD_MPS2**2 + (SPEED_STD_MPS / duration_s) ** 2 + COUPLING_STD_MPS2**2)
    return [
        (heading, missed_rad, float(np.hypot(HEADING_STD_RAD, wander_rad))),
        (level, force_y - turning - gravity_y, float(level_std)),
        (along, accel_x - nod_ratio * gained - climbing, float(along_std)),
    ]


def by_inverse(
    seen: Recalled, friction_mu: float, geometry: VehicleGeometry, memory: CarMemory
) -> tuple[FloatArray, FloatArray]:
    """Return information and pull of the three channels, friction and what is new in the passage taken out.

    Args:
        seen: With what the car remembers taken out.
        friction_mu: That explains the passage best.
        geometry: Of the car.
        memory: Of the car, before the passage.
    """
    motion, noise = seen.motion, seen.noise

    def channels_at(at_mu: float, of_motion: Motion, handling: Handling) -> Channels:
        forces = axle_forces(of_motion, handling=handling, geometry=geometry)
        return channels(of_motion, forces, np.array([at_mu]), handling=handling, geometry=geometry, noise=noise)

    found = channels_at(friction_mu, motion, seen.handling)
    missed = _missed(found)
    slopes = np.zeros((COUNT, len(missed)))
    for name, step in _STEPS.items():
        changed = channels_at(friction_mu, _motion_less(motion, name, step), seen.handling)
        slopes[PLACES[name]] = (missed - _missed(changed)) / step
    for place, constant in enumerate(CONSTANTS):
        if constant.handling:
            changed = channels_at(friction_mu, motion, scaled_handling(seen.handling, constant, _STEP_LOG))
            slopes[place] = (missed - _missed(changed)) / _STEP_LOG
    slipperier = channels_at(friction_mu * float(np.exp(-_STEP_LOG)), motion, seen.handling)
    by_friction = (_missed(slipperier) - missed) / _STEP_LOG

    none = np.zeros_like(motion.speed_mps)
    steering, drift, wheels = (
        [np.broadcast_to(effect, (1, len(none)))[0] for effect in channel.nuisances]
        for channel in (found.steering, found.drift, found.wheel_slip)
    )
    new = np.vstack(
        [
            by_friction,
            np.concatenate([steering[1], none, none]),
            np.concatenate([steering[3], none, none]),
            np.concatenate([none, drift[0], none]),
            np.concatenate([none, drift[1], none]),
            np.concatenate([none, none, wheels[1]]),
        ]
    )
    new_stds = np.array(
        [
            FRICTION_STD_RATIO,
            noise.yaw_rate_offset_radps,
            BANK_STD_MPS2,
            noise.accel_offset_mps2,
            noise.lean_ratio,
            GRADE_STD_MPS2,
        ]
    )
    variance = np.concatenate([channel.variance[0] for channel in (found.steering, found.drift, found.wheel_slip)])
    certainty = np.tile(motion.counted_weight, 3) / variance
    effects = np.vstack([slopes, new])
    # Lessons come about a memory that holds already: without it a passage would ask for anything.
    prior = np.zeros((len(effects), len(effects)))
    prior[:COUNT, :COUNT] = np.linalg.inv(np.array(memory.covariance))
    prior[COUNT:, COUNT:] = np.diag(1.0 / new_stds**2)
    rest = missed
    trust = certainty
    for _ in range(_ROUNDS_COUNT):
        trust = INVERSE_TRUST_RATIO * certainty * (TAIL_DEGREES + 1.0) / (TAIL_DEGREES + rest * rest / variance)
        weighted = trust * effects
        rest = missed - np.linalg.solve(weighted @ effects.T + prior, weighted @ missed) @ effects
    weighted = trust * effects
    whole, toward = weighted @ effects.T, weighted @ missed
    beside = np.linalg.solve(
        whole[COUNT:, COUNT:] + prior[COUNT:, COUNT:], np.column_stack([whole[COUNT:, :COUNT], toward[COUNT:]])
    )
    information = whole[:COUNT, :COUNT] - whole[:COUNT, COUNT:] @ beside[:, :-1]
    pull = toward[:COUNT] - whole[:COUNT, COUNT:] @ beside[:, -1]
    return 0.5 * (information + information.T), pull


def _missed(found: Channels) -> FloatArray:
    return np.concatenate([found.steering.misfit[0], found.drift.misfit[0], found.wheel_slip.misfit[0]])


def _motion_less(motion: Motion, name: str, step: float) -> Motion:
    """Return the motion as a car would see it that takes out a little more of one sensor's error."""
    if name == "steer_offset_rad":
        return replace(motion, steer_rad=motion.steer_rad - step)
    if name == "yaw_rate_scale_ratio":
        slower = 1.0 - step
        return replace(
            motion, yaw_rate_radps=slower * motion.yaw_rate_radps, yaw_accel_radps2=slower * motion.yaw_accel_radps2
        )
    if name == "accel_y_scale_ratio":
        # The mean is left to what the map tells.
        force = motion.force_y_mps2
        rate = (1.0 - step) * motion.force_y_rate_mps3
        return replace(motion, force_y_mps2=force - step * (force - force.mean()), force_y_rate_mps3=rate)
    if name == "accel_x_offset_mps2":
        return replace(motion, force_x_mps2=motion.force_x_mps2 - step)
    return replace(motion, front_wheels_mps=(1.0 - step) * motion.front_wheels_mps)

"""What each friction predicts of steering, lateral velocity and wheel speeds, and by how much it misses.

Lateral force and yaw acceleration give the force of either axle. At every friction the tyre curve gives the slip those
forces need, and slip shows in three places that different sensors see: the steering angle that points the front wheels
past where they go (`steering`), the sideways motion of the rear axle (`drift`), and wheels that turn faster than the
road passes (`wheel_slip`). Where a friction cannot give the forces at all, `excess` says by how much.

References:
    Two-axle model with load shift: Mitschke and Wallentowitz, Dynamik der Kraftfahrzeuge, part III. Friction from the
    self-aligning and slip relations of such a model: Rajamani et al., Algorithms for real-time estimation of individual
    wheel tire-road friction coefficients, IEEE/ASME Trans. Mechatronics 17(6), 2012. Use of three channels with
    offsets as nuisances is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import GRAVITY_MPS2
from vehicle_client.estimation.grip.axle import FULL_USE_RATIO, AxleSlip, WheelCurve, axle_slip

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.grip.forces import AxleForces
    from vehicle_client.estimation.grip.motion import Motion
    from vehicle_client.estimation.grip.noise import GripNoise
    from vehicle_client.estimation.handling import Handling
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

SLOW_PART_S = 2.1
"""Integrated accelerations are compared after what is slower than this was taken out of both sides."""
_FORCE_FLOOR_N = 50.0
_ANGLE_FLOOR_RAD = 1e-5
_TRUE_SPEED_MIN_MPS = 1.0


@dataclass(frozen=True, slots=True)
class Channel:
    """How one sensor misses each friction's prediction.

    Attributes:
        misfit: Sensed minus predicted. (frictions, n)
        variance: Of the misfit at that friction. (frictions, n)
        nuisances: How much each unknown constant adds to the misfit per unit; (n,) or (frictions, n) each.
        priors: Standard deviation of each unknown constant.
    """

    misfit: FloatArray
    variance: FloatArray
    nuisances: tuple[FloatArray, ...]
    priors: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Channels:
    """All that is predicted.

    Attributes:
        steering: Of the front wheels' angle, rad.
        drift: Of the lateral velocity of the centre of gravity, m/s, slow parts taken out.
        wheel_slip: Of the front wheels' speed given the rear wheels', m/s.
        excess_ratio: Force beyond what the friction gives, in standard deviations, of both axles. (frictions, n)
        demand_mu: Force over peak force at friction 1, of the axle that asks for more. (n,)
    """

    steering: Channel
    drift: Channel
    wheel_slip: Channel
    excess_ratio: FloatArray
    demand_mu: FloatArray


def channels(
    motion: Motion,
    forces: AxleForces,
    friction_mu: FloatArray,
    *,
    handling: Handling,
    geometry: VehicleGeometry,
    noise: GripNoise,
) -> Channels:
    """Return what frictions predict of a motion, and by how much they miss.

    Args:
        motion: Of the car over the section.
        forces: What that motion asks of the axles.
        friction_mu: The frictions that are asked about. (frictions,)
        handling: Of the own car.
        geometry: Of the own car.
        noise: Of its sensors.
    """
    mu = friction_mu[:, None]
    wheelbase, speed = geometry.wheelbase_m, motion.speed_mps
    front_frac, rear_frac = geometry.rear_axle_m / wheelbase, geometry.front_axle_m / wheelbase
    front = axle_slip(mu, forces.front_side_n, forces.front_along_n, forces.front_wheels)
    rear = axle_slip(mu, forces.rear_side_n, forces.rear_along_n, forces.rear_wheels)
    # Driven wheels turn faster than the road passes: the speed by the encoders less their mean slip.
    front_slip = front.along_per_force_1pn * forces.front_along_n
    rear_slip = rear.along_per_force_1pn * forces.rear_along_n
    true_speed = np.maximum(speed * (1.0 - 0.5 * (front_slip + rear_slip)), _TRUE_SPEED_MIN_MPS)
    yields = handling.steer_compliance_radpn * forces.front_side_now_n
    front_gain = handling.mass_kg * front_frac
    rear_gain = handling.mass_kg * rear_frac

    # Where the front axle goes: the rear axle slips sideways by its angle, and the car turns about it.
    front_side_mps = wheelbase * motion.yaw_rate_radps - true_speed * rear.angle_rad
    course = np.arctan(front_side_mps / true_speed)
    bend = front.angle_per_force_radpn * front_gain - rear.angle_per_force_radpn * rear_gain
    bend = bend + handling.steer_compliance_radpn * front_gain
    steering = Channel(
        misfit=motion.steer_rad - yields - course - np.arctan(front.angle_rad),
        variance=noise.steer_rad**2
        + noise.force_y_mps2**2
        * ((front.angle_per_force_radpn * front_gain) ** 2 + (rear.angle_per_force_radpn * rear_gain) ** 2),
        nuisances=(
            np.ones_like(speed),
            wheelbase / speed,
            wheelbase * motion.yaw_rate_radps / speed,
            bend,
            front.angle_rad - rear.angle_rad,
        ),
        priors=(
            noise.steer_offset_rad,
            noise.yaw_rate_offset_radps,
            noise.yaw_rate_scale_ratio,
            noise.force_y_offset_mps2,
            noise.stiffness_ratio,
        ),
    )

    accel_y = motion.force_y_mps2 - GRAVITY_MPS2 * motion.bank_rad - motion.yaw_rate_radps * true_speed
    velocity_y = geometry.rear_axle_m * motion.yaw_rate_radps - true_speed * rear.angle_rad
    width = 2 * round(0.5 * SLOW_PART_S / motion.step_s) + 1
    drift = Channel(
        misfit=_without_slow_part(velocity_y - _integral(accel_y, motion.step_s), width),
        variance=noise.velocity_y_mps**2 + (speed * rear.angle_per_force_radpn * rear_gain * noise.force_y_mps2) ** 2,
        nuisances=tuple(
            _without_slow_part(_integral(rate, motion.step_s), width)
            for rate in (np.ones_like(speed), motion.force_y_mps2, motion.yaw_rate_radps * speed)
        ),
        priors=(noise.accel_offset_mps2, noise.lean_ratio, noise.yaw_rate_scale_ratio),
    )

    drive = handling.front_drive_frac
    push = front.along_per_force_1pn * drive - rear.along_per_force_1pn * (1.0 - drive)
    push = speed * handling.mass_kg * push
    grow = speed * (
        np.abs(_slip_growth(front, front_slip, forces.front_side_n)) * front_gain
        + np.abs(_slip_growth(rear, rear_slip, forces.rear_side_n)) * rear_gain
    )
    rolls = _front_rolling_mps(motion, true_speed, front_side_mps, motion.steer_rad - yields, geometry)
    wheel_slip = Channel(
        misfit=motion.front_wheels_mps * (1.0 - front_slip)
        - rolls * motion.rear_wheels_mps * (1.0 - rear_slip) / true_speed,
        variance=(noise.wheels_ratio * speed) ** 2
        + (push * noise.force_x_mps2) ** 2
        + (grow * noise.force_y_mps2) ** 2,
        nuisances=(speed, push),
        priors=(noise.radius_ratio, noise.force_x_offset_mps2),
    )
    return Channels(
        steering=steering,
        drift=drift,
        wheel_slip=wheel_slip,
        excess_ratio=np.sqrt(
            (np.maximum(front.use_ratio - FULL_USE_RATIO, 0.0) * mu * (_peak_n(forces.front_wheels) / front_gain)) ** 2
            + (np.maximum(rear.use_ratio - FULL_USE_RATIO, 0.0) * mu * (_peak_n(forces.rear_wheels) / rear_gain)) ** 2
        )
        / noise.force_y_mps2,
        demand_mu=np.maximum(front.use_ratio[0], rear.use_ratio[0]) * friction_mu[0],
    )


def _peak_n(wheels: tuple[WheelCurve, WheelCurve]) -> FloatArray:
    return wheels[0].peak_n + wheels[1].peak_n


def _slip_growth(axle: AxleSlip, along_slip: FloatArray, side_n: FloatArray) -> FloatArray:
    """Return how much more longitudinal slip the same push needs with a little more lateral force, per newton."""
    force = np.maximum(np.abs(side_n), _FORCE_FLOOR_N)
    angle = np.maximum(np.abs(axle.angle_rad), _ANGLE_FLOOR_RAD)
    return along_slip * np.maximum(axle.angle_per_force_radpn * force / angle - 1.0, 0.0) / force


def _front_rolling_mps(
    motion: Motion,
    speed_mps: FloatArray,
    front_side_mps: FloatArray,
    steer_rad: FloatArray,
    geometry: VehicleGeometry,
) -> FloatArray:
    """Return how fast the road passes under the front wheels along their planes, mean of both. (frictions, n)"""
    tangent = np.tan(steer_rad)
    total = np.zeros_like(front_side_mps)
    for left_m in (0.5 * geometry.track_m, -0.5 * geometry.track_m):
        # Ackermann: the wheels' axes meet on the rear axle's line.
        turned = tangent / (1.0 - tangent * left_m / geometry.wheelbase_m)
        total += ((speed_mps - motion.yaw_rate_radps * left_m) + front_side_mps * turned) / np.sqrt(1.0 + turned**2)
    return 0.5 * total


def _integral(rate: FloatArray, step_s: float) -> FloatArray:
    """Return the integral along the last axis by the trapezoidal rule, from 0."""
    steps = 0.5 * step_s * (rate[..., 1:] + rate[..., :-1])
    return np.concatenate([np.zeros((*rate.shape[:-1], 1)), np.cumsum(steps, axis=-1)], axis=-1)


def _without_slow_part(values: FloatArray, width: int) -> FloatArray:
    """Return values less their centred moving mean over an odd number of samples along the last axis, ends held."""
    half = width // 2
    first, last = values[..., :1], values[..., -1:]
    padded = np.concatenate([np.repeat(first, half, axis=-1), values, np.repeat(last, half, axis=-1)], axis=-1)
    sums = np.concatenate([np.zeros((*values.shape[:-1], 1)), np.cumsum(padded, axis=-1)], axis=-1)
    without: FloatArray = values - (sums[..., width:] - sums[..., :-width]) / width
    return without

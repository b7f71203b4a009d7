"""Drives of a car with two axles whose friction is known, integrated forward: from slip to force, wheel by wheel.

Nothing here is taken from the inverse but the declared constants and the record that it reads.
"""

from dataclasses import replace

import numpy as np

from roadgrip.features import GRIP_TABLE, PAPER_TABLE
from roadgrip.units import GRAVITY_MPS2, FloatArray
from vehicle_client.estimation.grip.evidence import grip_evidence
from vehicle_client.estimation.grip.motion import Motion
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE, GripNoise
from vehicle_client.estimation.handling import XC90_HANDLING, Handling, TyreCurve
from vehicle_client.estimation.vehicle_geometry import XC90

HANDLING = replace(XC90_HANDLING, steer_compliance_radpn=0.0, tyre=replace(XC90_HANDLING.tyre, relaxation_m=0.0))
"""Forces that build up at once and steering that does not give way: two things fewer to work forward."""
NAMES = tuple(feature.name for feature in GRIP_TABLE.kinematic[len(PAPER_TABLE.kinematic) :])
STEP_S = 0.005
SENSED_EVERY_COUNT = 20
STEER_GAIN_RADS2PM = 0.06
"""How fast the driver turns the wheels for a force that is missing."""


def mirrored_motion(motion: Motion) -> Motion:
    """Return the motion on the road seen in a mirror."""
    sides = ("yaw_rate_radps", "yaw_accel_radps2", "steer_rad", "force_y_mps2", "force_y_rate_mps3", "bank_rad")
    return replace(motion, **{name: -getattr(motion, name) for name in sides})


def told_of(motion: Motion, *, handling: Handling = HANDLING, noise: GripNoise = AUTOMOTIVE_NOISE) -> dict[str, float]:
    """Return the grip features of a motion by name, and each channel's own best friction."""
    values = grip_evidence(motion, handling=handling, geometry=XC90, noise=noise)
    return with_best_of_channels(dict(zip(NAMES, values.tolist(), strict=True)))


def with_best_of_channels(told: dict[str, float]) -> dict[str, float]:
    """Return the features with `grip_CHANNEL_best_mu` for channels that tell only how far theirs is from the best."""
    best = {
        f"grip_{channel}_best_mu": told["grip_all_best_mu"] * float(np.exp(told[f"grip_{channel}_shift_ratio"]))
        for channel in ("steering", "drift", "wheels")
    }
    return told | best


def stiffness_n(slip: FloatArray, *, load_n: FloatArray, friction_mu: FloatArray, tyre: TyreCurve) -> FloatArray:
    """Return force over slip of a wheel on the rising branch; the peak force over the slip beyond it.

    References:
        Rill, Road Vehicle Dynamics, chapter 3: TMeasy. Friction scales the peak and its slip.
    """
    share = load_n / tyre.nominal_load_n - 1.0
    slope = load_n * (tyre.stiffness_ratio + share * (tyre.stiffness_twice_ratio - tyre.stiffness_ratio))
    peak = friction_mu * load_n * (1.0 + share * (tyre.peak_twice_ratio - 1.0))
    at = friction_mu * (tyre.peak_slip_ratio + share * (tyre.peak_slip_twice_ratio - tyre.peak_slip_ratio))
    z = np.minimum(slip / at, 1.0)
    rising = slope / (1.0 + (z + slope * at / peak - 2.0) * z)
    return np.where(slip < at, rising, peak / np.maximum(slip, at))


def along_ratio(load_n: FloatArray, tyre: TyreCurve) -> FloatArray:
    """Return by how much stiffer a wheel is along than across."""
    share = load_n / tyre.nominal_load_n - 1.0
    return np.asarray(
        tyre.along_stiffness_ratio
        / (tyre.stiffness_ratio + share * (tyre.stiffness_twice_ratio - tyre.stiffness_ratio))
    )


class _Axle:
    """Two wheels with one slip angle, each pushed along by half the axle's force."""

    def __init__(self, friction_mu: FloatArray, tyre: TyreCurve) -> None:
        self.friction_mu, self.tyre = friction_mu, tyre
        self.along_slip = np.zeros((2, len(friction_mu)))
        self.load_n = np.zeros((2, len(friction_mu)))

    def forces_n(self, angle_rad: FloatArray, *, along_n: FloatArray, load_n: FloatArray) -> FloatArray:
        """Return the force of the left and the right wheel across. (2, frictions)"""
        self.load_n = load_n
        # The longitudinal slip of the step before is close enough to start from.
        for _ in range(2):
            stiff = stiffness_n(
                np.hypot(angle_rad, self.along_slip), load_n=load_n, friction_mu=self.friction_mu, tyre=self.tyre
            )
            self.along_slip = 0.5 * along_n / stiff
        return stiff * angle_rad

    def rolling_slip(self) -> FloatArray:
        """Return how much faster than the road both wheels turn on average, as a share of it. (frictions,)"""
        return np.asarray((self.along_slip / along_ratio(self.load_n, self.tyre)).mean(axis=0))


def winding(friction_mu: float, use_ratio: float, *, duration_s: float = 20.0, period_s: float = 8.0) -> FloatArray:
    """Return lateral forces per mass that bends to either side ask for, up to a share of what the road gives. (n,)"""
    time = np.arange(0.0, duration_s, STEP_S)
    fade = np.clip(np.minimum(time, duration_s - time) / 2.0, 0.0, 1.0)
    return np.asarray(use_ratio * friction_mu * GRAVITY_MPS2 * np.sin(2.0 * np.pi * time / period_s) * fade)


def driven(
    friction_mu: tuple[float, ...],
    wanted_mps2: FloatArray,
    *,
    speed_mps: float = 16.0,
    push_n: float = 1200.0,
    handling: Handling = HANDLING,
    later_mu: tuple[float, ...] | None = None,
) -> list[Motion]:
    """Return what exact sensors see of cars that are steered for these forces, on a road that keeps their speed.

    Args:
        friction_mu: Of each car's road.
        wanted_mps2: Lateral force of the tyres per mass that its driver steers for. (n, cars)
        speed_mps: Of the centre of gravity, forward.
        push_n: Drive force of all wheels.
        handling: Of the car, without relaxation and compliance.
        later_mu: Of each car's road from half of the time on; the same as before if None.
    """
    mu = np.array(friction_mu)
    mass, wheelbase, half_track, tyre = handling.mass_kg, XC90.wheelbase_m, 0.5 * XC90.track_m, handling.tyre
    ahead, behind = XC90.front_axle_m, XC90.rear_axle_m
    front, rear = _Axle(mu, tyre), _Axle(mu, tyre)
    steer, yaw_rate, velocity_y, force_y, force_x = (np.zeros(len(mu)) for _ in range(5))
    rows = []
    for sample, wanted in enumerate(wanted_mps2):
        if later_mu is not None and 2 * sample >= len(wanted_mps2):
            front.friction_mu = rear.friction_mu = np.array(later_mu)
        pitch = mass * handling.cog_height_m * force_x / wheelbase
        shift = mass * force_y / XC90.track_m * np.array([[-1.0], [1.0]])
        front_load = 0.5 * (mass * GRAVITY_MPS2 * behind / wheelbase - pitch)
        rear_load = 0.5 * (mass * GRAVITY_MPS2 * ahead / wheelbase + pitch)
        front_along = handling.front_drive_frac * push_n - 2.0 * tyre.rolling_resistance_ratio * front_load
        rear_along = (1.0 - handling.front_drive_frac) * push_n - 2.0 * tyre.rolling_resistance_ratio * rear_load
        front_side_mps = velocity_y + ahead * yaw_rate
        front_angle = np.tan(steer - np.arctan(front_side_mps / speed_mps))
        rear_angle = -(velocity_y - behind * yaw_rate) / speed_mps
        front_n = front.forces_n(
            front_angle, along_n=front_along, load_n=front_load + shift * handling.front_transfer_height_m
        )
        rear_n = rear.forces_n(
            rear_angle, along_n=rear_along, load_n=rear_load + shift * handling.rear_transfer_height_m
        )
        across = front_n.sum(axis=0) * np.cos(steer) + front_along * np.sin(steer)
        force_y = (across + rear_n.sum(axis=0)) / mass
        along = front_along * np.cos(steer) - front_n.sum(axis=0) * np.sin(steer) + rear_along
        force_x = (along - handling.drag_kgpm * speed_mps**2) / mass
        turned = ahead * across - behind * rear_n.sum(axis=0) + half_track * np.sin(steer) * (front_n[0] - front_n[1])
        yaw_accel = turned / handling.yaw_inertia_kgm2
        # The wheels' axes meet on the rear axle's line.
        rolls = np.zeros(len(mu))
        for left_m in (half_track, -half_track):
            angle = np.arctan(np.tan(steer) / (1.0 - np.tan(steer) * left_m / wheelbase))
            rolls += 0.5 * (
                (speed_mps - yaw_rate * left_m) * np.cos(angle) + (velocity_y + ahead * yaw_rate) * np.sin(angle)
            )
        front_slip, rear_slip = front.rolling_slip(), rear.rolling_slip()
        rows.append(
            (
                speed_mps / (1.0 - 0.5 * (front_slip + rear_slip)),
                yaw_rate,
                yaw_accel,
                steer,
                force_x,
                force_y,
                rolls / (1.0 - front_slip),
                speed_mps / (1.0 - rear_slip),
            )
        )
        velocity_y = velocity_y + STEP_S * (force_y - yaw_rate * speed_mps)
        yaw_rate = yaw_rate + STEP_S * yaw_accel
        steer = steer + STEP_S * STEER_GAIN_RADS2PM * (wanted - force_y)
    sensed = np.array(rows[::SENSED_EVERY_COUNT]).transpose(2, 1, 0)
    return [_motion(signals) for signals in sensed]


def _motion(signals: FloatArray) -> Motion:
    speed, yaw_rate, yaw_accel, steer, force_x, force_y, front_wheels, rear_wheels = signals
    count, step_s = len(speed), SENSED_EVERY_COUNT * STEP_S
    return Motion(
        step_s=step_s,
        inside=np.ones(count, dtype=bool),
        counted_weight=np.full(count, 0.5),
        speed_mps=speed,
        yaw_rate_radps=yaw_rate,
        yaw_accel_radps2=yaw_accel,
        steer_rad=steer,
        force_x_mps2=force_x,
        force_y_mps2=force_y,
        force_y_rate_mps3=np.gradient(force_y, step_s),
        normal_mps2=np.full(count, GRAVITY_MPS2),
        bank_rad=np.zeros(count),
        front_wheels_mps=front_wheels,
        rear_wheels_mps=rear_wheels,
    )

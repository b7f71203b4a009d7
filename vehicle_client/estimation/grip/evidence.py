"""All channels' likelihoods as the figures that are sent: where they peak, how steeply they fall, what was asked.

First a coarse grid of frictions from ice to dry asphalt, then a fine one around the best: near the limit a passage
knows its friction to a hundredth, far below it to a factor. The likelihood of all channels together is told twice: as
best friction with the distances at which it falls by 1/2, 2 and 8, and as a profile on a fixed grid that a road side
unit can add up over vehicles.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.features import GRIP_DEMAND_LEVELS_FRAC, GRIP_SHAPES, MISFIT_LIMIT, PROFILE_FLOOR, PROFILE_FRICTIONS_MU
from vehicle_client.estimation.grip.channels import channels
from vehicle_client.estimation.grip.likelihood import log_likelihood

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.grip.channels import Channels
    from vehicle_client.estimation.grip.motion import Motion
    from vehicle_client.estimation.grip.noise import GripNoise
    from vehicle_client.estimation.handling import Handling
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

COARSE_MU = np.geomspace(0.10, 1.25, 21)
_COARSE_STEP = float(np.log(COARSE_MU[1] / COARSE_MU[0]))
_FINE_OFFSETS = _COARSE_STEP * np.linspace(-1.1, 1.1, 19)
"""Natural logarithms, around the best of the coarse grid."""


def grip_evidence(motion: Motion, *, handling: Handling, geometry: VehicleGeometry, noise: GripNoise) -> FloatArray:
    """Return the grip features, in the order of the feature table.

    Mirroring the drive left to right changes none of them.

    Args:
        motion: Over the section, at least one sample inside.
        handling: Of the own car.
        geometry: Of the own car.
        noise: Of its sensors.
    """

    def profiles(friction_mu: FloatArray) -> tuple[dict[str, FloatArray], Channels]:
        found = channels(motion, friction_mu, handling=handling, geometry=geometry, noise=noise)
        weight = motion.counted_weight
        limit = -0.5 * (found.excess_ratio**2 * weight).sum(axis=1)
        steering = limit + log_likelihood(found.steering, weight)
        drift = log_likelihood(found.drift, weight)
        wheels = log_likelihood(found.wheel_slip, weight)
        told = {
            "all": steering + drift + wheels,
            "steering": steering,
            "drift": limit + drift,
            "wheels": limit + wheels,
        }
        return told, found

    coarse, found = profiles(COARSE_MU)
    best = float(np.log(COARSE_MU[int(np.argmax(coarse["all"]))]))
    fine_mu = np.exp(np.clip(best + _FINE_OFFSETS, np.log(COARSE_MU[0]), np.log(COARSE_MU[-1])))
    fine, _ = profiles(fine_mu)
    friction = np.concatenate([COARSE_MU, fine_mu])
    order = np.argsort(friction, kind="stable")
    log_mu = np.log(friction[order])
    told = {name: np.concatenate([coarse[name], fine[name]])[order] for name in coarse}
    samples = max(1.0, float(motion.counted_weight.sum()))
    shapes = [_shape(log_mu, told[name], samples, drops) for name, drops in GRIP_SHAPES.items()]
    profile = np.interp(np.log(PROFILE_FRICTIONS_MU), log_mu, told["all"])
    return np.concatenate(
        [
            *shapes,
            np.maximum(profile - told["all"].max(), PROFILE_FLOOR),
            _demand(motion, found.demand_mu[motion.inside]),
        ]
    )


def _shape(log_mu: FloatArray, told: FloatArray, samples: float, drops: tuple[float, ...]) -> FloatArray:
    """Return best friction, how far below and above it the likelihood falls by each of the drops, and misfit a sample.

    Where it never falls that far, the distance is to the end of the grid. (2 drops + 2,)
    """
    top = int(np.argmax(told))
    falls = told - told[top]
    below = [_distance(log_mu[top::-1], falls[top::-1], drop) for drop in drops]
    above = [_distance(log_mu[top:], falls[top:], drop) for drop in drops]
    return np.array([float(np.exp(log_mu[top])), *below, *above, min(-told[top] / samples, MISFIT_LIMIT)])


def _distance(log_mu: FloatArray, falls: FloatArray, drop: float) -> float:
    """Return how far from the first place on the likelihood has fallen by `drop`, linear between places."""
    beyond = np.flatnonzero(falls <= -drop)
    if len(beyond) == 0:
        return abs(float(log_mu[-1] - log_mu[0]))
    place = int(beyond[0])
    share = (-drop - falls[place - 1]) / (falls[place] - falls[place - 1])
    return abs(float(log_mu[place - 1] + share * (log_mu[place] - log_mu[place - 1]) - log_mu[0]))


def _demand(motion: Motion, demand_mu: FloatArray) -> FloatArray:
    """Return how much was asked of the road: quantiles of the demand, extremes of force and turning. (9,)"""
    inside = motion.inside
    across, along = np.abs(motion.force_y_mps2[inside]), motion.force_x_mps2[inside]
    turning = np.abs(motion.yaw_rate_radps[inside])
    ordered = np.sort(demand_mu)
    at = [ordered[round(level * (len(ordered) - 1))] for level in GRIP_DEMAND_LEVELS_FRAC]
    return np.array([*at, across.max(), across.mean(), along.min(), along.max(), turning.max()])

"""All channels' likelihoods as the figures that are sent: where they peak, how steeply they fall, what was asked.

First a coarse grid of frictions from ice to dry asphalt, then a fine one around the best: near the limit a passage
knows its friction to a hundredth, far below it to a factor. The likelihood of all channels together is told twice: as
best friction with the distances at which it falls by 1/2, 2 and 8, and as a profile on a fixed grid that a road side
unit can add up over vehicles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.features import (
    GRIP_DEMAND_LEVELS_FRAC,
    GRIP_SHAPES,
    GRIP_USE_LEVELS_FRAC,
    MISFIT_LIMIT,
    PROFILE_FLOOR,
    PROFILE_FRICTIONS_MU,
)
from vehicle_client.estimation.grip.channels import channels
from vehicle_client.estimation.grip.forces import axle_forces
from vehicle_client.estimation.grip.likelihood import log_likelihood
from vehicle_client.estimation.grip.motion import Evidence

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.grip.channels import Channels
    from vehicle_client.estimation.grip.motion import Motion
    from vehicle_client.estimation.grip.noise import GripNoise
    from vehicle_client.estimation.handling import Handling
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

COARSE_MU = np.geomspace(0.10, 1.25, 21)
_COARSE_STEP = float(np.log(COARSE_MU[1] / COARSE_MU[0]))
_FINE_OFFSETS = _COARSE_STEP * np.linspace(-1.1, 1.1, 18)
"""Natural logarithms, around the best of the coarse grid; an even number, so that no friction is asked about twice."""
_CHANNELS = (Evidence.STEERING, Evidence.DRIFT, Evidence.WHEELS)
_DEMAND_LIMIT_MU = 10.0
_TIE = 1e-3
"""Frictions whose log-likelihoods differ by less are equally good: such a difference is no evidence."""


def grip_evidence(motion: Motion, *, handling: Handling, geometry: VehicleGeometry, noise: GripNoise) -> FloatArray:
    """Return the grip features, in the order of the feature table.

    Mirroring the drive left to right changes none of them. What tells nothing, be it that a sensor is absent or that
    the road was straight, has the middle of the grid for its best friction and both ends for its distances.

    Args:
        motion: Over the section, at least one sample inside.
        handling: Of the own car.
        geometry: Of the own car.
        noise: Of its sensors.
    """
    forces = axle_forces(motion, handling=handling, geometry=geometry)

    def profiles(friction_mu: FloatArray) -> tuple[dict[str, FloatArray], Channels]:
        found = channels(motion, forces, friction_mu, handling=handling, geometry=geometry, noise=noise)
        weight = motion.counted_weight
        told = {
            Evidence.LIMIT: -0.5 * (found.excess_ratio**2 @ weight),
            Evidence.STEERING: log_likelihood(found.steering, weight),
            Evidence.DRIFT: log_likelihood(found.drift, weight),
            Evidence.WHEELS: log_likelihood(found.wheel_slip, weight),
        }
        told |= {silent: np.zeros(len(friction_mu)) for silent in motion.silent}
        by_shape = {"all": sum(told.values(), start=np.zeros(len(friction_mu)))}
        for channel in _CHANNELS:
            # What cannot be counts for each of them, but gives no voice to one that has none.
            limit = 0.0 if channel in motion.silent else told[Evidence.LIMIT]
            by_shape[str(channel)] = told[channel] + limit
        return by_shape, found

    coarse, found = profiles(COARSE_MU)
    fine_mu = COARSE_MU[_top(np.log(COARSE_MU), coarse["all"])] * np.exp(_FINE_OFFSETS)
    fine, _ = profiles(fine_mu)
    friction = np.concatenate([COARSE_MU, fine_mu])
    order = np.argsort(friction)
    log_mu = np.log(friction[order])
    told = {name: np.concatenate([coarse[name], fine[name]])[order] for name in coarse}
    samples = max(1.0, float(motion.counted_weight.sum()))
    peaks = {name: _peak(log_mu, told[name]) for name in GRIP_SHAPES}
    everything = peaks["all"]
    best_mu = float(np.exp(everything.best_log_mu))
    places = [best_mu, *(peaks[name].best_log_mu - everything.best_log_mu for name in GRIP_SHAPES if name != "all")]
    shapes = [
        np.array([place, *_shape(peaks[name], samples, drops)])
        for place, (name, drops) in zip(places, GRIP_SHAPES.items(), strict=True)
    ]
    profile = -(np.interp(np.log(PROFILE_FRICTIONS_MU), everything.log_mu, everything.deviation_ratio) ** 2)
    return np.concatenate(
        [*shapes, np.maximum(profile, PROFILE_FLOOR), _demand(motion, found.demand_mu[motion.inside], best_mu=best_mu)]
    )


@dataclass(frozen=True, slots=True)
class _Peak:
    """A log-likelihood about its top, told as the root of how far it falls: a line where the likelihood is a Gaussian.

    Attributes:
        log_mu: Frictions in rising order, that of the top among them. (k,)
        deviation_ratio: Root of the fall, negative below the top. (k,)
        top: Where the top stands among them.
        height_ratio: Log-likelihood of the top.
    """

    log_mu: FloatArray
    deviation_ratio: FloatArray
    top: int
    height_ratio: float

    @property
    def best_log_mu(self) -> float:
        """Where the top is."""
        return float(self.log_mu[self.top])


def _top(log_mu: FloatArray, told: FloatArray) -> int:
    """Return where a log-likelihood is highest; the middle of all such places if there are several."""
    best = np.flatnonzero(told >= told.max() - _TIE)
    middle = 0.5 * (log_mu[best[0]] + log_mu[best[-1]])
    return int(best[np.argmin(np.abs(log_mu[best] - middle))])


def _peak(log_mu: FloatArray, told: FloatArray) -> _Peak:
    """Return a log-likelihood about its top: of a parabola through the highest place and its neighbours."""
    top = _top(log_mu, told)
    at, height = float(log_mu[top]), float(told[top])
    if 0 < top < len(told) - 1:
        before, after = log_mu[top - 1] - at, log_mu[top + 1] - at
        rise, fall = (told[top - 1] - height) / before, (told[top + 1] - height) / after
        bend = (fall - rise) / (after - before)
        slope = rise - bend * before
        away = -0.5 * slope / bend if bend < 0.0 else 0.0
        if before < away < after:
            at, height = at + away, height + 0.5 * slope * away
    deviation = np.sqrt(np.maximum(height - told, 0.0))
    deviation[log_mu < at] *= -1.0
    place = int(np.searchsorted(log_mu, at))
    return _Peak(np.insert(log_mu, place, at), np.insert(deviation, place, 0.0), place, height)


def _shape(peak: _Peak, samples: float, drops: tuple[float, ...]) -> FloatArray:
    """Return how far below and above its top the likelihood falls by each of the drops, and its misfit a sample.

    Where it never falls that far, the distance is to the end of the grid. (2 drops + 1,)
    """
    top, log_mu, deviation = peak.top, peak.log_mu, peak.deviation_ratio
    below = [_distance(log_mu[top::-1], -deviation[top::-1], drop) for drop in drops]
    above = [_distance(log_mu[top:], deviation[top:], drop) for drop in drops]
    return np.array([*below, *above, min(max(-peak.height_ratio / samples, 0.0), MISFIT_LIMIT)])


def _distance(log_mu: FloatArray, deviation: FloatArray, drop: float) -> float:
    """Return how far from the first place on the likelihood has fallen by `drop`."""
    limit = drop**0.5
    beyond = np.flatnonzero(deviation >= limit)
    if len(beyond) == 0:
        return abs(float(log_mu[-1] - log_mu[0]))
    place = int(beyond[0])
    share = (limit - deviation[place - 1]) / (deviation[place] - deviation[place - 1])
    return abs(float(log_mu[place - 1] + share * (log_mu[place] - log_mu[place - 1]) - log_mu[0]))


def _demand(motion: Motion, demand_mu: FloatArray, *, best_mu: float) -> FloatArray:
    """Return how much was asked of the road: quantiles of the demand, extremes of force and turning. (11,)"""
    inside = motion.inside
    across, along = np.abs(motion.force_y_mps2[inside]), motion.force_x_mps2[inside]
    turning = np.abs(motion.yaw_rate_radps[inside])
    ordered = np.minimum(np.sort(demand_mu), _DEMAND_LIMIT_MU)

    def at(level_frac: float) -> float:
        return float(ordered[round(level_frac * (len(ordered) - 1))])

    use = [at(level) / best_mu for level in GRIP_USE_LEVELS_FRAC]
    demand = [at(level) for level in GRIP_DEMAND_LEVELS_FRAC]
    return np.array([*use, *demand, across.max(), across.mean(), along.min(), along.max(), turning.max()])

"""All channels' likelihoods as the figures that are sent: where they peak, how steeply they fall, what was asked.

First a coarse grid of frictions from ice to dry asphalt, then a fine one around the best: near the limit a passage
knows its friction to a hundredth, far below it to a factor. The likelihood of all channels together is told twice: as
best friction with the distances at which it falls by 1/2, 2 and 8, and as a profile on a fixed grid that a road side
unit can add up over vehicles. Then the drive is cut in two, and told how much grip was found in the part that found
less of it: a road need not have one friction all along.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.features import (
    GAIN_LIMIT,
    GRIP_DEMAND_LEVELS_FRAC,
    GRIP_PARTS,
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
from vehicle_client.estimation.grip.parts import cut_in_two
from vehicle_client.estimation.grip.peak import peak_of, top_of

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.estimation.grip.channels import Channels
    from vehicle_client.estimation.grip.motion import Motion
    from vehicle_client.estimation.grip.noise import GripNoise
    from vehicle_client.estimation.grip.peak import Peak
    from vehicle_client.estimation.handling import Handling
    from vehicle_client.estimation.vehicle_geometry import VehicleGeometry

COARSE_MU = np.geomspace(0.10, 1.25, 21)
_COARSE_STEP = float(np.log(COARSE_MU[1] / COARSE_MU[0]))
_FINE_OFFSETS = _COARSE_STEP * np.linspace(-1.1, 1.1, 18)
"""Natural logarithms, around the best of the coarse grid; an even number, so that no friction is asked about twice."""
_PART_OFFSETS = _COARSE_STEP * np.linspace(-1.1, 1.1, 8)
"""The same for a part of the drive, which knows its friction less well."""
_CHANNELS = (Evidence.STEERING, Evidence.DRIFT, Evidence.WHEELS)
_DEMAND_LIMIT_MU = 10.0
_ONE_SD = 0.5
"""The fall of the log-likelihood one deviation away, of a Gaussian."""


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

    def ask(friction_mu: FloatArray) -> _Answers:
        found = channels(motion, forces, friction_mu, handling=handling, geometry=geometry, noise=noise)
        return _Answers(np.log(friction_mu), found, motion)

    coarse, weight = ask(COARSE_MU), motion.counted_weight
    told = coarse.by_sample(weight)
    coarsely = coarse.by_shape(told)
    fine = ask(_close_to_top(coarsely["all"], _FINE_OFFSETS))
    finely = fine.by_shape(fine.by_sample(weight))
    peaks = {name: _joint_peak((coarse, coarsely[name]), (fine, finely[name])) for name in GRIP_SHAPES}
    everything = peaks["all"]

    gain, weak, firm, weak_weight = 0.0, everything, everything, weight
    if (cut := cut_in_two(np.sum(list(told.values()), axis=0), weight, step_s=motion.step_s)) is not None:
        weaker, firmer = sorted((coarse.part(part) for part in cut), key=lambda part: _ceiling(part.peak))
        close = ask(_close_to_top(weaker.told_ratio, _PART_OFFSETS))
        weak = _joint_peak((coarse, weaker.told_ratio), (close, close.part(weaker.weight).told_ratio))
        firm, weak_weight = firmer.peak, weaker.weight
        gain = min(max(weak.height_ratio + firm.height_ratio - everything.height_ratio, 0.0), GAIN_LIMIT)

    profile = -(np.interp(np.log(PROFILE_FRICTIONS_MU), everything.log_mu, everything.deviation_ratio) ** 2)
    demand_mu = np.minimum(coarse.found.demand_mu, _DEMAND_LIMIT_MU)
    weak_demand_mu = float(demand_mu[weak_weight > 0.0].max(initial=0.0))
    return np.array(
        [
            *_shapes(peaks, samples=max(1.0, float(weight.sum()))),
            *np.maximum(profile, PROFILE_FLOOR),
            gain,
            *_of_parts(weak, firm, everything),
            weak_demand_mu / float(np.exp(weak.best_log_mu)),
            *_demand(motion, demand_mu[motion.inside], best_mu=float(np.exp(everything.best_log_mu))),
        ]
    )


@dataclass(frozen=True, slots=True)
class _Answers:
    """What a grid of frictions predicts of a motion.

    Attributes:
        log_mu: The frictions that were asked about, in rising order. (frictions,)
        found: What they predict, and by how much they miss.
        motion: The motion.
    """

    log_mu: FloatArray
    found: Channels
    motion: Motion

    def by_sample(self, weight: FloatArray) -> dict[Evidence, FloatArray]:
        """Return how well each friction explains every sample; zeros from what is silent. Each (frictions, n)

        Args:
            weight: How many independent samples each sample stands for; 0 of those that do not count. (n,)
        """
        told = {
            Evidence.LIMIT: -0.5 * weight * self.found.excess_ratio**2,
            Evidence.STEERING: log_likelihood(self.found.steering, weight),
            Evidence.DRIFT: log_likelihood(self.found.drift, weight),
            Evidence.WHEELS: log_likelihood(self.found.wheel_slip, weight),
        }
        return told | {silent: np.zeros_like(self.found.excess_ratio) for silent in self.motion.silent}

    def by_shape(self, told: dict[Evidence, FloatArray]) -> dict[str, FloatArray]:
        """Return how well each friction explains all samples, by the names of `GRIP_SHAPES`. Each (frictions,)

        Args:
            told: By sample.
        """
        summed = {evidence: by_sample.sum(axis=1) for evidence, by_sample in told.items()}
        by_shape = {"all": sum(summed.values(), start=np.zeros(len(self.log_mu)))}
        for channel in _CHANNELS:
            # What cannot be counts for each of them, but gives no voice to one that has none.
            limit = 0.0 if channel in self.motion.silent else summed[Evidence.LIMIT]
            by_shape[str(channel)] = summed[channel] + limit
        return by_shape

    def part(self, weight: FloatArray) -> _Part:
        """Return what some of the samples tell.

        Args:
            weight: As for `by_sample`.
        """
        told = self.by_shape(self.by_sample(weight))["all"]
        return _Part(weight, told, peak_of(self.log_mu, told))


@dataclass(frozen=True, slots=True)
class _Part:
    """What a part of the drive tells.

    Attributes:
        weight: How many independent samples each sample stands for; 0 of those outside the part. (n,)
        told_ratio: How well each friction explains it, by everything that tells. (frictions,)
        peak: The same about its top.
    """

    weight: FloatArray
    told_ratio: FloatArray
    peak: Peak


def _close_to_top(coarsely: FloatArray, offsets: FloatArray) -> FloatArray:
    """Return frictions so far, as natural logarithms, from the best of the coarse grid. (offsets,)"""
    log_mu = np.log(COARSE_MU)
    close: FloatArray = np.exp(log_mu[top_of(log_mu, coarsely)] + offsets)
    return close


def _joint_peak(*told: tuple[_Answers, FloatArray]) -> Peak:
    """Return the peak of what several grids tell."""
    log_mu = np.concatenate([asked.log_mu for asked, _ in told])
    order = np.argsort(log_mu)
    return peak_of(log_mu[order], np.concatenate([values for _, values in told])[order])


def _ceiling(peak: Peak) -> float:
    """Return how much grip there may well be, as natural logarithm."""
    return peak.best_log_mu + peak.above(_ONE_SD)


def _shapes(peaks: dict[str, Peak], *, samples: float) -> list[float]:
    """Return for all channels together and each of them where it peaks, how far away it falls, and its misfit."""
    figures = []
    best_log_mu = peaks["all"].best_log_mu
    for name, drops in GRIP_SHAPES.items():
        peak = peaks[name]
        figures.append(float(np.exp(best_log_mu)) if name == "all" else peak.best_log_mu - best_log_mu)
        figures += [peak.below(drop) for drop in drops]
        figures += [peak.above(drop) for drop in drops]
        figures.append(min(max(-peak.height_ratio / samples, 0.0), MISFIT_LIMIT))
    return figures


def _of_parts(weak: Peak, firm: Peak, everything: Peak) -> list[float]:
    """Return where the likelihood of each part peaks, and how far away it falls."""
    figures = []
    for name, peak in (("weak", weak), ("firm", firm)):
        figures.append(peak.best_log_mu - everything.best_log_mu)
        figures += [peak.below(drop) for drop in GRIP_PARTS[name]["below"]]
        figures += [peak.above(drop) for drop in GRIP_PARTS[name]["above"]]
    return figures


def _demand(motion: Motion, demand_mu: FloatArray, *, best_mu: float) -> list[float]:
    """Return how much was asked of the road: quantiles of the demand, extremes of force and turning."""
    inside = motion.inside
    across, along = np.abs(motion.force_y_mps2[inside]), motion.force_x_mps2[inside]
    turning = np.abs(motion.yaw_rate_radps[inside])
    ordered = np.sort(demand_mu)

    def at(level_frac: float) -> float:
        return float(ordered[round(level_frac * (len(ordered) - 1))])

    use = [at(level) / best_mu for level in GRIP_USE_LEVELS_FRAC]
    demand = [at(level) for level in GRIP_DEMAND_LEVELS_FRAC]
    return [*use, *demand, across.max(), across.mean(), along.min(), along.max(), turning.max()]

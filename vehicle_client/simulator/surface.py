"""Roughness of the road: a random profile under the left and the right wheels.

The displacement spectrum of each wheel track is that of ISO 8608, Gd(n) = Gd(n0) (n / n0)^-2 with n0 = 0.1 cycles/m;
class A has Gd(n0) = 16e-6 m3. The slope of such a profile is white noise. Both tracks share their long waves and are
independent in the short ones; the crossover is that of an isotropic surface for a car's track. Waves longer than 100 m
belong to the map and are left out.

References:
    ISO 8608:2016, Mechanical vibration, road surface profiles, reporting of measured data, annex C. Dodds and Robson,
    The description of road surface roughness, J. Sound and Vibration 31 (1973), for two tracks.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vehicle_client.simulator.compilation import cached_kernel
from vehicle_client.simulator.plan import RoughnessClass

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

CLASS_A_DENSITY_M3 = 16e-6
REFERENCE_WAVE_NUMBER_1PM = 0.1
CLASS_RATIO = 4.0
"""From one class to the next the density is four times as large."""
LONGEST_WAVE_M = 100.0
COMMON_WAVE_NUMBER_1PM = 0.2
"""Waves longer than its inverse lift both tracks together. Estimate for a track of 1.6 m on an isotropic surface."""
GRID_M = 0.1


def class_density_m3(roughness: RoughnessClass) -> float:
    """Return Gd(n0) in the middle of a class of ISO 8608: 16e-6 m3 for A, four times as much for every class on."""
    return CLASS_A_DENSITY_M3 * CLASS_RATIO ** list(RoughnessClass).index(roughness)


def roughness_m(rng: np.random.Generator, *, length_m: float, density_m3: float = CLASS_A_DENSITY_M3) -> FloatArray:
    """Return the height of the left and the right wheel track every 0.1 m. (n, 2)

    Args:
        rng: Source of chance.
        length_m: Of the profile.
        density_m3: Gd(n0), 16e-6 for class A and four times as much for every class further.
    """
    count = math.ceil(length_m / GRID_M) + 2
    # One-sided density of a white sequence is 2 sigma^2 step.
    slope_density = (2.0 * math.pi * REFERENCE_WAVE_NUMBER_1PM) ** 2 * density_m3
    sigma = math.sqrt(slope_density / (2.0 * GRID_M))
    return _tracks(rng.standard_normal((count, 3)), sigma * GRID_M)


@cached_kernel  # it calls nothing, so its own file is all there is to watch
def _tracks(noise: FloatArray, rise_m: float) -> FloatArray:
    """Return the two tracks from a common and two own white sequences.

    A first-order low pass of the common one and the high pass of the own one, which together pass everything.
    """
    t = math.tan(math.pi * COMMON_WAVE_NUMBER_1PM * GRID_M)
    c = (t - 1.0) / (t + 1.0)
    keep = math.exp(-2.0 * math.pi * GRID_M / LONGEST_WAVE_M)
    count = len(noise)
    tracks = np.zeros((count, 2))
    passed = np.zeros(3)
    before = np.zeros(3)
    for k in range(1, count):
        for j in range(3):
            # All-pass of first order; low and high pass are half its sum and half its difference with the input.
            passed[j] = c * noise[k, j] + before[j] - c * passed[j]
            before[j] = noise[k, j]
        common = 0.5 * (noise[k, 0] + passed[0])
        for j in range(2):
            own = 0.5 * (noise[k, j + 1] - passed[j + 1])
            tracks[k, j] = keep * tracks[k - 1, j] + rise_m * (common + own)
    return tracks

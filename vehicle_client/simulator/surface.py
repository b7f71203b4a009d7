"""Roughness of the road: a random profile under the left and the right wheels.

The displacement spectrum of each wheel track is that of ISO 8608, Gd(n) = Gd(n0) (n / n0)^-2 with n0 = 0.1 cycles/m,
over the wave numbers for which the standard states it, 0.011 to 2.83 cycles/m. Longer waves belong to the map. Class A
has Gd(n0) = 16e-6 m3 in its middle; a class reaches from half to twice that, and the next one has four times as much.

Both tracks are cuts through one isotropic surface. For this spectrum their normalised cross spectrum is known in closed
form, z K1(z) with z = 2 pi n b, b the distance of the tracks and K1 a Bessel function: the variogram along one track is
proportional to the distance, hence between the tracks to the length of the slanted line. Waves longer than some 30 m
lift both wheels, those shorter than 3 m each wheel by itself. Measured roads scatter widely around it.

The waves are summed by a fast Fourier transform over a period that is longer than the profile by the longest wave. So
spectrum and cross spectrum are right at every wave number, from the first metre on, and the ends do not meet.

What a tyre levels out: read by straight lines between the samples, a wave shrinks by sinc^2(0.1 n), which a contact
patch of 0.14 m does too (they differ by 1 % at the shortest wave). That is a usual length for a tyre of this size
(estimate), so the profile itself is not smoothed.

References:
    ISO 8608:2016, Mechanical vibration, road surface profiles, reporting of measured data, and its annex C. Kamash and
    Robson, The application of isotropy in road surface modelling, J. Sound and Vibration 57 (1978), for two tracks.
    Mucka, Model of coherence function of road unevenness in parallel tracks for vehicle simulation, Int. J. Vehicle
    Design 67 (2015), for measured ones. Shinozuka and Deodatis, Simulation of stochastic processes by spectral
    representation, Applied Mechanics Reviews 44 (1991).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from vehicle_client.simulator.plan import RoughnessClass

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

CLASS_A_DENSITY_M3 = 16e-6
REFERENCE_WAVE_NUMBER_1PM = 0.1
CLASS_RATIO = 4.0
"""From one class to the next the density is four times as large."""
LOWEST_WAVE_NUMBER_1PM = 0.011
HIGHEST_WAVE_NUMBER_1PM = 2.83
TRACK_M = 1.67
"""Distance of the two wheel tracks: the mean of both axles of the XC90."""
GRID_M = 0.1
"""Between two samples; whoever drives over them takes straight lines."""
_PERIOD_MULTIPLE = 1024
"""Periods are multiples of it, so that transforms are fast and few of them differ."""


def class_density_m3(roughness: RoughnessClass) -> float:
    """Return Gd(n0) in the middle of a class of ISO 8608: 16e-6 m3 for A, four times as much for every class on."""
    return CLASS_A_DENSITY_M3 * CLASS_RATIO ** list(RoughnessClass).index(roughness)


def isotropic_coherence_ratio(wave_number_1pm: FloatArray, *, track_m: float = TRACK_M) -> FloatArray:
    """Return the cross spectrum of two parallel tracks over the spectrum of one: 1 for long waves, 0 for short ones.

    It is real, and its square is the magnitude-squared coherence.

    Args:
        wave_number_1pm: Cycles per metre, from 1e-6 on. (n,)
        track_m: Distance of the tracks.
    """
    z = 2.0 * math.pi * track_m * wave_number_1pm
    # K1(z) is the integral of exp(-z cosh t) cosh t over t > 0. The trapezoidal rule is exact to rounding at this step.
    step, last = 0.25, 16.0
    cosh = np.cosh(np.arange(0.0, last, step))
    weight = np.where(cosh == 1.0, 0.5 * step, step)
    ratio: FloatArray = z * (np.exp(-z[:, None] * cosh) * (weight * cosh)).sum(axis=1)
    return ratio


def roughness_m(rng: np.random.Generator, *, length_m: float, density_m3: float = CLASS_A_DENSITY_M3) -> FloatArray:
    """Return the height of the left and the right wheel track every 0.1 m. (n, 2), one row per station in memory

    The surface reaches from zero to at least `length_m`. Its mean over many draws is zero.

    Args:
        rng: Source of chance; how many numbers are drawn depends on the length alone.
        length_m: Of the profile.
        density_m3: Gd(n0), 16e-6 for class A and four times as much for every class further.
    """
    count = math.ceil(length_m / GRID_M) + 2
    wanted = count + math.ceil(1.0 / (LOWEST_WAVE_NUMBER_1PM * GRID_M))
    period_count = _PERIOD_MULTIPLE * math.ceil(wanted / _PERIOD_MULTIPLE)
    first, amplitude = _amplitudes(period_count)
    chance = rng.standard_normal((len(amplitude), 2, 2)).view(np.complex128)[..., 0]
    chance *= amplitude
    chance *= math.sqrt(density_m3)
    # Half the sum and half the difference of the tracks are independent of each other.
    waves = np.zeros((period_count // 2 + 1, 2), dtype=np.complex128)
    used = waves[first : first + len(amplitude)]
    np.add(chance[:, 0], chance[:, 1], out=used[:, 0])
    np.subtract(chance[:, 0], chance[:, 1], out=used[:, 1])
    return np.fft.irfft(waves, n=period_count, axis=0, norm="forward")[:count]


@lru_cache(maxsize=32)
def _amplitudes(period_count: int) -> tuple[int, FloatArray]:
    """Return the number of the first wave of a period, and the amplitudes of it and its followers at Gd(n0) = 1 m3.

    Args:
        period_count: Samples in a period.

    Returns:
        Column 0 is half the sum of the tracks, column 1 half their difference. (n, 2)
    """
    step_1pm = 1.0 / (period_count * GRID_M)
    first = math.ceil(LOWEST_WAVE_NUMBER_1PM / step_1pm)
    last = math.floor(HIGHEST_WAVE_NUMBER_1PM / step_1pm)
    n: FloatArray = step_1pm * np.arange(first, last + 1, dtype=np.float64)
    density = (n / REFERENCE_WAVE_NUMBER_1PM) ** -2 * step_1pm
    together = isotropic_coherence_ratio(n)
    # A wave a cos + b sin has the transform (a - i b) / 2, and variances of a and b are both its share of the spectrum.
    amplitude = 0.5 * np.sqrt(0.5 * density[:, None] * np.column_stack([1.0 + together, 1.0 - together]))
    amplitude.flags.writeable = False
    return first, amplitude

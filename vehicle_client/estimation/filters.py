"""Smoothing without delay: every filter runs forward and backward, since a passage is over when it is judged."""

from __future__ import annotations

from functools import cache

import numpy as np

from roadgrip.units import SAMPLE_RATE_HZ, SAMPLE_S, FloatArray

TAPS_COUNT = 31
"""The paper's "filter order of 30"."""
CUTOFF_HZ = 10.0
"""Half amplitude of a single pass."""
EDGE_SAMPLES_COUNT = TAPS_COUNT - 1
"""Samples at either end that lean on the extension beyond the trace."""


@cache
def lowpass_taps() -> FloatArray:
    """Return the impulse response of one pass: windowed sinc, Hamming window, gain 1 at rest. (31,)

    References:
        Oppenheim and Schafer, Discrete-Time Signal Processing, section "Design of FIR filters by windowing".
    """
    offset = np.arange(TAPS_COUNT) - (TAPS_COUNT - 1) / 2.0
    taps: FloatArray = np.sinc(2.0 * CUTOFF_HZ / SAMPLE_RATE_HZ * offset) * np.hamming(TAPS_COUNT)
    taps /= taps.sum()
    taps.flags.writeable = False
    return taps


@cache
def _two_way_taps() -> FloatArray:
    # Forward and backward in one: the convolution of a symmetric response with itself.
    taps = np.convolve(lowpass_taps(), lowpass_taps())
    taps.flags.writeable = False
    return taps


def smoothed(signal: FloatArray) -> FloatArray:
    """Return the signal low-passed at 10 Hz, forward and backward, so without delay. (n,)

    Beyond its ends the signal is continued point-symmetrically about its first and last sample (odd extension): a
    constant stays constant and a straight line straight. The first and last 30 samples lean on that guess, which is
    why approach and exit are recorded. One NaN spreads 30 samples either way.

    Args:
        signal: Any quantity at 100 Hz, more than 30 samples. (n,)

    Raises:
        ValueError: There are too few samples.

    References:
        Langstrand and Rabi, Learning to cooperatively estimate road surface friction, section "Smoothing using a
        two-way filter": 100 Hz, 10 Hz, order 30. That the filter is a Hamming-window FIR is our reading.
    """
    edge = EDGE_SAMPLES_COUNT
    if len(signal) <= edge:
        message = f"{len(signal)} samples are too few to smooth; more than {edge} are needed"
        raise ValueError(message)
    before = 2.0 * signal[0] - signal[edge:0:-1]
    after = 2.0 * signal[-1] - signal[-2 : -edge - 2 : -1]
    return np.convolve(np.concatenate([before, signal, after]), _two_way_taps(), mode="valid")


def slow_part(signal: FloatArray, *, crossover_hz: float) -> FloatArray:
    """Return what of a signal is slower than the crossover; the signal minus it is the complementary fast part. (n,)

    First-order low-pass run forward and backward: the gain is 1 / (1 + (f / f_c)^2), and one half at the crossover.
    Beyond its ends the signal is taken as mirrored, so a constant stays constant. NaN spreads everywhere.

    Args:
        signal: Any quantity at 100 Hz, at least one sample. (n,)
        crossover_hz: Frequency where slow and fast part weigh the same; positive.

    References:
        The result minimises sum (y - x)^2 + w sum (y[k+1] - y[k])^2, whose normal equations are tridiagonal and are
        solved by elimination (Golub and Van Loan, Matrix Computations, section 4.3).
    """
    n = len(signal)
    if n < 2:
        return signal.astype(np.float64)
    w = 1.0 / (2.0 * np.pi * crossover_hz * SAMPLE_S) ** 2
    # Python floats: a recursion over numpy scalars is some five times slower.
    values = signal.tolist()
    diagonal = 1.0 + w
    ratios = [0.0] * n
    forward = [0.0] * n
    ratio = w / diagonal
    carried = values[0] / diagonal
    ratios[0], forward[0] = ratio, carried
    inner = 1.0 + 2.0 * w
    for k in range(1, n):
        pivot = (inner if k < n - 1 else diagonal) - w * ratio
        ratio = w / pivot
        carried = (values[k] + w * carried) / pivot
        ratios[k], forward[k] = ratio, carried
    result = forward
    following = carried
    for k in range(n - 2, -1, -1):
        following = forward[k] + ratios[k] * following
        result[k] = following
    return np.array(result)


def rate_of_change(signal: FloatArray) -> FloatArray:
    """Return the time derivative by central differences, one-sided at the ends; unit of the signal per second. (n,)"""
    return np.gradient(signal, SAMPLE_S)


def integral(signal: FloatArray) -> FloatArray:
    """Return the time integral from the first sample by the trapezoidal rule; the first value is 0. (n,)"""
    return np.concatenate([[0.0], np.cumsum((signal[1:] + signal[:-1]) * (SAMPLE_S / 2.0))])

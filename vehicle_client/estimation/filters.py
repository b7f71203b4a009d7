"""Smoothing without delay: every filter runs forward and backward, since a passage is over when it is judged."""

from __future__ import annotations

from enum import StrEnum
from functools import cache
from typing import assert_never

import numpy as np

from roadgrip.units import SAMPLE_RATE_HZ, SAMPLE_S, FloatArray

TAPS_COUNT = 31
"""The paper's "filter order of 30"."""
CUTOFF_HZ = 10.0
"""Half amplitude of a single pass."""
EDGE_SAMPLES_COUNT = TAPS_COUNT - 1
"""Samples at either end that lean on the extension beyond the trace."""
BUTTERWORTH_ORDER = 30
BUTTERWORTH_REACH_COUNT = 800
"""The Butterworth filter rings this long, in samples, until twelve decimal places are gone."""


class LowPass(StrEnum):
    """How "order 30, 10 Hz, forward and backward" is read; the paper does not name the filter."""

    HAMMING_FIR = "hamming_fir"
    """31 taps of a Hamming-windowed sinc. Forgets after 30 samples, gain 1/4 at 10 Hz in both passes together."""
    BUTTERWORTH = "butterworth"
    """Thirty poles. A steep edge, gain 1/2 at 10 Hz in both passes together, but it rings for seconds."""


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


def smoothed(signal: FloatArray, lowpass: LowPass = LowPass.HAMMING_FIR) -> FloatArray:
    """Return the signal low-passed at 10 Hz, forward and backward, so without delay. (n,)

    Beyond its ends the signal is continued point-symmetrically about its first and last sample (odd extension): a
    constant stays constant and a straight line straight. The first and last 30 samples lean on that guess, which is
    why approach and exit are recorded. One NaN spreads 30 samples either way, with the Butterworth filter everywhere.

    Args:
        signal: Any quantity at 100 Hz, more than 30 samples. (n,)
        lowpass: Which reading of the paper's filter.

    Raises:
        ValueError: There are too few samples.

    References:
        Langstrand and Rabi, Learning to cooperatively estimate road surface friction, section "Smoothing using a
        two-way filter": 100 Hz, 10 Hz, order 30. That the filter is a Hamming-window FIR is our reading.
    """
    if len(signal) <= EDGE_SAMPLES_COUNT:
        message = f"{len(signal)} samples are too few to smooth; more than {EDGE_SAMPLES_COUNT} are needed"
        raise ValueError(message)
    match lowpass:
        case LowPass.HAMMING_FIR:
            return np.convolve(_extended(signal, EDGE_SAMPLES_COUNT), _two_way_taps(), mode="valid")
        case LowPass.BUTTERWORTH:
            return _butterworth_smoothed(signal)
        case _:
            assert_never(lowpass)


def _extended(signal: FloatArray, count: int) -> FloatArray:
    """Return the signal with `count` samples more at either end, fewer than it has itself. (n + 2 count,)"""
    before = 2.0 * signal[0] - signal[count:0:-1]
    after = 2.0 * signal[-1] - signal[-2 : -count - 2 : -1]
    return np.concatenate([before, signal, after])


def _butterworth_smoothed(signal: FloatArray) -> FloatArray:
    """Return the signal after a Butterworth filter and the same backwards. (n,)

    Both passes together have no phase and the squared magnitude, which is applied to the spectrum. What wraps around
    has decayed within the extension.

    References:
        Oppenheim and Schafer, Discrete-Time Signal Processing, section "Bilinear transformation": of the analogue
        filter |H|^2 = 1 / (1 + (w / w_c)^(2 N)) with w = tan(pi f / f_s), the cut-off frequency prewarped.
    """
    # Short signals are mirrored more than once, each time about the end reached.
    extended = np.pad(signal, BUTTERWORTH_REACH_COUNT, mode="reflect", reflect_type="odd")
    frequency_hz = np.fft.rfftfreq(len(extended), SAMPLE_S)
    warped = np.tan(np.pi * np.minimum(frequency_hz / SAMPLE_RATE_HZ, 0.499)) / np.tan(
        np.pi * CUTOFF_HZ / SAMPLE_RATE_HZ
    )
    gain = 1.0 / (1.0 + warped ** (2 * BUTTERWORTH_ORDER))
    smooth = np.fft.irfft(np.fft.rfft(extended) * gain, len(extended))
    return smooth[BUTTERWORTH_REACH_COUNT:-BUTTERWORTH_REACH_COUNT]


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

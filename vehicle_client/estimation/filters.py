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
_BLOCK_COUNT = 32
"""Samples that are smoothed by one product; about the fastest."""
BUTTERWORTH_ORDER = 30
BUTTERWORTH_REACH_COUNT = 1100
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


@cache
def _block_taps() -> FloatArray:
    """Return the matrix from a stretch of signal to a block of smoothed samples in its middle. (92, 32)"""
    matrix = np.zeros((_BLOCK_COUNT + 2 * EDGE_SAMPLES_COUNT, _BLOCK_COUNT))
    for column in range(_BLOCK_COUNT):
        matrix[column : column + 2 * EDGE_SAMPLES_COUNT + 1, column] = _two_way_taps()
    matrix.flags.writeable = False
    return matrix


def smoothed(signal: FloatArray, lowpass: LowPass = LowPass.HAMMING_FIR) -> FloatArray:
    """Return the signal low-passed at 10 Hz, forward and backward, so without delay. (n,)

    Beyond its ends the signal is continued point-symmetrically about its first and last sample (odd extension): a
    constant stays constant and a straight line straight. The first and last 30 samples lean on that guess, which is
    why approach and exit are recorded. One NaN spreads 30 to 61 samples either way, with the Butterworth filter
    everywhere.

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
            return _hamming_smoothed(signal)
        case LowPass.BUTTERWORTH:
            return _butterworth_smoothed(signal)
        case _:
            assert_never(lowpass)


def _hamming_smoothed(signal: FloatArray) -> FloatArray:
    """Return the convolution with both passes' response, block by block as one product of matrices. (n,)

    That takes half the time of numpy's convolution.
    """
    n, edge = len(signal), EDGE_SAMPLES_COUNT
    blocks_count = -(-n // _BLOCK_COUNT)
    extended = np.zeros(blocks_count * _BLOCK_COUNT + 2 * edge)
    np.subtract(2.0 * signal[0], signal[edge:0:-1], out=extended[:edge])
    extended[edge : edge + n] = signal
    np.subtract(2.0 * signal[-1], signal[-2 : -edge - 2 : -1], out=extended[edge + n : 2 * edge + n])
    step = extended.itemsize
    # Overlapping stretches of the one array: each begins a block after the one before.
    stretches = np.ndarray(
        (blocks_count, _BLOCK_COUNT + 2 * edge), buffer=extended, strides=(_BLOCK_COUNT * step, step)
    )
    smooth: FloatArray = (np.ascontiguousarray(stretches) @ _block_taps()).reshape(-1)[:n]
    return smooth


def _butterworth_smoothed(signal: FloatArray) -> FloatArray:
    """Return the signal after a Butterworth filter and the same backwards. (n,)

    Both passes together have no phase and the squared magnitude, which is applied to the spectrum. What wraps around
    has decayed within the extension.

    References:
        Oppenheim and Schafer, Discrete-Time Signal Processing, section "Bilinear transformation": of the analogue
        filter |H|^2 = 1 / (1 + (w / w_c)^(2 N)) with w = tan(pi f / f_s), the cut-off frequency prewarped.
    """
    # Short signals are mirrored more than once, each time about the end reached.
    count = _fast_length(len(signal) + 2 * BUTTERWORTH_REACH_COUNT)
    after_count = count - len(signal) - BUTTERWORTH_REACH_COUNT
    extended = np.pad(signal, (BUTTERWORTH_REACH_COUNT, after_count), mode="reflect", reflect_type="odd")
    # At half the sampling frequency the tangent has no value, and a little before it the gain is 0 already.
    cycles = np.minimum(np.arange(count // 2 + 1) / count, 0.499)
    ratio = np.tan(np.pi * cycles) / np.tan(np.pi * CUTOFF_HZ / SAMPLE_RATE_HZ)
    spectrum = np.fft.rfft(extended) / (1.0 + ratio ** (2 * BUTTERWORTH_ORDER))
    return np.fft.irfft(spectrum, count)[BUTTERWORTH_REACH_COUNT : BUTTERWORTH_REACH_COUNT + len(signal)]


def _fast_length(count: int) -> int:
    """Return a length from `count` on that Fourier transforms quickly: a power of two times 1, 3 or 5."""
    return min(factor << max(0, (-(-count // factor) - 1).bit_length()) for factor in (2, 3, 5))


def slow_part(signal: FloatArray, *, crossover_hz: float) -> FloatArray:
    """Return what of a signal is slower than the crossover; the signal minus it is the complementary fast part. (n,)

    First-order low-pass run forward and backward: the gain is 1 / (1 + (f / f_c)^2), and one half at the crossover.
    Beyond its ends the signal is taken as mirrored, so a constant stays constant. NaN spreads everywhere.

    Args:
        signal: Any quantity at 100 Hz, at least one sample. (n,)
        crossover_hz: Frequency where slow and fast part weigh the same; positive.

    References:
        The result y of a signal x solves y[k] - w (y[k-1] - 2 y[k] + y[k+1]) = x[k], and thereby minimises
        sum (y - x)^2 + w sum (y[k+1] - y[k])^2. On a circle the discrete Fourier transform solves it (Golub and Van
        Loan, Matrix Computations, section 4.8); the two solutions without signal then mend the ends.
    """
    n = len(signal)
    w = 1.0 / (2.0 * np.pi * crossover_hz * SAMPLE_S) ** 2
    m = _fast_length(n + 1)
    eigenvalue = 1.0 + 4.0 * w * np.sin(np.pi / m * np.arange(m // 2 + 1)) ** 2
    circular = np.fft.irfft(np.fft.rfft(signal, m) / eigenvalue, m)
    # rho^k solves the equation without signal, rho + 1 / rho = 2 + 1 / w; so does its mirror image.
    rho = 1.0 + (1.0 - np.sqrt(1.0 + 4.0 * w)) / (2.0 * w)
    falling = rho ** np.arange(n)
    # Mirrored means y[-1] = y[0] and y[n] = y[n-1].
    jump = np.array([circular[0] - circular[-1], circular[n - 1] - circular[n]])
    near, far = 1.0 / rho - 1.0, (rho - 1.0) * falling[-1]
    at_start, at_end = (near * jump - far * jump[::-1]) / (near**2 - far**2)
    result: FloatArray = circular[:n] + at_start * falling + at_end * falling[::-1]
    return result


def rate_of_change(signal: FloatArray) -> FloatArray:
    """Return the time derivative by central differences, one-sided at the ends; unit of the signal per second. (n,)"""
    result = np.empty(len(signal))
    np.subtract(signal[2:], signal[:-2], out=result[1:-1])
    result[1:-1] /= 2.0 * SAMPLE_S
    result[0] = (signal[1] - signal[0]) / SAMPLE_S
    result[-1] = (signal[-1] - signal[-2]) / SAMPLE_S
    return result


def integral(signal: FloatArray) -> FloatArray:
    """Return the time integral from the first sample by the trapezoidal rule; the first value is 0. (n,)"""
    result = np.zeros(len(signal))
    np.cumsum((signal[1:] + signal[:-1]) * (SAMPLE_S / 2.0), out=result[1:])
    return result

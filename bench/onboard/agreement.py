"""How well an estimate agrees with the truth: pure figures from arrays, drive by drive, then pooled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from roadgrip.units import SAMPLE_S, FloatArray


class Agreement(NamedTuple):
    """One drive's estimate against its truth, in moments that can be pooled; each a mean over its samples.

    Attributes:
        error_square: Of the error.
        error: Of the estimate less the truth.
        truth: Of the truth.
        estimate: Of the estimate.
        truth_square: Of the truth's square.
        estimate_square: Of the estimate's square.
        product: Of truth times estimate.
        peak_truth: The truth where it is largest in magnitude.
        peak_estimate: The estimate at that sample.
        largest_error: Largest magnitude of the error.
    """

    error_square: float
    error: float
    truth: float
    estimate: float
    truth_square: float
    estimate_square: float
    product: float
    peak_truth: float
    peak_estimate: float
    largest_error: float


def agreement(estimate: FloatArray, truth: FloatArray) -> Agreement:
    """Return how one drive's estimate agrees with its truth.

    Args:
        estimate: At least one sample. (n,)
        truth: In the same unit. (n,)
    """
    error = estimate - truth
    peak = int(np.argmax(np.abs(truth)))
    return Agreement(
        error_square=float(np.mean(error**2)),
        error=float(np.mean(error)),
        truth=float(np.mean(truth)),
        estimate=float(np.mean(estimate)),
        truth_square=float(np.mean(truth**2)),
        estimate_square=float(np.mean(estimate**2)),
        product=float(np.mean(truth * estimate)),
        peak_truth=float(truth[peak]),
        peak_estimate=float(estimate[peak]),
        largest_error=float(np.abs(error).max()),
    )


def pooled(drives: Sequence[Agreement], *, unit: str) -> dict[str, float | int]:
    """Return the figures of several drives, each of which weighs the same however long it took.

    Args:
        drives: At least one.
        unit: Ends the names of the figures that have one.

    Returns:
        `rms_error`, the root of the mean of the drives' mean squares, with its standard error over drives; `rms_truth`,
        which is the error of claiming zero; `correlation_ratio` over all samples; `bias`; the median over drives of
        what is estimated at the truth's peak over that peak, of the peak itself, and of the largest error.
    """
    table = np.array(drives)
    mean = dict(zip(Agreement._fields, table.mean(axis=0).tolist(), strict=True))
    rms = float(np.sqrt(mean["error_square"]))
    squares = table[:, Agreement._fields.index("error_square")]
    spread = float(np.std(squares, ddof=1) / np.sqrt(len(squares))) if len(squares) > 1 else np.nan
    by_name = {name: table[:, i] for i, name in enumerate(Agreement._fields)}
    peak = by_name["peak_truth"]
    variance_truth = mean["truth_square"] - mean["truth"] ** 2
    variance_estimate = mean["estimate_square"] - mean["estimate"] ** 2
    covariance = mean["product"] - mean["truth"] * mean["estimate"]
    both = variance_truth * variance_estimate
    return {
        "drives_count": len(drives),
        f"rms_error_{unit}": rms,
        # The root's standard error, by the slope of the root.
        f"rms_error_standard_error_{unit}": spread / (2.0 * rms) if rms > 0.0 else 0.0,
        f"rms_truth_{unit}": float(np.sqrt(mean["truth_square"])),
        "correlation_ratio": float(covariance / np.sqrt(both)) if both > 0.0 else 0.0,
        f"bias_{unit}": mean["error"],
        "seen_of_peak_q50_ratio": float(np.median(by_name["peak_estimate"] / np.where(peak == 0.0, np.inf, peak))),
        f"peak_truth_q50_{unit}": float(np.median(np.abs(peak))),
        f"largest_error_q50_{unit}": float(np.median(by_name["largest_error"])),
        f"largest_error_largest_{unit}": float(by_name["largest_error"].max()),
    }


def gain_by_frequency(
    drives: Sequence[tuple[FloatArray, FloatArray]], *, edges_hz: Sequence[float]
) -> Mapping[str, list[float]]:
    """Return how much of the truth an estimate shows at each frequency, and how coherent both are there.

    The gain is the real part of the cross-spectrum over the truth's spectrum: 1 where the estimate follows the truth in
    size and phase, 0 where it knows nothing of it. Each drive weighs with its energy.

    Args:
        drives: Estimate and truth at 100 Hz, each pair of one length.
        edges_hz: Bounds of the bands.

    References:
        Bendat and Piersol, Random Data, chapter "Single-input/output relationships".
    """
    bands_count = len(edges_hz) - 1
    crossed, of_truth, of_estimate = np.zeros((3, bands_count), dtype=np.complex128)
    for estimate, truth in drives:
        window = np.hanning(len(truth))
        spectra = [np.fft.rfft((signal - signal.mean()) * window) for signal in (estimate, truth)]
        frequency_hz = np.fft.rfftfreq(len(truth), SAMPLE_S)
        band = np.digitize(frequency_hz, edges_hz) - 1
        known = (band >= 0) & (band < bands_count) & (frequency_hz > 0.0)
        for total, product in (
            (crossed, spectra[0] * np.conj(spectra[1])),
            (of_truth, np.abs(spectra[1]) ** 2),
            (of_estimate, np.abs(spectra[0]) ** 2),
        ):
            np.add.at(total, band[known], product[known])
    both = np.maximum(np.abs(of_truth * of_estimate), 1e-300)
    return {
        "gain_ratio": (crossed.real / np.maximum(of_truth.real, 1e-300)).tolist(),
        "coherence_ratio": (np.abs(crossed) ** 2 / both).tolist(),
    }

"""Figures of merit: how far estimates lie from the truth, in parts of the truth unless the name says friction."""

from __future__ import annotations

import numpy as np

from roadgrip.units import FloatArray


def mape_ratio(truth_mu: FloatArray, estimate_mu: FloatArray) -> float:
    """Return the mean absolute error relative to the truth.

    References:
        Langstrand and Rabi, equation of the MAPE.
    """
    return float(np.mean(np.abs(truth_mu - estimate_mu) / truth_mu))


def relative_rms_ratio(truth_mu: FloatArray, estimate_mu: FloatArray) -> float:
    """Return the root mean square of the errors relative to the truth, each error by its own truth."""
    return float(np.sqrt(np.mean(((truth_mu - estimate_mu) / truth_mu) ** 2)))


def rms_mu(truth_mu: FloatArray, estimate_mu: FloatArray) -> float:
    """Return the root mean square of the errors, in friction."""
    return float(np.sqrt(np.mean((truth_mu - estimate_mu) ** 2)))

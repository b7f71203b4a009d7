"""What an expected error means: split conformal prediction on the logarithm of friction."""

from __future__ import annotations

import numpy as np

from roadgrip.bundle import Conformal
from roadgrip.errors import RoadgripError
from roadgrip.units import FloatArray


def nonconformity_ratio(truth_mu: FloatArray, estimate_mu: FloatArray, expected_error_ratio: FloatArray) -> FloatArray:
    """Return how many expected errors each estimate is off, on the logarithm. (n,)

    Args:
        truth_mu: Positive. (n,)
        estimate_mu: Positive. (n,)
        expected_error_ratio: Positive. (n,)
    """
    return np.abs(np.log(truth_mu / estimate_mu)) / expected_error_ratio


def conformal_of(
    truth_mu: FloatArray,
    estimate_mu: FloatArray,
    expected_error_ratio: FloatArray,
    *,
    coverage_frac: float,
    doubtful_above_ratio: float,
) -> Conformal:
    """Return what turns expected errors into intervals that hold the truth as often as asked.

    Over new passages that are exchangeable with these, the interval holds the truth with a probability of at least
    `coverage_frac` (and at most 1/(n + 1) more). Passages of one road are not exchangeable with those of the next: give
    rows of roads of which neither model learned anything, and many of them.

    Args:
        truth_mu: Friction of the calibration's passages, of which neither model learned anything. (n,)
        estimate_mu: What the friction model says of them. (n,)
        expected_error_ratio: What the model of the error says of them. (n,)
        coverage_frac: How often the interval shall hold the truth.
        doubtful_above_ratio: See `roadgrip.bundle.Conformal`.

    Raises:
        RoadgripError: There are too few passages for so high a coverage, or a figure is not positive.

    References:
        Papadopoulos, Proedrou, Vovk, Gammerman, Inductive confidence machines for regression, 2002.
        Lei, G'Sell, Rinaldo, Tibshirani, Wasserman, Distribution-free predictive inference for regression, 2018,
        sections 2.2 and 5.2.
    """
    figures = np.concatenate([truth_mu, estimate_mu, expected_error_ratio])
    if not (np.isfinite(figures).all() and (figures > 0.0).all()):
        message = "friction, estimates and expected errors of a calibration must be positive"
        raise RoadgripError(message)
    scores = np.sort(nonconformity_ratio(truth_mu, estimate_mu, expected_error_ratio))
    # The rank among n + 1 exchangeable scores, the new one included; hence not the plain quantile of n.
    rank = int(np.ceil(coverage_frac * (len(scores) + 1)))
    if not 0 < rank <= len(scores):
        message = f"{len(scores)} passages are too few for a coverage of {coverage_frac:g}"
        raise RoadgripError(message)
    return Conformal(
        coverage_frac=coverage_frac, quantile=float(scores[rank - 1]), doubtful_above_ratio=doubtful_above_ratio
    )

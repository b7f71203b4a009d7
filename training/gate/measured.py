"""Estimates against measured friction: what is only true in a simulator shows here."""

from __future__ import annotations

import numpy as np

from training.error_model import LEAST_MU
from training.gate.contender import Case
from training.gate.thresholds import MeasuredThresholds
from training.gate.verdict import Check, check_of


def measured_truth(case: Case, limits: MeasuredThresholds) -> Check:
    """Return whether estimates agree with measured friction as well as the measurement itself allows.

    With few rows it only informs.

    Args:
        case: The hold-out of measured labels.
        limits: What is asked.
    """
    errors, count = case.error_ratio(case.challenger), len(case.runs)
    bias = float(np.mean(np.log(np.maximum(np.nan_to_num(case.challenger.mu), LEAST_MU) / case.label_mu)))
    figures = {"bias_ratio": bias, "error_ratio": float(errors.mean()), "rows_count": float(count)}
    bounds = {"bias_ratio": limits.bias_ratio}
    passed = abs(bias) <= limits.bias_ratio
    said = (
        f"bias {100 * bias:+.1f} % ({100 * limits.bias_ratio:g} % at most either way), "
        f"error {100 * errors.mean():.1f} %"
    )
    sds_mu = np.full(count, np.nan) if case.label_sd_mu is None else case.label_sd_mu
    known = np.isfinite(sds_mu) & (sds_mu > 0.0)
    if not known.any():
        bounds["error_ratio"] = limits.error_ratio
        passed = passed and errors.mean() <= limits.error_ratio
        said += f" ({100 * limits.error_ratio:g} % at most)"
    else:
        off = np.nan_to_num(case.challenger.mu)[known] - case.label_mu[known]
        rms_sds = float(np.sqrt(np.mean((off / sds_mu[known]) ** 2)))
        figures["error_sds_ratio"] = rms_sds
        bounds["error_sds_ratio"] = limits.error_sds_ratio
        passed = passed and rms_sds <= limits.error_sds_ratio
        said += f", {rms_sds:.1f} standard deviations of the labels ({limits.error_sds_ratio:g} at most)"
    enough = count >= limits.required_from_count
    return check_of(
        "measured_truth",
        case.title,
        passed=bool(passed),
        required=enough,
        figures=figures,
        limits=bounds,
        sentence=f"{count} measured drives: {said}" + ("" if enough else "; too few to decide"),
    )

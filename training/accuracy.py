"""Figures of merit: how far estimates lie from the truth, in parts of the truth unless the name says friction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from roadgrip.units import FloatArray

FEWEST_ROADS = 10
"""Errors on fewer roads say nothing about the next one."""

Measure: TypeAlias = Callable[[FloatArray, FloatArray], float]
"""From truth and estimates to a figure of merit."""


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


def by_group(
    measure: Measure, groups: Sequence[str], *, truth_mu: FloatArray, estimate_mu: FloatArray
) -> dict[str, float]:
    """Return a figure of merit for every group, by name, groups in the order of their names.

    Args:
        measure: Such as `mape_ratio`.
        groups: The group of each, such as its scenario. (n,)
        truth_mu: (n,)
        estimate_mu: (n,)
    """
    names = np.array(groups)
    return {name: measure(truth_mu[names == name], estimate_mu[names == name]) for name in sorted(set(names.tolist()))}

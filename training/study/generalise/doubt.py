"""How doubtful estimates are told: intervals placed by other roads, thresholds, and how well a signal tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadgrip.units import BoolArray, FloatArray
from training.regressor import RowIndices
from training.study.generalise.held_out import HeldOut

FEWEST_COUNT = 50
"""So many passages at least for a quantile of their own."""


@dataclass(frozen=True, slots=True)
class Intervals:
    """Intervals around estimates, placed by what passages on other roads had.

    Attributes:
        half_width_ratio: On the logarithm of friction. (m,)
        holds: Which hold the truth. (m,)
    """

    half_width_ratio: FloatArray
    holds: BoolArray


def intervals(judged: HeldOut, *, scale_ratio: FloatArray, class_number: RowIndices, coverage_frac: float) -> Intervals:
    """Return an interval for each passage, as wide as passages on other roads needed it to be.

    Args:
        judged: The passages.
        scale_ratio: Widths are multiples of it. (m,)
        class_number: Passages of a class have a multiple of their own. (m,)
        coverage_frac: How often the interval shall hold the truth.

    References:
        Vovk, Cross-conformal predictors, 2015; Vovk, Lindsay, Nouretdinov, Gammerman, Mondrian confidence machine, 2003
        (quantiles by class).
    """
    score = np.abs(judged.log_ratio) / scale_ratio
    multiple = np.full(len(judged), np.nan)
    for number in np.unique(judged.fold).tolist():
        here, others = judged.fold == number, judged.fold != number
        for kind in np.unique(class_number).tolist():
            alike = others & (class_number == kind)
            scores = np.sort(score[alike if alike.sum() >= FEWEST_COUNT else others])
            rank = min(int(np.ceil(coverage_frac * (len(scores) + 1))), len(scores))
            multiple[here & (class_number == kind)] = scores[rank - 1]
    return Intervals(half_width_ratio=multiple * scale_ratio, holds=score <= multiple)


def best_threshold(signal: FloatArray, wanted: BoolArray) -> float:
    """Return above which value a signal best tells the wanted ones; the largest value if there are none to tell.

    Args:
        signal: (m,)
        wanted: Which are wanted. (m,)

    References:
        Youden, Index for rating diagnostic tests, Cancer 3(1), 1950.
    """
    if not wanted.any() or wanted.all():
        return float(signal.max())
    levels = np.unique(np.quantile(signal, np.linspace(0.01, 0.99, 99)))
    gain = [float(np.mean(signal[wanted] > level) - np.mean(signal[~wanted] > level)) for level in levels]
    return float(levels[int(np.argmax(gain))])


def told_apart_frac(signal: FloatArray, wanted: BoolArray) -> float:
    """Return how often a wanted one has more of a signal than another, both by chance; a half says nothing.

    NaN where there are none to tell apart. It is the area under the ROC curve.

    References:
        Hanley and McNeil, The meaning and use of the area under a ROC curve, Radiology 143, 1982.
    """
    if not wanted.any() or wanted.all():
        return np.nan
    others, those = np.sort(signal[~wanted]), signal[wanted]
    below = np.searchsorted(others, those, side="left") + np.searchsorted(others, those, side="right")
    return float(below.mean() / (2.0 * len(others)))

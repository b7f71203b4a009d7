"""Where a drive is best cut in two, if the road did not have one friction all along.

A bend in the shade, the end of a gritted stretch: the likelihood of a whole drive then settles somewhere between both
frictions, while drivers need the lesser one. Cut is where both sides, each with a friction of its own, explain most.

References:
    Hinkley, Inference about the change-point in a sequence of random variables, Biometrika 57 (1970): the place that
    maximises the likelihood of both sides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

PART_MIN_S = 1.5
"""Less of a drive says nothing of its own: the slow parts taken out of the drift are not shorter."""
GAIN_MIN = 1.0
"""Two frictions that explain a drive no better than one by this, as log-likelihood, are none: such a cut is noise."""
_PART_MIN_COUNT = 3


def cut_in_two(told_ratio: FloatArray, weight: FloatArray, *, step_s: float) -> tuple[FloatArray, FloatArray] | None:
    """Return the weights of the samples in the first part and in the second, 0 in the other; None if it is not cut.

    It is not where it is too short, or where two frictions hardly explain more than one.

    Args:
        told_ratio: How well each friction explains every sample. (frictions, n)
        weight: How many independent samples each sample stands for. (n,)
        step_s: Time between samples.
    """
    counted = np.flatnonzero(weight > 0.0)
    least = max(_PART_MIN_COUNT, round(PART_MIN_S / step_s))
    if len(counted) < 2 * least:
        return None
    last_of_first = counted[least - 1 : -least]
    until = np.cumsum(told_ratio, axis=1)
    explained = until.max(axis=0) + (until[:, -1:] - until).max(axis=0)
    if explained[last_of_first].max() < until[:, -1].max() + GAIN_MIN:
        return None
    first = np.arange(len(weight)) <= last_of_first[np.argmax(explained[last_of_first])]
    return np.where(first, weight, 0.0), np.where(first, 0.0, weight)

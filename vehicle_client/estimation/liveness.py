"""Whether a sensor lives.

None shows the same value bit for bit for long, or stops at the end of its range, while others see the car move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import SAMPLE_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from roadgrip.units import BoolArray, FloatArray

OTHERS_RATIO = 4.0
"""A sensor is frozen only if it rests so many times longer than ever else, and than two others meanwhile."""
WITNESSES_MIN_COUNT = 2


def rests(values: FloatArray, valid: BoolArray) -> NDArray[np.int64]:
    """Return where a channel takes up a new value: borders of the stretches in which it rests. (k + 1,)

    The first border is 0 and the last one n. A sample that is missing ends a rest.
    """
    moved = values[1:] != values[:-1]
    if not valid.all():
        moved |= ~(valid[1:] & valid[:-1])
    return np.concatenate([[0], np.flatnonzero(moved) + 1, [len(values)]])


def frozen_rows(borders: dict[str, NDArray[np.int64]], name: str) -> slice | None:
    """Return the stretch in which one channel rests far longer than it ever else does, while two others live.

    Args:
        borders: Of all channels, from `rests`.
        name: Which channel.
    """
    own = np.diff(borders[name])
    longest = int(np.argmax(own))
    start, count = int(borders[name][longest]), int(own[longest])
    own[longest] = 0
    if count < OTHERS_RATIO * max(1, int(own.max())) and len(own) > 1:
        return None
    living = 0
    for other, edges in borders.items():
        if other != name:
            low, high = np.searchsorted(edges, [start, start + count])
            within = np.diff(np.concatenate([[start], edges[low:high], [start + count]]))
            living += count >= OTHERS_RATIO * int(within.max())
    return slice(start, start + count) if living >= WITNESSES_MIN_COUNT else None


def clipped_s(values: FloatArray, borders: NDArray[np.int64], *, least_value: float) -> float:
    """Return for how long a channel stays at its extreme value, bit for bit, three samples or more at a time.

    Args:
        values: The channel. (n,)
        borders: Of it, from `rests`.
        least_value: Smaller extremes are no end of a range.
    """
    own = np.diff(borders)
    held = (own > 2) & (np.abs(values[borders[:-1]]) == (extreme := float(np.abs(values).max())))
    return float(own[held].sum()) * SAMPLE_S if extreme >= least_value else 0.0

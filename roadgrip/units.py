"""Physical constants and the named conversions between what people say and what the code computes.

Everything inside roadgrip is SI. A conversion lives here or it does not exist.

Examples:
    >>> round(kph_to_mps(72.0), 9)
    20.0
    >>> round(mps_to_kph(20.0), 9)
    72.0
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
"""The array every pure function speaks."""

BoolArray: TypeAlias = NDArray[np.bool_]
"""A mask: true where the sample may be used."""

GRAVITY_MPS2 = 9.81
"""Acceleration of gravity, the value road design uses; Norway's true value lies between 9.82 and 9.83."""

SAMPLE_RATE_HZ = 100.0
"""Rate of every trace (the paper, section "Summarizing the vehicle state signals")."""

SAMPLE_S = 0.01
"""Duration of one sample."""

WINDOW_S = 3600.0
"""The rolling hour over which the road side unit combines vehicles."""

KPH_PER_MPS = 3.6

PASCAL_PER_BAR = 1e5
"""Tyre pressure is told in bar at the pump, and nowhere else."""


def kph_to_mps(speed_kph: float) -> float:
    """Return metres per second."""
    return speed_kph / KPH_PER_MPS


def mps_to_kph(speed_mps: float) -> float:
    """Return kilometres per hour, for a person's eyes only."""
    return speed_mps * KPH_PER_MPS


def deg_to_rad(angle_deg: float) -> float:
    """Return radians."""
    return float(np.deg2rad(angle_deg))

"""The paper's features by name: which signal, which statistic, what the vehicle sends and what the map says."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

from roadgrip.features import PAPER_TABLE, STATISTICS

PAPER_FEATURES: tuple[str, ...] = PAPER_TABLE.names
"""What the paper learns from: what the vehicle sends, then the road's geometry. (78)"""
KINEMATIC_FEATURES: tuple[str, ...] = tuple(feature.name for feature in PAPER_TABLE.kinematic)
"""Those that the vehicle sends: no road geometry. (55)"""

MEAN_AND_STD = ("mean", "std")
QUANTILES = ("q20", "q40", "q60", "q80", "min", "median", "max")
SHAPES = ("skewness", "kurtosis")

_NAME = re.compile(rf"(?P<signal>\w+?)_(?P<statistic>{'|'.join(STATISTICS)})(_[a-z0-9]+)?")


def signal_of(name: str) -> str:
    """Return which signal a feature summarises; the whole name where it summarises none."""
    match = _NAME.fullmatch(name)
    return match["signal"] if match else name


def statistic_of(name: str) -> str:
    """Return which statistic of its signal a feature is; empty where it is none."""
    match = _NAME.fullmatch(name)
    return match["statistic"] if match else ""


def without_signals(names: Sequence[str], signals: Collection[str]) -> tuple[str, ...]:
    """Return the features that summarise none of the signals, in order."""
    return tuple(name for name in names if signal_of(name) not in signals)


def of_statistics(names: Sequence[str], statistics: Collection[str]) -> tuple[str, ...]:
    """Return the features that are one of the statistics, in order."""
    return tuple(name for name in names if statistic_of(name) in statistics)


SPEED_FEATURES: tuple[str, ...] = tuple(name for name in PAPER_FEATURES if signal_of(name) == "speed")
"""Those by which a driver who knows the friction gives it away. (11)"""

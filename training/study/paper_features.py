"""The paper's features by name: which signal, which statistic, what the vehicle sends and what the map says."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

from roadgrip.features import FEATURE_NAMES, STATISTICS
from roadgrip.units import FloatArray
from training.dataset import DatasetError, Runs

KINEMATIC_SIGNALS = ("steer", "sideslip", "sideslip_rate", "yaw_rate_excess", "speed")
ROAD_SIGNALS = ("curvature", "road_difficulty")
LENGTH = "section_length_m"

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


PAPER_FEATURES: tuple[str, ...] = tuple(
    name for name in FEATURE_NAMES if name == LENGTH or signal_of(name) in (*KINEMATIC_SIGNALS, *ROAD_SIGNALS)
)
"""What the paper learns from. (78)"""


def without_signals(names: Sequence[str], signals: Collection[str]) -> tuple[str, ...]:
    """Return the features that summarise none of the signals, in order."""
    return tuple(name for name in names if signal_of(name) not in signals)


def of_statistics(names: Sequence[str], statistics: Collection[str]) -> tuple[str, ...]:
    """Return the features that are one of the statistics, in order."""
    return tuple(name for name in names if statistic_of(name) in statistics)


KINEMATIC_FEATURES = without_signals(PAPER_FEATURES, {*ROAD_SIGNALS, LENGTH})
"""Those that the vehicle sends: no road geometry. (55)"""
SPEED_FEATURES = tuple(name for name in PAPER_FEATURES if signal_of(name) == "speed")
"""Those that a driver who knows the friction gives it away by. (11)"""


def columns_by_name(runs: Runs, names: Sequence[str]) -> FloatArray:
    """Return some features of all runs, in the order of the names.

    Raises:
        DatasetError: There is no such feature.
    """
    place = {name: column for column, name in enumerate(FEATURE_NAMES)}
    missing = [name for name in names if name not in place]
    if missing:
        raise DatasetError(f"the feature table has no {', '.join(missing)}")
    return runs.features[:, np.array([place[name] for name in names], dtype=np.intp)]

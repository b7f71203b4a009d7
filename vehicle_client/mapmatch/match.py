"""What map matching says: when a vehicle was inside a section, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.order_statistics import first_of_each

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray


class MatchMethod(StrEnum):
    """What a match rests on."""

    GNSS = "gnss"
    """Position fixes, bridged by dead reckoning."""
    DEAD_RECKONING = "dead_reckoning"
    """Driven line against the map's, from speed and yaw rate alone."""


@dataclass(frozen=True, slots=True)
class SectionMatch:
    """A drive tied to a section.

    Attributes:
        station_m: Position along the section at every sample: negative before its start, beyond its length after its
            end. (n,)
        entry_s: When the vehicle passed the start, on the clock of the trace.
        exit_s: When it passed the end.
        confidence_frac: 0 to 1; how much of what the map predicts the drive showed. Each method defines it.
        position_std_m: Estimated standard deviation of the stations.
        method: What the match rests on.
    """

    station_m: FloatArray
    entry_s: float
    exit_s: float
    confidence_frac: float
    position_std_m: float
    method: MatchMethod

    def inside(self, time_s: FloatArray) -> BoolArray:
        """Return which samples lie inside the section. (n,)"""
        return (time_s >= self.entry_s) & (time_s < self.exit_s)


def section_match(
    time_s: FloatArray,
    station_m: FloatArray,
    *,
    length_m: float,
    confidence_frac: float,
    position_std_m: float,
    method: MatchMethod,
) -> SectionMatch:
    """Return the match for stations that never decrease; entry and exit are interpolated between samples.

    Where the stations stop short of an end by the little that the caller tolerates, the trace's own end is taken.
    """
    # Beyond a standstill the first sample at a station counts for the entry as for the exit.
    first = first_of_each(station_m)
    entry, leave = np.interp([0.0, length_m], station_m[first], time_s[first])
    return SectionMatch(
        station_m=station_m,
        entry_s=float(entry),
        exit_s=float(leave),
        confidence_frac=confidence_frac,
        position_std_m=position_std_m,
        method=method,
    )

"""Somebody else's columns as a trace, through a mapping that says which column means what."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.records import QualityFlag
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry
from vehicle_client.recording.channels import CHANNELS, WHEEL_COLUMNS
from vehicle_client.recording.resampling import repeated_count, trace_of_samples

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roadgrip.units import FloatArray
    from vehicle_client.estimation.trace import Trace


@dataclass(frozen=True, slots=True)
class Channel:
    """Where a quantity comes from in somebody else's recording.

    Attributes:
        column: Name of the column.
        gain: Times this; -1 turns an axis round.
    """

    column: str
    gain: float = 1.0


@dataclass(frozen=True, slots=True)
class ColumnMapping:
    """How to read somebody else's recording.

    Attributes:
        time_column: Seconds.
        channels: Per name in `CHANNELS` where it comes from. What is missing reads zero, and `Recording.missing`
            says so; wheel speeds may be missing only if there is a reference speed.
        reference: Quantities of a reference instrument, under the names they get in `Recording.reference`.
        reference_speed: Name among them of the forward speed that stands in for the wheels; empty if they are there.
        vehicle: The car that was driven.
    """

    time_column: str
    channels: Mapping[str, Channel]
    reference: Mapping[str, Channel] = field(default_factory=dict)
    reference_speed: str = ""
    vehicle: VehicleGeometry = XC90


@dataclass(frozen=True, slots=True)
class Recording:
    """A drive somebody else recorded.

    Attributes:
        trace: The sensors.
        reference: What reference instruments saw, on the samples of the trace. Each (n,)
        missing: Channels that the recording lacks and that read zero in the trace, or come from a reference.
        repeated_count: Rows or values that gave way to a later one with the same time.
    """

    trace: Trace
    reference: Mapping[str, FloatArray]
    missing: tuple[str, ...]
    repeated_count: int = 0


def recording_of_columns(columns: Mapping[str, FloatArray], mapping: ColumnMapping, *, place: str) -> Recording:
    """Return a drive that somebody else recorded.

    Args:
        columns: All (n,); NaN where a cell is empty.
        mapping: Which of them mean what.
        place: Where they come from, for messages.

    Raises:
        TraceError: A column is missing, or time runs backwards; the message says where.
    """
    wanted = [mapping.time_column, *(c.column for c in (*mapping.channels.values(), *mapping.reference.values()))]
    absent = sorted(set(wanted) - set(columns))
    if absent:
        message = f"{place}: no column {', '.join(absent)}"
        raise TraceError(message)
    time = columns[mapping.time_column]
    rows = {name: columns[c.column] * c.gain for name, c in mapping.channels.items()}
    missing = tuple(name for name in CHANNELS if name not in rows)
    reference = {name: columns[c.column] * c.gain for name, c in mapping.reference.items()}
    quality = QualityFlag.NONE
    if mapping.reference_speed:
        yaw_rate, steer = (rows.get(name, np.zeros_like(time)) for name in ("yaw_rate_radps", "steer_rad"))
        rows |= _wheels_of_speed(reference[mapping.reference_speed], yaw_rate, steer, mapping)
        quality = QualityFlag.REFERENCE_SPEED
    elif set(WHEEL_COLUMNS) & set(missing):
        message = f"{place}: no wheel speeds, and no reference speed to stand in for them"
        raise TraceError(message)
    values = np.column_stack([rows.get(name, np.zeros_like(time)) for name in CHANNELS])
    trace = replace(trace_of_samples(time, values, quality=quality), absent=missing)
    return Recording(
        trace=trace,
        reference={name: np.interp(trace.time_s, time, of) for name, of in reference.items()},
        missing=missing,
        repeated_count=repeated_count(time),
    )


def _wheels_of_speed(
    speed_mps: FloatArray, yaw_rate_radps: FloatArray, steer_rad: FloatArray, mapping: ColumnMapping
) -> dict[str, FloatArray]:
    """Return what four wheels that roll without slip would show at a forward speed, lateral velocity left out."""
    half = mapping.vehicle.track_m / 2.0
    across = yaw_rate_radps * mapping.vehicle.front_axle_m * np.sin(steer_rad)
    wheels = {}
    for name in WHEEL_COLUMNS:
        along = speed_mps - yaw_rate_radps * (half if "left" in name else -half)
        wheels[name] = along * np.cos(steer_rad) + across if "front" in name else along
    return wheels

"""Traces in our own columns (`vehicle_client.recording.channels`), whatever file they are kept in."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.trace import GnssTrack
from vehicle_client.recording.channels import (
    CHANNELS,
    GNSS_COLUMNS,
    GNSS_SPEED_COLUMN,
    SENSOR_COLUMNS,
    STABILITY_COLUMN,
    TIME_COLUMN,
    WHEEL_COLUMNS,
)
from vehicle_client.recording.resampling import trace_of_samples

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roadgrip.units import FloatArray
    from vehicle_client.estimation.trace import Trace

GNSS_ACCURACY_M = 3.0
"""Of a receiver that does not say."""


def trace_of_columns(columns: Mapping[str, FloatArray], *, place: str) -> Trace:
    """Return the trace that columns of our own format hold.

    Args:
        columns: All (n,); NaN where a cell is empty.
        place: Where they come from, for messages.

    Raises:
        TraceError: A column is missing, or time runs backwards; the message says where.
    """
    absent = [name for name in (TIME_COLUMN, *CHANNELS) if name not in columns]
    if absent:
        message = f"{place}: no column {', '.join(absent)}"
        raise TraceError(message)
    time = columns[TIME_COLUMN]
    active = columns.get(STABILITY_COLUMN)
    return trace_of_samples(
        time,
        np.column_stack([columns[name] for name in CHANNELS]),
        stability_active=None if active is None else active > 0.5,
        gnss=_gnss_of(columns, time),
    )


def columns_of_trace(trace: Trace) -> dict[str, FloatArray]:
    """Return a trace as columns of our own format; what is missing is NaN.

    Two fixes nearest to the same sample cannot both be kept; the later one is.
    """
    table: dict[str, FloatArray] = {TIME_COLUMN: trace.time_s}
    for name in SENSOR_COLUMNS:
        table[name] = np.where(trace.valid, getattr(trace, name), np.nan)
    for i, name in enumerate(WHEEL_COLUMNS):
        table[name] = np.where(trace.valid, trace.wheel_speed_mps[:, i], np.nan)
    if trace.stability_active is not None:
        table[STABILITY_COLUMN] = trace.stability_active.astype(np.int8)
    if trace.gnss is not None:
        table |= _gnss_columns(trace.gnss, trace.time_s)
    return table


def _gnss_of(columns: Mapping[str, FloatArray], time_s: FloatArray) -> GnssTrack | None:
    if "lat_deg" not in columns or "lon_deg" not in columns:
        return None
    fixed = np.isfinite(columns["lat_deg"]) & np.isfinite(columns["lon_deg"])
    if not fixed.any():
        return None
    at = columns.get("gnss_time_s", time_s)[fixed]
    accuracy = columns.get("gnss_accuracy_m", np.full_like(time_s, GNSS_ACCURACY_M))[fixed]
    speed = columns.get(GNSS_SPEED_COLUMN)
    return GnssTrack(
        time_s=np.where(np.isfinite(at), at, time_s[fixed]),
        lat_deg=columns["lat_deg"][fixed],
        lon_deg=columns["lon_deg"][fixed],
        accuracy_m=np.where(np.isfinite(accuracy), accuracy, GNSS_ACCURACY_M),
        speed_mps=None if speed is None else speed[fixed],
    )


def _gnss_columns(gnss: GnssTrack, time_s: FloatArray) -> dict[str, FloatArray]:
    row = np.clip(np.rint((gnss.time_s - time_s[0]) / SAMPLE_S).astype(int), 0, len(time_s) - 1)
    columns = dict(zip(GNSS_COLUMNS, (gnss.time_s, gnss.lat_deg, gnss.lon_deg, gnss.accuracy_m), strict=True))
    if gnss.speed_mps is not None:
        columns[GNSS_SPEED_COLUMN] = gnss.speed_mps
    table: dict[str, FloatArray] = {}
    for name, values in columns.items():
        table[name] = np.full(len(time_s), np.nan)
        table[name][row] = values
    return table

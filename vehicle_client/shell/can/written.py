"""A trace as the CAN log that a car of a given description would leave."""

from __future__ import annotations

from typing import TYPE_CHECKING

import can
import numpy as np

from vehicle_client.recording.channels import FIX_CHANNELS, SENSOR_COLUMNS, STABILITY_CHANNELS, WHEEL_COLUMNS
from vehicle_client.recording.frames import Frames, frames_of_values
from vehicle_client.shell.can.log_names import log_suffix
from vehicle_client.shell.can.mf4 import write_mf4

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from roadgrip.units import FloatArray
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.recording.frames import FrameLayout
    from vehicle_client.shell.can.description import CanMapping

FLAG_SAMPLES_COUNT = 2
"""Flags are sent 50 times a second, with every other sample."""
CLASSIC_BYTES_COUNT = 8


def write_log(path: Path, trace: Trace, mapping: CanMapping) -> None:
    """Write a trace as a CAN log, of a kind that its suffix says: .blf, .asc, .log or .mf4.

    What is missing is said to be invalid. Sensors are sent with every sample, flags with every other one, a position
    when it was fixed.

    Raises:
        OSError: The file cannot be written.
        ModuleNotFoundError: A log in .mf4 needs asammdf.
    """
    frames = frames_of_trace(trace, mapping)
    if log_suffix(path) == ".mf4":
        write_mf4(path, frames)
        return
    with can.Logger(path) as log:
        for i, time_s in enumerate(frames.time_s.tolist()):
            log.on_message_received(message_of(frames, i, time_s=time_s))


def message_of(frames: Frames, index: int, *, time_s: float) -> can.Message:
    """Return one of many frames as python-can has them, with a time stamp of its own."""
    return can.Message(
        timestamp=time_s,
        arbitration_id=int(frames.frame_id[index]),
        is_extended_id=bool(frames.extended[index]),
        data=frames.payloads[index, : frames.length_bytes[index]].tobytes(),
        channel=0,
    )


def frames_of_trace(trace: Trace, mapping: CanMapping) -> Frames:
    """Return the frames that say a trace; messages of what the trace does not have are left out."""
    parts = [
        part
        for by_bus in mapping.layouts.values()
        for layout in by_bus.values()
        if (part := _frames_of_layout(layout, trace)) is not None
    ]
    time_s = np.concatenate([part.time_s for part in parts])
    order = np.argsort(time_s, kind="stable")
    return Frames(
        time_s=time_s[order],
        frame_id=np.concatenate([part.frame_id for part in parts])[order],
        extended=np.concatenate([part.extended for part in parts])[order],
        length_bytes=np.concatenate([part.length_bytes for part in parts])[order],
        payloads=np.concatenate([part.payloads for part in parts])[order],
    )


def _frames_of_layout(layout: FrameLayout, trace: Trace) -> Frames | None:
    channels = {signal.source.channel for signal in layout.signals}
    if channels <= set(FIX_CHANNELS):
        time_s, values = _fix_values(trace)
    elif channels <= set(STABILITY_CHANNELS):
        time_s, values = _flag_values(trace)
    else:
        time_s, values = trace.time_s, _sensor_values(trace)
    values = {name: of for name, of in values.items() if name in channels}
    if set(values) != channels or not len(time_s):
        return None
    count = len(time_s)
    payloads = np.zeros((count, CLASSIC_BYTES_COUNT), dtype=np.uint8)
    payloads[:, : layout.bytes_count] = frames_of_values(layout, values)
    return Frames(
        time_s=time_s,
        frame_id=np.full(count, layout.frame_id),
        extended=np.full(count, layout.extended),
        length_bytes=np.full(count, layout.bytes_count),
        payloads=payloads,
    )


def _sensor_values(trace: Trace) -> dict[str, FloatArray]:
    values = {name: np.where(trace.valid, getattr(trace, name), np.nan) for name in SENSOR_COLUMNS}
    for i, name in enumerate(WHEEL_COLUMNS):
        values[name] = np.where(trace.valid, trace.wheel_speed_mps[:, i], np.nan)
    return values


def _flag_values(trace: Trace) -> tuple[FloatArray, Mapping[str, FloatArray]]:
    if trace.stability_active is None:
        return trace.time_s[:0], {}
    active = trace.stability_active[::FLAG_SAMPLES_COUNT].astype(np.float64)
    return trace.time_s[::FLAG_SAMPLES_COUNT], dict.fromkeys(STABILITY_CHANNELS, active)


def _fix_values(trace: Trace) -> tuple[FloatArray, Mapping[str, FloatArray]]:
    gnss = trace.gnss
    if gnss is None:
        return trace.time_s[:0], {}
    speed_mps = np.full(len(gnss.time_s), np.nan) if gnss.speed_mps is None else gnss.speed_mps
    values = (gnss.lat_deg, gnss.lon_deg, gnss.accuracy_m, speed_mps)
    return gnss.time_s, dict(zip(FIX_CHANNELS, values, strict=True))

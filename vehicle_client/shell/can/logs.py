"""CAN logs on disk: .blf, .asc, .log (candump) and .mf4, read as series of our channels."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING

import can

from roadgrip.errors import ConfigurationError, TraceError
from vehicle_client.shell.can.collector import SeriesCollector
from vehicle_client.shell.can.log_names import log_suffix

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from vehicle_client.recording.series import Series
    from vehicle_client.recording.signal_mapping import SignalSource
    from vehicle_client.shell.can.description import CanMapping

_NEWS_COUNT = 20_000
"""Frames between two calls of the watcher."""


def read_log(
    path: Path, mapping: CanMapping, *, watch: Callable[[int, float], None] = lambda _count, _time_s: None
) -> dict[str, Series]:
    """Return the mapped channels of a CAN log; time counts from its first mapped value.

    Frames that are not mapped are passed over, so that memory grows with the mapped values alone.

    Args:
        path: The log.
        mapping: What to read from it.
        watch: Told now and then how many frames are read, and the time stamp of the last.

    Raises:
        ConfigurationError: The file cannot be read.
        TraceError: It is no such log, a mapped message or signal does not come in it, or its clock was set back.
        ModuleNotFoundError: A log in .mf4 needs asammdf.
    """
    collector = SeriesCollector(mapping)
    try:
        if log_suffix(path) == ".mf4":
            from vehicle_client.shell.can.mf4 import add_mf4

            seen = add_mf4(path, collector, watch=watch)
        else:
            seen = _add_frames(frames_of_log(path), collector, watch=watch)
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror or error}") from error
    series = collector.series()
    _check_all_came(path, mapping, series, seen)
    return _from_zero(series)


def frames_of_log(path: Path) -> Iterator[can.Message]:
    """Yield the frames of a log of any kind, in the order of the file.

    Raises:
        ConfigurationError: The file cannot be read.
        TraceError: It is no such log.
    """
    try:
        with ExitStack() as stack:
            if log_suffix(path) == ".blf":
                # Opened here, since a reader that stumbles over the first bytes leaves its file open.
                reader: Iterable[can.Message] = can.BLFReader(stack.enter_context(path.open("rb")))
            else:
                reader = stack.enter_context(can.LogReader(path))
            yield from reader
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror or error}") from error
    except GeneratorExit:
        raise
    except Exception as error:  # readers of python-can raise whatever their parsing stumbles over
        raise TraceError(f"{path.name} is no CAN log that can be read: {type(error).__name__}: {error}") from error


def _add_frames(
    frames: Iterable[can.Message], collector: SeriesCollector, *, watch: Callable[[int, float], None]
) -> set[tuple[int, bool]]:
    """Return the identifiers that came."""
    seen: set[tuple[int, bool]] = set()
    count = 0
    for count, frame in enumerate(frames, start=1):
        if count % _NEWS_COUNT == 0:
            watch(count, frame.timestamp)
        if frame.is_error_frame or frame.is_remote_frame:
            continue
        frame_id, extended = frame.arbitration_id, frame.is_extended_id
        seen.add((frame_id, extended))
        channel = frame.channel
        collector.add(
            frame_id,
            frame.data,
            time_s=frame.timestamp,
            extended=extended,
            bus="" if channel is None else str(channel),
        )
    watch(count, 0.0)
    return seen


def _check_all_came(path: Path, mapping: CanMapping, series: Mapping[str, Series], seen: set[tuple[int, bool]]) -> None:
    silent = [source for source in mapping.mapping.sources if source.channel not in series]
    sensors = [source for source in silent if source.table not in _MAY_BE_SILENT]
    if not sensors:
        return
    if not seen:
        raise TraceError(f"{path.name} holds no frames")
    if not series:
        raise TraceError(
            f"{path.name}: none of its {len(seen)} kinds of frames is one of {mapping.mapping.place}; is it this car's "
            "log, and the right bus?"
        )
    source = sensors[0]
    raise TraceError(
        f"{path.name} holds no {source.signal} of {source.message}{_frame_text(source, mapping)}, which "
        f"[{source.table}] asks for{_bus_text(source)}"
    )


_MAY_BE_SILENT = {"abs", "tcs", "esc", "stability", "latitude", "longitude", "gnss_accuracy", "gnss_speed"}
"""A drive through a tunnel has no fixes, and some cars send a flag only when it changes."""


def _frame_text(source: SignalSource, mapping: CanMapping) -> str:
    ids = (layout.frame_id for by_bus in mapping.layouts.values() for layout in by_bus.values())
    names = (layout.message for by_bus in mapping.layouts.values() for layout in by_bus.values())
    return f" (identifier {dict(zip(names, ids, strict=True))[source.message]:#x})"


def _bus_text(source: SignalSource) -> str:
    return f" on bus {source.bus}" if source.bus else ""


def _from_zero(series: Mapping[str, Series]) -> dict[str, Series]:
    start_s = min((float(of.time_s.min()) for of in series.values() if len(of.time_s)), default=0.0)
    return {name: replace(of, time_s=of.time_s - start_s) for name, of in series.items()}

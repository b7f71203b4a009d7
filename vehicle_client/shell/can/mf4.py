"""CAN frames in .mf4 files (ASAM MDF 4 with bus logging), a block of records at a time."""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np

from roadgrip.errors import TraceError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from roadgrip.units import FloatArray
    from vehicle_client.recording.frames import Frames
    from vehicle_client.shell.can.collector import SeriesCollector

_BLOCK_COUNT = 65_536
_FRAME = "CAN_DataFrame"
_ID_MASK = 0x1FFFFFFF
_EXTENDED_BIT = 0x80000000
_SOURCE_BUS = 2
_BUS_CAN = 2
"""As MDF 4 numbers the kinds of sources and buses."""
_RECORD = np.dtype(
    [
        (f"{_FRAME}.BusChannel", "<u1"),
        (f"{_FRAME}.ID", "<u4"),
        (f"{_FRAME}.IDE", "<u1"),
        (f"{_FRAME}.DLC", "<u1"),
        (f"{_FRAME}.DataLength", "<u1"),
        (f"{_FRAME}.DataBytes", "(8,)u1"),
        (f"{_FRAME}.Dir", "<u1"),
        (f"{_FRAME}.EDL", "<u1"),
        (f"{_FRAME}.BRS", "<u1"),
        (f"{_FRAME}.ESI", "<u1"),
    ]
)


def add_mf4(path: Path, collector: SeriesCollector, *, watch: Callable[[int, float], None]) -> set[tuple[int, bool]]:
    """Give the frames of a file to a collector; return the identifiers that came.

    Raises:
        TraceError: It is no such file, or it holds no CAN frames.
        OSError: It cannot be read.
        ModuleNotFoundError: The extra `vehicle-files` is not installed.
    """
    import asammdf

    with path.open("rb"):  # what cannot be opened says so in the words of the system
        pass
    try:
        file: Any = asammdf.MDF(path)
    except OSError:
        raise
    except Exception as error:  # asammdf raises whatever its parsing stumbles over
        raise TraceError(f"{path.name} is no MDF file that can be read: {error}") from error
    with closing(file):
        groups = [
            (index, group.channel_group.cycles_nr)
            for index, group in enumerate(file.groups)
            if any(channel.name == _FRAME for channel in group.channels)
        ]
        if not groups:
            raise TraceError(f"{path.name} holds no CAN frames ({_FRAME}); was it recorded with bus logging?")
        seen: set[tuple[int, bool]] = set()
        count = 0
        for group, records_count in groups:
            for offset in range(0, records_count, _BLOCK_COUNT):
                block = file.get(_FRAME, group, record_offset=offset, record_count=_BLOCK_COUNT)
                seen |= _add_block(block.samples, block.timestamps, collector)
                count += len(block.timestamps)
                watch(count, float(block.timestamps[-1]))
        return seen


def _add_block(samples: Any, time_s: FloatArray, collector: SeriesCollector) -> set[tuple[int, bool]]:
    names = samples.dtype.names
    raw_ids = samples[f"{_FRAME}.ID"].astype(np.int64)
    frame_ids = raw_ids & _ID_MASK
    extended = raw_ids & _EXTENDED_BIT != 0
    if f"{_FRAME}.IDE" in names:
        extended |= samples[f"{_FRAME}.IDE"].astype(bool)
    channel = f"{_FRAME}.BusChannel"
    buses = samples[channel].astype(np.int64) if channel in names else np.full(len(time_s), -1)
    lengths = samples[f"{_FRAME}.DataLength"].astype(np.int64)
    payloads = samples[f"{_FRAME}.DataBytes"]
    kinds, kind_of = np.unique(np.column_stack([frame_ids, extended, buses, lengths]), axis=0, return_inverse=True)
    for kind, (frame_id, wide, bus, length) in enumerate(kinds.tolist()):
        if collector.layouts_of(frame_id, extended=bool(wide), bus="" if bus < 0 else str(bus)):
            of_kind = kind_of == kind
            collector.add_many(
                frame_id,
                np.ascontiguousarray(payloads[of_kind][:, :length]),
                time_s=time_s[of_kind].astype(np.float64),
                extended=bool(wide),
                bus="" if bus < 0 else str(bus),
            )
    return {(frame_id, bool(wide)) for frame_id, wide, _, _ in kinds.tolist()}


def write_mf4(path: Path, frames: Frames) -> None:
    """Write frames in the order of time.

    Raises:
        OSError: The file cannot be written.
        ModuleNotFoundError: The extra `vehicle-files` is not installed.
    """
    import asammdf

    records = np.zeros(len(frames.time_s), dtype=_RECORD)
    records[f"{_FRAME}.BusChannel"] = 1
    records[f"{_FRAME}.ID"] = frames.frame_id
    records[f"{_FRAME}.IDE"] = frames.extended
    records[f"{_FRAME}.DLC"] = frames.length_bytes
    records[f"{_FRAME}.DataLength"] = frames.length_bytes
    records[f"{_FRAME}.DataBytes"] = frames.payloads
    with closing(asammdf.MDF(version="4.10")) as file:
        source = asammdf.Source(name="CAN", path="CAN", comment="", source_type=_SOURCE_BUS, bus_type=_BUS_CAN)
        file.append(
            asammdf.Signal(name=_FRAME, samples=records, timestamps=frames.time_s, source=source), common_timebase=True
        )
        file.save(path, overwrite=True)

"""Gathers the mapped channels of a stream of frames; what is not mapped leaves no trace, whatever its amount."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import TraceError
from vehicle_client.recording.frames import values_of_frames
from vehicle_client.recording.series import Series

if TYPE_CHECKING:
    from roadgrip.units import FloatArray
    from vehicle_client.recording.bit_fields import PayloadArray
    from vehicle_client.recording.frames import FrameLayout
    from vehicle_client.shell.can.description import CanMapping

CHUNK_COUNT = 8192
"""Frames of one message that wait to be decoded together."""
DISORDER_LIMIT_S = 1.0
"""Loggers of several buses mix frames a little; a clock that goes back further has been set, or a log begins anew."""


@dataclass(slots=True)
class _Waiting:
    """Frames of one message and one length that are not decoded yet."""

    time_s: array[float] = field(default_factory=lambda: array("d"))
    data: bytearray = field(default_factory=bytearray)


class SeriesCollector:
    """Turns frames into series, in memory that grows with the mapped values alone (16 bytes each)."""

    def __init__(self, mapping: CanMapping) -> None:
        """Begin with nothing.

        Args:
            mapping: What to gather.
        """
        self._mapping = mapping
        self._known: dict[tuple[int, bool, str], tuple[FrameLayout, ...]] = {}
        self._waiting: dict[tuple[str, str, int], tuple[FrameLayout, _Waiting]] = {}
        self._latest_s: dict[tuple[int, bool, str], float] = {}
        self._times: dict[str, list[FloatArray]] = {}
        self._values: dict[str, list[FloatArray]] = {}
        self._mapped: Counter[str] = Counter()

    def layouts_of(self, frame_id: int, *, extended: bool, bus: str) -> tuple[FrameLayout, ...]:
        """Return what is to be read from such a frame; nothing from one that is not mapped."""
        key = (frame_id, extended, bus)
        found = self._known.get(key)
        if found is None:
            found = self._known[key] = self._mapping.layouts_of(frame_id, extended=extended, bus=bus)
        return found

    def add(self, frame_id: int, data: bytes | bytearray, *, time_s: float, extended: bool, bus: str) -> None:
        """Take a frame.

        Raises:
            TraceError: The clock of the recording was set back.
        """
        layouts = self.layouts_of(frame_id, extended=extended, bus=bus)
        if not layouts:
            return
        self._watch_clock((frame_id, extended, bus), first_s=time_s, last_s=time_s)
        for layout in layouts:
            key = (layout.message, layout.bus, len(data))
            entry = self._waiting.get(key)
            if entry is None:
                entry = self._waiting[key] = (layout, _Waiting())
            waiting = entry[1]
            waiting.time_s.append(time_s)
            waiting.data += data
            if len(waiting.time_s) >= CHUNK_COUNT:
                self._decode(key)

    def add_many(self, frame_id: int, payloads: PayloadArray, *, time_s: FloatArray, extended: bool, bus: str) -> None:
        """Take many frames of one identifier and one length, in the order of the file.

        Raises:
            TraceError: The clock of the recording was set back.
        """
        layouts = self.layouts_of(frame_id, extended=extended, bus=bus)
        if not layouts or not len(time_s):
            return
        self._watch_clock((frame_id, extended, bus), first_s=float(time_s[0]), last_s=float(time_s[-1]))
        if (np.diff(time_s) < -DISORDER_LIMIT_S).any():
            self._clock_was_set(float(time_s[int(np.argmin(np.diff(time_s)))]))
        for layout in layouts:
            self._keep(layout, time_s, payloads)

    def series(self) -> dict[str, Series]:
        """Return what was gathered, by channel, in the order of the frames, less each sensor's known delay."""
        for key in list(self._waiting):
            self._decode(key)
        return {
            channel: Series(np.concatenate(times), np.concatenate(self._values[channel]))
            for channel, times in self._times.items()
        }

    @property
    def mapped_count(self) -> int:
        """Frames that held something of ours."""
        return sum(self._mapped.values()) + sum(len(waiting.time_s) for _, waiting in self._waiting.values())

    def frames_count_of(self, message: str) -> int:
        """Return how many frames of a message came, before the last chunk."""
        return self._mapped[message]

    def _watch_clock(self, key: tuple[int, bool, str], *, first_s: float, last_s: float) -> None:
        latest_s = self._latest_s.get(key, first_s)
        if first_s < latest_s - DISORDER_LIMIT_S:
            self._clock_was_set(latest_s)
        self._latest_s[key] = max(last_s, latest_s)

    def _clock_was_set(self, at_s: float) -> None:
        raise TraceError(f"time runs backwards after {at_s:.3f} s of the log; cut it there")

    def _decode(self, key: tuple[str, str, int]) -> None:
        layout, waiting = self._waiting[key]
        if not waiting.time_s:
            return
        payloads = np.frombuffer(bytes(waiting.data), dtype=np.uint8).reshape(len(waiting.time_s), key[2])
        self._keep(layout, np.array(waiting.time_s), payloads)
        self._waiting[key] = (layout, _Waiting())

    def _keep(self, layout: FrameLayout, time_s: FloatArray, payloads: PayloadArray) -> None:
        self._mapped[layout.message] += len(time_s)
        for source, at_s, values in values_of_frames(layout, time_s, payloads):
            self._times.setdefault(source.channel, []).append(at_s - source.delay_s)
            self._values.setdefault(source.channel, []).append(values)

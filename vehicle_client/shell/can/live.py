"""A car's CAN bus as a source of channel values: what came since one last asked, in our units."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, NamedTuple, Self

import can

from vehicle_client.recording.frames import values_of_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import TracebackType

    from can import BusABC

    from vehicle_client.shell.can.description import CanMapping

QUEUE_LENGTH = 20_000
"""Values that wait at most: some ten seconds of a car's fifteen channels."""
_SILENCE_S = 0.2
"""How long the reader waits for a frame before it looks whether it shall end."""


class ChannelValue(NamedTuple):
    """One value of one channel.

    Attributes:
        channel: One of `SERIES_CHANNELS` of `vehicle_client.recording.channels`.
        time_s: When its frame arrived, on the machine's monotonic clock, less the sensor's known delay.
        value: In the channel's unit; NaN where the car says that it does not know.
    """

    channel: str
    time_s: float
    value: float


@dataclass(frozen=True, slots=True)
class CanCounts:
    """What a source has seen so far.

    Attributes:
        frames_count: Frames that are mapped.
        dropped_count: Values that the queue had no room for; the oldest go first.
        errors_count: Error frames, and failures of the bus.
        failure: What the bus last complained of; empty if nothing.
    """

    frames_count: int = 0
    dropped_count: int = 0
    errors_count: int = 0
    failure: str = ""


class CanSource:
    """Reads a bus in a thread of its own, and hands out what came; a context manager.

    Frames are stamped when they are taken from the adapter: adapters count in clocks of their own, some from their
    start, some since 1970, and the machine's monotonic clock is the one that everything else here goes by.
    """

    def __init__(
        self,
        bus: BusABC,
        mapping: CanMapping,
        *,
        now_s: Callable[[], float] = time.monotonic,
        queue_length: int = QUEUE_LENGTH,
    ) -> None:
        """Start reading.

        Args:
            bus: Open; whoever opened it shuts it down, after this source is closed.
            mapping: What to read from it.
            now_s: The clock.
            queue_length: Values that wait at most.
        """
        self._bus = bus
        self._mapping = mapping
        self._now_s = now_s
        self._queue: deque[ChannelValue] = deque(maxlen=queue_length)
        self._lock = Lock()
        self._counts = CanCounts()
        self._closing = Event()
        self._thread = Thread(target=self._read, name="can-source", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop reading; what came before can still be polled."""
        self._closing.set()
        self._thread.join(timeout=10.0 * _SILENCE_S)

    def poll(self) -> list[ChannelValue]:
        """Return what came since the last poll, in the order of arrival; does not wait."""
        with self._lock:
            came = list(self._queue)
            self._queue.clear()
        return came

    @property
    def counts(self) -> CanCounts:
        """What the source has seen so far."""
        with self._lock:
            return self._counts

    @property
    def alive(self) -> bool:
        """Whether it still reads; a bus that breaks ends it, and `counts.failure` says why."""
        return self._thread.is_alive()

    def _read(self) -> None:
        while not self._closing.is_set():
            try:
                frame = self._bus.recv(timeout=_SILENCE_S)
            except (can.CanError, OSError, ValueError) as error:
                if not self._closing.is_set():
                    self._count(errors_count=1, failure=str(error))
                return
            if frame is None:
                continue
            if frame.is_error_frame:
                self._count(errors_count=1)
            elif not frame.is_remote_frame:
                self._take(frame)

    def _take(self, frame: can.Message) -> None:
        layouts = self._mapping.layouts_of(
            frame.arbitration_id, extended=frame.is_extended_id, bus=str(frame.channel or "")
        )
        if not layouts:
            return
        arrived_s = self._now_s()
        self._put(
            ChannelValue(source.channel, arrived_s - source.delay_s, value)
            for layout in layouts
            for source, value in values_of_frame(layout, bytes(frame.data))
        )

    def _put(self, values: Iterable[ChannelValue]) -> None:
        with self._lock:
            dropped = 0
            for value in values:
                dropped += len(self._queue) == self._queue.maxlen
                self._queue.append(value)
            counts = self._counts
            self._counts = CanCounts(
                counts.frames_count + 1, counts.dropped_count + dropped, counts.errors_count, counts.failure
            )

    def _count(self, *, errors_count: int, failure: str = "") -> None:
        with self._lock:
            counts = self._counts
            self._counts = CanCounts(
                counts.frames_count,
                counts.dropped_count,
                counts.errors_count + errors_count,
                failure or counts.failure,
            )

"""A car's CAN bus as a source of channel values: what came since one last asked, in our units.

A bus that breaks (an adapter unplugged, an interface that goes down) is opened again, with pauses that grow.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from dataclasses import dataclass, replace
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, NamedTuple, Self

import can

from roadgrip.errors import RoadgripError
from vehicle_client.recording.frames import values_of_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from types import TracebackType

    from can import BusABC

    from vehicle_client.shell.can.description import CanMapping

QUEUE_LENGTH = 20_000
"""Values that wait at most: some ten seconds of a car's fifteen channels."""
REOPEN_S = 0.5
"""Pause before a broken bus is opened again; twice as long each time that fails..."""
REOPEN_LIMIT_S = 30.0
"""...up to this."""
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


@dataclass(slots=True)
class CanCounts:
    """What a source has seen so far.

    Attributes:
        frames_count: Frames that are mapped.
        dropped_count: Values that the queue had no room for; the oldest go first.
        errors_count: Error frames, and failures of the bus.
        reopened_count: Times a broken bus was opened again.
        failure: What the bus last complained of; empty if nothing.
    """

    frames_count: int = 0
    dropped_count: int = 0
    errors_count: int = 0
    reopened_count: int = 0
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
        reopen: Callable[[], BusABC] | None = None,
        now_s: Callable[[], float] = time.monotonic,
        queue_length: int = QUEUE_LENGTH,
        reopen_s: float = REOPEN_S,
    ) -> None:
        """Start reading.

        Args:
            bus: Open; whoever opened it shuts it down, after this source is closed.
            mapping: What to read from it.
            reopen: Opens the bus again when it broke; without it that is the end. What it opens is shut down here.
            now_s: The clock.
            queue_length: Values that wait at most.
            reopen_s: First pause before it is opened again.
        """
        self._bus = bus
        self._mapping = mapping
        self._reopen = reopen
        self._reopen_s = self._pause_s = reopen_s
        self._broken = Event()
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
            return replace(self._counts)

    @property
    def alive(self) -> bool:
        """Whether it reads, or tries to open its bus again; `counts.failure` says what is wrong."""
        return self._thread.is_alive()

    @property
    def broken(self) -> bool:
        """Whether the bus is broken now."""
        return self._broken.is_set() or not self.alive

    def _read(self) -> None:
        bus: BusABC | None = self._bus
        while bus is not None:
            self._listen(bus)
            if bus is not self._bus or not self._closing.is_set():
                # A broken adapter must go before it can be opened again; its owner's own shutdown then does nothing.
                _shut_down(bus)
            bus = None if self._reopen is None else self._opened_again(self._reopen)

    def _listen(self, bus: BusABC) -> None:
        """Read until the bus breaks or the source is closed."""
        while not self._closing.is_set():
            try:
                frame = bus.recv(timeout=_SILENCE_S)
            except Exception as error:  # noqa: BLE001 - adapters raise what they like, and a car drives on
                if not self._closing.is_set():
                    self._count(errors_count=1, failure=str(error) or type(error).__name__)
                return
            if self._broken.is_set():
                # Some buses can be opened while they are down, so only now is it known to be whole.
                self._broken.clear()
                self._pause_s = self._reopen_s
                self._count(reopened_count=1)
            if frame is None:
                continue
            if frame.is_error_frame:
                self._count(errors_count=1)
            elif not frame.is_remote_frame:
                self._take(frame)

    def _opened_again(self, reopen: Callable[[], BusABC]) -> BusABC | None:
        """Return the bus, or None if the source is closed before it can be opened."""
        self._broken.set()
        while not self._closing.wait(self._pause_s):
            self._pause_s = min(REOPEN_LIMIT_S, 2.0 * self._pause_s)
            try:
                return reopen()
            except (RoadgripError, can.CanError, OSError) as error:
                self._count(errors_count=1, failure=str(error))
        return None

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
            self._counts.frames_count += 1
            self._counts.dropped_count += dropped

    def _count(self, *, errors_count: int = 0, reopened_count: int = 0, failure: str = "") -> None:
        with self._lock:
            self._counts.errors_count += errors_count
            self._counts.reopened_count += reopened_count
            self._counts.failure = failure or self._counts.failure


def _shut_down(bus: BusABC) -> None:
    with contextlib.suppress(Exception):
        bus.shutdown()

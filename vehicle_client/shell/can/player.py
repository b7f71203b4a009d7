"""Plays a CAN log onto a bus as if it happened now: a car on the desk."""

from __future__ import annotations

import time
from threading import Event
from typing import TYPE_CHECKING

import can

from vehicle_client.shell.can.logs import frames_of_log

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from can import BusABC

_NAP_S = 0.002
"""Frames that are due within it are sent at once: no sleep is shorter in truth."""


def play_log(
    path: Path,
    bus: BusABC,
    *,
    speedup_ratio: float = 1.0,
    stopped: Event | None = None,
    now_s: Callable[[], float] = time.monotonic,
) -> int:
    """Return how many frames of a log were sent on a bus, when all are or somebody wants no more.

    Args:
        path: The log.
        bus: Open.
        speedup_ratio: Seconds of the log a second.
        stopped: Set by whoever wants no more.
        now_s: The clock.

    Raises:
        ConfigurationError: The log cannot be read.
        TraceError: It is no such log.
        can.CanError: The bus is gone.
    """
    stopped = Event() if stopped is None else stopped
    start_s: float | None = None
    first_s, count = 0.0, 0
    for frame in frames_of_log(path):
        if start_s is None:
            start_s, first_s = now_s(), frame.timestamp
        ahead_s = (frame.timestamp - first_s) / speedup_ratio - (now_s() - start_s)
        if (ahead_s > _NAP_S and stopped.wait(ahead_s)) or stopped.is_set():
            break
        if frame.is_error_frame:
            continue
        bus.send(
            can.Message(
                arbitration_id=frame.arbitration_id,
                is_extended_id=frame.is_extended_id,
                is_fd=frame.is_fd,
                data=frame.data,
            )
        )
        count += 1
    return count

"""Carries frames between an exchange that decides and an uplink that sends."""

from __future__ import annotations

import asyncio
import time
from math import inf
from typing import TYPE_CHECKING, Protocol

from vehicle_client.shell.exchange import Exchange, Stage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from roadgrip.records import KinematicSummary
    from vehicle_client.shell.uplink import Uplink


class Clock(Protocol):
    """Seconds that never run backwards."""

    def now_s(self) -> float:
        """Return the time."""
        ...

    def wall_s(self, duration_s: float) -> float:
        """Return how long a duration on this clock takes on the wall."""
        ...


class SpedUpClock:
    """The machine's monotonic clock, so many times as fast; starts at zero."""

    def __init__(self, speedup_ratio: float = 1.0) -> None:
        """Start."""
        self._speedup_ratio = speedup_ratio
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """Return the time since the start."""
        return (time.monotonic() - self._start_s) * self._speedup_ratio

    def wall_s(self, duration_s: float) -> float:
        """Return how long a duration on this clock takes on the wall."""
        return duration_s / self._speedup_ratio


async def sleep_until(at_s: float, clock: Clock) -> None:
    """Return when the clock shows `at_s`, or at once if it is past."""
    await asyncio.sleep(max(0.0, clock.wall_s(at_s - clock.now_s())))


async def send_all(frames: Iterable[bytes], uplink: Uplink) -> None:
    """Send frames in order."""
    for frame in frames:
        await uplink.send(frame)


async def arrive(exchange: Exchange, uplink: Uplink, clock: Clock, *, watch: Callable[[], None] | None = None) -> None:
    """Announce the vehicle, and return when it has what it asked for or asks no more.

    Args:
        exchange: Of the passage.
        uplink: Carries it.
        clock: Of the exchange.
        watch: Called whenever a frame was taken, so that advice is shown when it comes and not when all has come.
    """
    await send_all(exchange.begin(now_s=clock.now_s()), uplink)
    while exchange.stage is Stage.ARRIVING:
        await converse(exchange, uplink, clock, until_s=exchange.wake_at_s, watch=watch)


async def report(
    exchange: Exchange, uplink: Uplink, clock: Clock, summary: KinematicSummary, *, map_version: str, left_at_s: float
) -> None:
    """Send a summary, and return when it has been answered or the vehicle tries no more.

    Args:
        exchange: Of the passage.
        uplink: Carries it.
        clock: Of the exchange.
        summary: What the pipeline made of the drive.
        map_version: The map it was cut with.
        left_at_s: When the vehicle left the section, on the clock.
    """
    frames = exchange.report(summary, map_version=map_version, left_at_s=left_at_s, now_s=clock.now_s())
    await send_all(frames, uplink)
    await converse(exchange, uplink, clock)


async def converse(
    exchange: Exchange,
    uplink: Uplink,
    clock: Clock,
    *,
    until_s: float = inf,
    watch: Callable[[], None] | None = None,
) -> None:
    """Keep an exchange going until it has ended or the clock shows `until_s`.

    A vehicle that has all it asked for keeps listening, so that an answer that comes late is not lost; without
    `until_s` it would listen for ever, and this returns instead.
    """
    while exchange.stage is not Stage.ENDED:
        due_s = min(exchange.wake_at_s, until_s)
        if due_s == inf:
            return
        wait_s = clock.wall_s(due_s - clock.now_s())
        if wait_s > 0.0:
            try:
                frame = await asyncio.wait_for(uplink.receive(), timeout=wait_s)
            except TimeoutError:
                pass
            else:
                exchange.receive(frame, now_s=clock.now_s())
                if watch is not None:
                    watch()
                continue
        now_s = clock.now_s()
        await send_all(exchange.tick(now_s=now_s), uplink)
        if now_s >= until_s:
            return

"""Ways to break a unit on purpose: a scenario that does not notice the one made for it proves nothing.

Each is put into a process of its own before the unit is made, and nowhere else.
"""

from __future__ import annotations

import asyncio
import importlib
import sqlite3
import time
import zlib
from calendar import timegm
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from roadgrip.errors import StoreError
from roadgrip.protocol import HEADER_BYTES, Kind
from rsu_app.ports import PassageEntry, StoredEstimate

Answers = list[StoredEstimate | None]


def break_unit(name: str) -> None:
    """Break what runs in this process; an empty name leaves it as it is."""
    if name:
        SABOTAGES[name]()


def _replace(place: str, name: str, made_from: Callable[[Any], Any]) -> None:
    """Put something else in the place of a function, a method or a number.

    Args:
        place: Module, and class after a colon.
        name: Of what is replaced. It must be there, or the sabotage would pass for a unit that stands everything.
        made_from: Gives what comes into its place, from what was there.
    """
    module, _, kind = place.partition(":")
    owner = importlib.import_module(module)
    target = getattr(owner, kind) if kind else owner
    setattr(target, name, made_from(getattr(target, name)))


_STORE = "rsu_app.adapters.store"


def _pragma(setting: str) -> Callable[[], None]:
    def more(before: Callable[[sqlite3.Connection], None]) -> Callable[[sqlite3.Connection], None]:
        def apply(database: sqlite3.Connection) -> None:
            before(database)
            database.execute(f"PRAGMA {setting}")

        return apply

    return lambda: _replace(f"{_STORE}.connection", "apply_writer_pragmas", more)


def _read_the_log_back() -> None:
    _replace(f"{_STORE}.connection", "make_log_last", lambda _: lambda _: None)


def _work_the_log_in() -> None:
    for place in ("connection", "recovery"):
        _replace(f"{_STORE}.{place}", "log_left_alone", lambda _: lambda _path: nullcontext())


def _acknowledge_first() -> None:
    waiting: set[asyncio.Task[Any]] = set()

    def hasty(careful: Callable[..., Any]) -> Callable[..., Any]:
        async def append(self: Any, entries: Sequence[PassageEntry]) -> Answers:
            task = asyncio.ensure_future(careful(self, entries))
            waiting.add(task)
            task.add_done_callback(waiting.discard)
            return [None for _ in entries]

        return append

    _replace(f"{_STORE}.sqlite:SqlitePassageStore", "append", hasty)


def _call_it_stored() -> None:
    def shameless(careful: Callable[..., Any]) -> Callable[..., Any]:
        async def append(self: Any, entries: Sequence[PassageEntry]) -> Answers:
            try:
                return list(await careful(self, entries))
            except StoreError:
                return [None for _ in entries]

        return append

    _replace(f"{_STORE}.sqlite:SqlitePassageStore", "append", shameless)


def _restore_nothing() -> None:
    async def restore(_: object, *, within_s: float) -> int:
        return 0

    _replace("rsu_app.usecases:RoadSideUnit", "restore", lambda _: restore)


def _answer_nobody_at_the_end() -> None:
    def hasty(careful: Callable[..., Any]) -> Callable[..., Any]:
        async def close(self: Any) -> None:
            self._transport.close()
            await careful(self)

        return close

    _replace("rsu_app.adapters.udp.endpoint:FrameEndpoint", "close", hasty)


def _be_polite() -> None:
    from rsu_app.usecases.readiness import Check

    async def store_check(_: object) -> Check:
        return Check("store", ok=True, detail="")

    _replace("rsu_app.usecases.unit", "store_check", lambda _: store_check)


def _never_try_again() -> None:
    _replace(f"{_STORE}.standby", "RETRY_PERIOD_S", lambda _: 1e9)


def _take_unreadable_for_damaged() -> None:
    def hasty(careful: Callable[[Path], str | None]) -> Callable[[Path], str | None]:
        def damage(database_path: Path) -> str | None:
            try:
                return careful(database_path)
            except StoreError as error:
                return str(error)

        return damage

    _replace(f"{_STORE}.sqlite", "damage", hasty)
    _replace(f"{_STORE}.sqlite", "keep_damaged_log", lambda _: lambda _, now_unix_s: None)


def _look_for_no_damage() -> None:
    _replace(f"{_STORE}.sqlite", "damage", lambda _: lambda _: None)
    _replace(f"{_STORE}.sqlite", "integrity_problems", lambda _: lambda _: [])
    _replace(f"{_STORE}.sqlite", "keep_damaged_log", lambda _: lambda _, now_unix_s: None)


def _call_every_log_damaged() -> None:
    _replace(f"{_STORE}.recovery", "log_problem", lambda _: lambda _, read_count: "it is there")


def _go_by_the_wall_clock() -> None:
    _replace("rsu_app.adapters.clocks:SystemClock", "monotonic_s", lambda _: lambda _: time.time())


def _believe_every_clock() -> None:
    from rsu_app.usecases.readiness import Check

    _replace("rsu_app.usecases.readiness:ClockWatch", "check", lambda _: lambda _: Check("clock", ok=True, detail=""))
    _replace("rsu_app.usecases.readiness:ClockWatch", "plausible", lambda _: True)


def _call_a_second_a_step() -> None:
    _replace("rsu_app.usecases.readiness", "STEP_TOLERANCE_S", lambda _: 0.5)


def _keep_local_time() -> None:
    _replace("rsu_app.adapters.clocks:SystemClock", "unix_s", lambda _: lambda _: float(timegm(time.localtime())))


def _wait_for_ever() -> None:
    def endless(limits_of: Callable[..., Any]) -> Callable[..., Any]:
        return lambda **known: limits_of(**known, header_timeout_s=1e6, idle_timeout_s=10**6, write_timeout_s=1e6)

    _replace("rsu_app.service", "ConnectionLimits", endless)
    defaults = importlib.import_module("rsu_app.adapters.http.guards").BodyGuard.__init__.__kwdefaults__
    defaults["body_timeout_s"] = 1e6


def _hold_every_piece() -> None:
    _replace("roadgrip.frames", "FRAMES_LIMIT_COUNT", lambda _: dict.fromkeys(Kind, 5))
    _replace("rsu_app.gateway", "ASSEMBLY_LIMIT_COUNT", lambda _: 10**9)
    _replace("rsu_app.gateway", "ASSEMBLY_LIMIT_BYTES", lambda _: 10**12)


def _look_at_no_sums() -> None:
    def careless(careful: Callable[[bytes], Any]) -> Callable[[bytes], Any]:
        return lambda datagram: careful(summed_again(bytearray(datagram)))

    _replace("rsu_app.gateway", "parse_frame", careless)


def summed_again(frame: bytearray) -> bytes:
    """Return a frame whose checksums are those of what it holds; what is shorter than its header as it is."""
    if len(frame) >= HEADER_BYTES:
        if frame[16:18] == b"\0\1":
            frame[20:24] = zlib.crc32(frame[HEADER_BYTES:]).to_bytes(4, "big")
        frame[24:28] = zlib.crc32(frame[HEADER_BYTES:], zlib.crc32(frame[:24])).to_bytes(4, "big")
    return bytes(frame)


SABOTAGES: dict[str, Callable[[], None]] = {
    # Not broken, only busier than by default.
    "small log": _pragma("wal_autocheckpoint = 40"),
    "synchronous = OFF": _pragma("synchronous = OFF"),
    "synchronous = NORMAL": _pragma("synchronous = NORMAL"),
    "the log is read back after a failure": _read_the_log_back,
    "the log is worked in as it is": _work_the_log_in,
    "acknowledge before the commit": _acknowledge_first,
    "a failed write is called stored": _call_it_stored,
    "the window is not restored": _restore_nothing,
    "nobody is answered at the end": _answer_nobody_at_the_end,
    "readiness is polite": _be_polite,
    "no second attempt": _never_try_again,
    "what cannot be read is called damaged": _take_unreadable_for_damaged,
    "damage is not looked for": _look_for_no_damage,
    "every log is called damaged": _call_every_log_damaged,
    "the window goes by the wall clock": _go_by_the_wall_clock,
    "every clock is believed": _believe_every_clock,
    "a second is a step": _call_a_second_a_step,
    "times are local": _keep_local_time,
    "patience has no end": _wait_for_ever,
    "incomplete messages have no limit": _hold_every_piece,
    "sums are not looked at": _look_at_no_sums,
}

"""The conversation of one pass: from the announcement to the receipt, or to the spool."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar

from roadgrip.errors import ConfigurationError
from roadgrip.records import PASSAGE_ID_BYTES, KinematicSummary, Reason
from vehicle_client.shell.conversation import Clock, arrive, converse, report, send_all
from vehicle_client.shell.exchange import Exchange, ExchangeRecord, FrameCodec, Stage
from vehicle_client.shell.spool import Spool, SpooledSummary, SpoolError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from roadgrip.records import Advisory, AdvisoryNotice
    from roadgrip.section import RoadSection
    from vehicle_client.shell.uplink import UnitAddress, Uplink

_T = TypeVar("_T")

LISTEN_S = 5.0
"""How long is listened at a stretch while the car drives the section."""
LOOK_S = 0.5
"""How often is looked whether a unit has come into reach."""


@dataclass(frozen=True, slots=True)
class Report:
    """The pass gave a summary.

    Attributes:
        summary: What is sent.
        section: The map it was cut with.
        left_at_s: When the car left the section, on the client's clock.
    """

    summary: KinematicSummary
    section: RoadSection
    left_at_s: float


@dataclass(frozen=True, slots=True)
class Nothing:
    """The pass gave no summary; None means that there was no map."""

    why: Reason | None


Verdict: TypeAlias = Report | Nothing


class Surround(Protocol):
    """What a conversation needs from the client around it."""

    def address_of(self, section_id: str) -> UnitAddress | None:
        """Return where a unit that serves the section is in reach now."""
        ...

    def open_uplink(self, address: UnitAddress) -> contextlib.AbstractAsyncContextManager[Uplink]:
        """Return a way to a unit."""
        ...

    def known_section(self, section_id: str) -> RoadSection | None:
        """Return the map from an earlier pass."""
        ...

    def take_map(self, section: RoadSection) -> None:
        """Take a map that came."""
        ...

    def take_advice(self, section_id: str, advisory: Advisory) -> None:
        """Take advice that came."""
        ...

    def take_no_map(self, section_id: str) -> None:
        """Take that the unit sent no map."""
        ...


class Codecs(Protocol):
    """Makes the codecs of exchanges; `vehicle_client.shell.keys.Keys`."""

    def codecs_for(self, section_id: str, /) -> Callable[[bytes], FrameCodec]:
        """Return what makes the codec of an exchange about a section from a passage's id."""
        ...


@dataclass(frozen=True, slots=True)
class Tools:
    """What conversations work with.

    Attributes:
        keys: What the vehicle signs with and believes.
        clock: Of exchanges and ages.
        clock_id: Its name.
        spool: Keeps what is not acknowledged; touched only by `worker`.
        worker: The one thread for what takes long.
    """

    keys: Codecs
    clock: Clock
    clock_id: str
    spool: Spool
    worker: Executor

    async def work(self, task: Callable[..., _T], *args: object) -> _T:
        """Return what a function returns that the loop must not wait for."""
        return await asyncio.get_running_loop().run_in_executor(self.worker, task, *args)

    @contextlib.asynccontextmanager
    async def delivering(self, passage_id: bytes) -> AsyncIterator[bool]:
        """Hold on to a summary in the spool, and yield whether it is there."""
        held = self.spool.delivering(passage_id)
        is_there = await self.work(held.__enter__)
        try:
            yield is_there
        finally:
            await self.work(held.__exit__, None, None, None)


class Attendance:
    """One pass's conversation; `run` is its life, the rest tells it what the car did."""

    def __init__(self, section_id: str, surround: Surround, tools: Tools) -> None:
        """Prepare; needs a running event loop."""
        self.section_id = section_id
        self._surround = surround
        self._tools = tools
        self._passage_id = secrets.token_bytes(PASSAGE_ID_BYTES)
        self._exchange: Exchange | None = None
        self._verdict: asyncio.Future[Verdict] = asyncio.get_running_loop().create_future()
        self._seen_map = ""
        self._seen_notice: AdvisoryNotice | None = None
        self._advice_ends_s = inf
        self.via = "none"

    @property
    def section(self) -> RoadSection | None:
        """The map to cut a summary with; None while a newer one is awaited."""
        if self._exchange is not None and self._exchange.stage is not Stage.ENDED:
            return self._exchange.section
        return self._surround.known_section(self.section_id)

    @property
    def advisory(self) -> Advisory | None:
        """The advice that came."""
        return None if self._seen_notice is None else self._seen_notice.advisory

    def settle(self, verdict: Verdict) -> None:
        """Say what came of the pass; the first word counts."""
        if not self._verdict.done():
            self._verdict.set_result(verdict)

    async def run(self) -> ExchangeRecord:
        """Return how the conversation went."""
        address = await self._way()
        if address is None:
            return await self._without_unit()
        async with contextlib.AsyncExitStack() as stack:
            try:
                uplink = await stack.enter_async_context(self._surround.open_uplink(address))
            except ConfigurationError:
                # No network, or no socket left: for this pass as if no unit had been heard.
                return await self._without_unit()
            self.via = address.scheme
            return await self._talk(uplink)

    async def _way(self) -> UnitAddress | None:
        """Return a unit's address as soon as one is in reach, or None if the pass is over before."""
        while not self._verdict.done():
            address = self._surround.address_of(self.section_id)
            if address is not None:
                return address
            await asyncio.wait({self._verdict}, timeout=LOOK_S)
        return self._surround.address_of(self.section_id)

    async def _without_unit(self) -> ExchangeRecord:
        exchange = self._open_exchange()
        verdict = await self._verdict
        if isinstance(verdict, Report):
            await self._tools.work(self._tools.spool.keep, self._entry(verdict, frames_spent_count=0))
        else:
            _withhold(exchange, verdict)
        return exchange.record()

    async def _talk(self, uplink: Uplink) -> ExchangeRecord:
        exchange = self._exchange = self._open_exchange()
        clock = self._tools.clock
        await self._until_verdict(arrive(exchange, uplink, clock, watch=self._look))
        if exchange.section is None:
            self._surround.take_no_map(self.section_id)
        while not self._verdict.done() and exchange.stage is not Stage.ENDED:
            await self._until_verdict(self._listen(exchange, uplink))
        verdict = await self._verdict
        if isinstance(verdict, Nothing):
            _withhold(exchange, verdict)
        elif exchange.stage is Stage.ENDED:
            # This unit refused the announcement; another one may want the summary.
            entry = self._entry(verdict, frames_spent_count=exchange.frames_sent_count)
            await self._tools.work(self._tools.spool.keep, entry)
        else:
            await self._send(exchange, uplink, verdict)
        return exchange.record()

    async def _listen(self, exchange: Exchange, uplink: Uplink) -> None:
        """Listen for a stretch; advice that has run out is asked for again while its unit is in reach."""
        clock = self._tools.clock
        now_s = clock.now_s()
        if now_s >= self._advice_ends_s and self._surround.address_of(self.section_id) is not None:
            self._advice_ends_s = inf
            await send_all(exchange.renew(now_s=now_s), uplink)
        until_s = min(now_s + LISTEN_S, max(now_s + LOOK_S, self._advice_ends_s))
        await converse(exchange, uplink, clock, until_s=until_s, watch=self._look)

    async def _send(self, exchange: Exchange, uplink: Uplink, verdict: Report) -> None:
        """Send a summary; it is in the spool first, so that a car switched off now still delivers it once."""
        entry = self._entry(verdict, frames_spent_count=exchange.reserve())
        try:
            await self._tools.work(self._tools.spool.keep, entry)
        except SpoolError:
            # A full disk must not silence a car that has a unit before it.
            await report(
                exchange,
                uplink,
                self._tools.clock,
                verdict.summary,
                map_version=verdict.section.version,
                left_at_s=verdict.left_at_s,
            )
            if exchange.record().may_spool:
                raise
            return
        await send_spooled(
            entry, exchange, uplink, self._tools, map_version=verdict.section.version, left_at_s=verdict.left_at_s
        )

    def _open_exchange(self) -> Exchange:
        return Exchange(
            passage_id=self._passage_id,
            section_id=self.section_id,
            codec=self._tools.keys.codecs_for(self.section_id)(self._passage_id),
            known_section=self._surround.known_section(self.section_id),
        )

    def _entry(self, verdict: Report, *, frames_spent_count: int) -> SpooledSummary:
        return SpooledSummary(
            passage_id=self._passage_id,
            section_id=self.section_id,
            map_version=verdict.section.version,
            summary=verdict.summary,
            left_at_s=verdict.left_at_s,
            clock_id=self._tools.clock_id,
            frames_spent_count=frames_spent_count,
        )

    def _look(self) -> None:
        """Pass on what the last frame brought."""
        exchange = self._exchange
        if exchange is None:
            return
        section, notice = exchange.section, exchange.notice
        if section is not None and section.version != self._seen_map:
            self._seen_map = section.version
            self._surround.take_map(section)
        if notice is not None and notice is not self._seen_notice:
            self._seen_notice = notice
            self._advice_ends_s = self._tools.clock.now_s() + notice.advisory.valid_for_s
            self._surround.take_advice(self.section_id, notice.advisory)

    async def _until_verdict(self, talk: Coroutine[None, None, None]) -> None:
        """Let a talk go on until it ends or the car knows what came of the pass."""
        task = asyncio.ensure_future(talk)
        try:
            either: set[asyncio.Future[Any]] = {task, self._verdict}
            await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                await task
        finally:
            await _cancelled(task)


async def send_spooled(
    entry: SpooledSummary, exchange: Exchange, uplink: Uplink, tools: Tools, *, map_version: str, left_at_s: float
) -> bool:
    """Send a summary that lies in the spool, and leave there what the answer makes of it, also when cancelled.

    The frames that it may cost are written down before the first leaves: whoever is killed meanwhile has spent them.

    Returns:
        Whether it was there to be sent: False if somebody else is just sending it.
    """
    async with tools.delivering(entry.passage_id) as is_there:
        if not is_there:
            return False
        reserved = replace(entry, frames_spent_count=exchange.reserve())
        if reserved != entry:
            await tools.work(tools.spool.keep, reserved)
        try:
            await report(exchange, uplink, tools.clock, entry.summary, map_version=map_version, left_at_s=left_at_s)
        finally:
            record = exchange.record()
            if record.may_spool:
                kept = replace(entry, frames_spent_count=record.frames_sent_count)
                await tools.work(tools.spool.keep, kept)
            else:
                await tools.work(tools.spool.drop, entry.passage_id)
    return True


def _withhold(exchange: Exchange, verdict: Nothing) -> None:
    """End an exchange without a summary."""
    if exchange.stage is not Stage.ENDED:
        exchange.withhold(verdict.why if verdict.why is not None else Reason.PASSAGE_ABORTED)


async def _cancelled(task: asyncio.Future[None]) -> None:
    if not task.done():
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task

"""A fleet: vehicles come to a section, drive it in the simulator, and talk to a road side unit in accelerated time.

Drives and summaries are computed in worker threads (the compiled simulator releases the interpreter's lock), so that
the event loop answers frames meanwhile. The fleet's clock and the unit's run at the same speed-up; then an hour of
the unit's window is an hour of traffic.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeAlias, TypeVar

import numpy as np

from roadgrip.errors import ConfigurationError
from roadgrip.records import PASSAGE_ID_BYTES, VEHICLE_FRAME_BUDGET, KinematicSummary, Reason, Rejected
from vehicle_client.shell.conversation import Clock, SpedUpClock, converse, report, send_all, sleep_until
from vehicle_client.shell.exchange import Ending, Exchange, ExchangeRecord, FrameCodec, Stage
from vehicle_client.shell.fleet_events import (
    FleetReady,
    FleetReport,
    PassageEnded,
    VehicleAdvised,
    VehicleEntered,
    Watch,
)
from vehicle_client.shell.patience import Patience
from vehicle_client.shell.spool import Spool, SpooledSummary
from vehicle_client.shell.uplink import CLEAN_AIR, AirCounts, AirFaults, LossyUplink, Uplink
from vehicle_client.simulator.plan import PassagePlan, SensorGrade, draw_plan

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.simulator.drive import Drive

_T = TypeVar("_T")

AHEAD_COUNT = 4
"""Drives simulated ahead of their arrival, so that a burst of arrivals is not late."""
REPLY_WALL_S = 0.15
"""How long a unit on the same machine may take to answer, however fast the clock runs."""
SPOOL_ROUND_S = 300.0
"""How often waiting summaries are tried again, on the fleet's clock."""
SPOOL_LAST_ROUNDS_COUNT = 3
SPOOL_TRIES_COUNT = 2


@dataclass(frozen=True, slots=True)
class FrictionChange:
    """The road changes.

    Attributes:
        base_friction_mu: What it offers a new tyre from then on.
        from_frac: When, as the share of the fleet that has come before.
    """

    base_friction_mu: float
    from_frac: float


def parse_friction_change(text: str) -> FrictionChange:
    """Return the change that a text such as `0.25@0.5` means: friction 0.25 after half of the vehicles.

    Raises:
        ConfigurationError: It is not such a text.
    """
    value, _, share = text.partition("@")
    try:
        change = FrictionChange(float(value), float(share))
    except ValueError:
        change = FrictionChange(np.nan, np.nan)
    if not (0.0 < change.base_friction_mu <= 1.5 and 0.0 <= change.from_frac <= 1.0):
        raise ConfigurationError(f"{text!r} is no change of friction; 0.25@0.5 means friction 0.25 from half way on")
    return change


@dataclass(frozen=True, slots=True)
class FleetPlan:
    """What a fleet shall do.

    Attributes:
        section: The road that is driven. Vehicles learn its map from the unit all the same.
        vehicles_count: How many come.
        base_friction_mu: What the road offers a new tyre at first.
        changes: How that changes, in any order.
        arrivals_per_hour: How many come per hour of the fleet's clock.
        regular: Whether they come at equal distances; otherwise at random (Poisson).
        speedup_ratio: Fleet seconds per second on the wall.
        grade: Which sensors the vehicles carry.
        faults: How bad the air is.
        seed: Of arrivals, drivers, tyres, drives and air.
    """

    section: RoadSection
    vehicles_count: int
    base_friction_mu: float
    changes: tuple[FrictionChange, ...] = ()
    arrivals_per_hour: float = 100.0
    regular: bool = False
    speedup_ratio: float = 60.0
    grade: SensorGrade = SensorGrade.AUTOMOTIVE
    faults: AirFaults = CLEAN_AIR
    seed: int = 0

    def base_friction_of(self, number: int) -> float:
        """Return what the road offers a new tyre when vehicle `number` comes."""
        past = [c for c in self.changes if number >= c.from_frac * self.vehicles_count]
        return max(past, key=lambda c: c.from_frac).base_friction_mu if past else self.base_friction_mu


@dataclass(frozen=True, slots=True)
class Visit:
    """One vehicle that will come.

    Attributes:
        number: From 0.
        arrives_at_s: On the fleet's clock.
        plan: Its drive.
    """

    number: int
    arrives_at_s: float
    plan: PassagePlan


def draw_visits(plan: FleetPlan) -> tuple[Visit, ...]:
    """Return who comes when, in order; the same for the same plan."""
    rng = np.random.default_rng(plan.seed)
    gap_s = 3600.0 / plan.arrivals_per_hour
    visits = []
    at_s = 0.0
    for number in range(plan.vehicles_count):
        at_s += gap_s if plan.regular else float(rng.exponential(gap_s))
        drive = draw_plan(rng, section=plan.section, base_friction_mu=plan.base_friction_of(number), grade=plan.grade)
        visits.append(Visit(number, at_s, drive))
    return tuple(visits)


class PassageSummary(Protocol):
    """What the onboard pipeline made of a trace that was one passage."""

    @property
    def summary(self) -> KinematicSummary:
        """The statistics."""
        ...

    @property
    def left_at_s(self) -> float:
        """When the vehicle left the section, on the clock of the trace."""
        ...


OpenUplink: TypeAlias = Callable[[], Awaitable[Uplink]]
OpenCodec: TypeAlias = Callable[[bytes], FrameCodec]
"""Makes the codec of one exchange from the passage's id."""
Simulate: TypeAlias = "Callable[[RoadSection, PassagePlan], Drive]"
Summarise: TypeAlias = "Callable[[Trace, RoadSection], PassageSummary | Rejected]"


def simulator() -> Simulate:
    """Return the simulator, which the live client does without.

    Raises:
        ConfigurationError: It is not installed.
    """
    try:
        from vehicle_client.simulator.run import simulate_passage
    except ModuleNotFoundError as error:
        raise ConfigurationError(f"simulated drives need: pip install 'roadgrip[sim]' ({error})") from error
    return simulate_passage


def patience_at(speedup_ratio: float) -> Patience:
    """Return how long vehicles wait when their clock runs so fast; the unit answers in its own time all the same."""
    live = Patience()
    return live.stretched(max(1.0, REPLY_WALL_S / live.reply_s * speedup_ratio))


@dataclass(frozen=True, slots=True)
class FleetTools:
    """What a fleet works with.

    Attributes:
        open_uplink: Opens one vehicle's way to the unit.
        open_codec: Makes one exchange's codec.
        simulate: Drives; called in worker threads.
        summarise: The onboard pipeline; called in worker threads with the map that came over the air.
        patience: How long vehicles wait, on the fleet's clock; left out, it suits the speed-up.
    """

    open_uplink: OpenUplink
    open_codec: OpenCodec
    simulate: Simulate
    summarise: Summarise
    patience: Patience | None = None


async def run_fleet(plan: FleetPlan, tools: FleetTools, *, spool_folder: Path, watch: Watch) -> FleetReport:
    """Return the account of a fleet after its last vehicle has been answered or has given up.

    Args:
        plan: What the fleet shall do.
        tools: What it works with.
        spool_folder: Where summaries wait that were not acknowledged.
        watch: Told what happens, on the event loop; must return at once.
    """
    with ThreadPoolExecutor(max_workers=2, thread_name_prefix="fleet") as pool:
        try:
            return await _Fleet(plan, tools, spool_folder, watch, pool).run()
        except BaseExceptionGroup as group:
            # Whoever called cares what went wrong, not in which of the tasks.
            raise _first_of(group) from None


class _Fleet:
    def __init__(
        self, plan: FleetPlan, tools: FleetTools, spool_folder: Path, watch: Watch, pool: ThreadPoolExecutor
    ) -> None:
        self._plan = plan
        self._tools = tools
        self._watch = watch
        self._pool = pool
        # The clock starts when the first vehicle may come, not while the simulator compiles.
        self._clock: Clock = SpedUpClock(plan.speedup_ratio)
        self._clock_id = secrets.token_hex(8)
        self._spool = Spool(spool_folder, clock_id=self._clock_id)
        self._waiting: dict[bytes, tuple[Visit, Drive]] = {}
        self._patience = tools.patience if tools.patience is not None else patience_at(plan.speedup_ratio)
        self._air_seeds = np.random.SeedSequence(plan.seed, spawn_key=(1,))
        self._report = FleetReport()

    async def run(self) -> FleetReport:
        visits = draw_visits(self._plan)
        all_passed = asyncio.Event()
        await self._in_thread(self._tools.simulate, self._plan.section, visits[0].plan)
        self._watch(FleetReady())
        self._clock = SpedUpClock(self._plan.speedup_ratio)
        async with asyncio.TaskGroup() as group:
            group.create_task(self._deliver_now_and_then(until=all_passed))
            async with asyncio.TaskGroup() as driving:
                async for visit, drive in self._drives(visits):
                    await sleep_until(visit.arrives_at_s, self._clock)
                    driving.create_task(self._pass(visit, drive))
            all_passed.set()
        for _ in range(SPOOL_LAST_ROUNDS_COUNT):
            await self._deliver()
        counts = self._spool.counts
        self._report.waiting_count = len(self._spool)
        self._report.spool_dropped_count = counts.overflowed_count
        self._report.simulated_s = self._clock.now_s()
        return self._report

    async def _drives(self, visits: tuple[Visit, ...]) -> AsyncIterator[tuple[Visit, Drive]]:
        """Yield drives in the order of arrival, simulated a few ahead."""
        ready: asyncio.Queue[tuple[Visit, Drive]] = asyncio.Queue(AHEAD_COUNT)

        async def produce() -> None:
            for visit in visits:
                await ready.put((visit, await self._in_thread(self._tools.simulate, self._plan.section, visit.plan)))

        producer = asyncio.create_task(produce())
        try:
            for _ in visits:
                following = asyncio.create_task(ready.get())
                await asyncio.wait({producer, following}, return_when=asyncio.FIRST_COMPLETED)
                if producer.done() and producer.exception() is not None:
                    following.cancel()
                    producer.result()
                yield await following
        finally:
            producer.cancel()

    async def _pass(self, visit: Visit, drive: Drive) -> None:
        """Let one vehicle pass the section, from its announcement to the end of its exchange."""
        passage_id = secrets.token_bytes(PASSAGE_ID_BYTES)
        exchange = Exchange(
            passage_id=passage_id,
            section_id=self._plan.section.section_id,
            codec=self._tools.open_codec(passage_id),
            patience=self._patience,
        )
        entered_at_s = self._clock.now_s()
        self._watch(VehicleEntered(visit.number, entered_at_s, visit.plan.base_friction_mu, friction_mu=drive.label_mu))
        async with self._uplink() as uplink:
            await send_all(exchange.begin(now_s=entered_at_s), uplink)
            await converse(exchange, uplink, self._clock, until_s=entered_at_s + _duration_s(drive))
            # The drive is recorded; a map that comes now is not too late.
            while exchange.section is None and exchange.stage is Stage.ARRIVING:
                await converse(exchange, uplink, self._clock, until_s=exchange.wake_at_s)
            self._watch(VehicleAdvised(visit.number, self._clock.now_s(), exchange.advisory))
            spooled = await self._report_drive(exchange, uplink, drive, entered_at_s)
            record = exchange.record()
            if spooled is not None and record.may_spool:
                self._spool.keep(replace(spooled, frames_spent_count=record.frames_sent_count))
                self._waiting[passage_id] = (visit, drive)
                self._report.spooled_count += 1
            self._end(visit, drive, record, uplink.counts)

    async def _report_drive(
        self, exchange: Exchange, uplink: Uplink, drive: Drive, entered_at_s: float
    ) -> SpooledSummary | None:
        """Send what the pipeline makes of the drive; return what the spool would have to keep."""
        if exchange.stage is Stage.ENDED:
            return None
        section = exchange.section
        if section is None or not drive.completed:
            exchange.withhold(Reason.PASSAGE_ABORTED)
            return None
        made = await self._in_thread(self._tools.summarise, drive.trace, section)
        if isinstance(made, Rejected):
            exchange.withhold(made.reason)
            return None
        left_at_s = entered_at_s + made.left_at_s - float(drive.trace.time_s[0])
        record = exchange.record()
        await report(exchange, uplink, self._clock, made.summary, map_version=section.version, left_at_s=left_at_s)
        return SpooledSummary(
            passage_id=record.passage_id,
            section_id=section.section_id,
            map_version=section.version,
            summary=made.summary,
            left_at_s=left_at_s,
            clock_id=self._clock_id,
            frames_spent_count=record.frames_sent_count,
        )

    async def _deliver_now_and_then(self, *, until: asyncio.Event) -> None:
        """Try what waits, round after round. A round that has begun is finished, or its frames would go uncounted."""
        while not until.is_set():
            try:
                await asyncio.wait_for(until.wait(), timeout=self._clock.wall_s(SPOOL_ROUND_S))
            except TimeoutError:
                await self._deliver()

    async def _deliver(self) -> None:
        """Try every summary that waits once more, but for those that had to make room meanwhile."""
        for entry in self._spool.waiting():
            with self._spool.delivering(entry.passage_id) as is_there:
                if is_there:
                    await self._deliver_one(entry)

    async def _deliver_one(self, entry: SpooledSummary) -> None:
        exchange = Exchange(
            passage_id=entry.passage_id,
            section_id=entry.section_id,
            codec=self._tools.open_codec(entry.passage_id),
            patience=replace(self._patience, report_tries_count=SPOOL_TRIES_COUNT),
            frames_spent_count=entry.frames_spent_count,
        )
        async with self._uplink() as uplink:
            await report(
                exchange,
                uplink,
                self._clock,
                entry.summary,
                map_version=entry.map_version,
                left_at_s=entry.left_at_s,
            )
            record = exchange.record()
        if not record.may_spool:
            self._spool.drop(entry.passage_id)
            self._report.delivered_late_count += record.ending is Ending.ACCEPTED
        elif record.frames_sent_count >= VEHICLE_FRAME_BUDGET:
            self._spool.drop(entry.passage_id)
            self._report.frames_spent_count += 1
        else:
            self._spool.keep(replace(entry, frames_spent_count=record.frames_sent_count))
        visit, drive = self._waiting[entry.passage_id]
        self._end(visit, drive, record, uplink.counts, spent_before_count=entry.frames_spent_count)

    def _end(
        self, visit: Visit, drive: Drive, record: ExchangeRecord, air: AirCounts, *, spent_before_count: int = 0
    ) -> None:
        ended = PassageEnded(
            number=visit.number,
            at_s=self._clock.now_s(),
            base_friction_mu=visit.plan.base_friction_mu,
            friction_mu=drive.label_mu,
            drive_outcome=drive.outcome.value,
            record=record,
            air=air,
            spent_before_count=spent_before_count,
        )
        self._report.add(ended)
        self._watch(ended)

    @contextlib.asynccontextmanager
    async def _uplink(self) -> AsyncIterator[LossyUplink]:
        rng = np.random.default_rng(self._air_seeds.spawn(1)[0])
        uplink = LossyUplink(await self._tools.open_uplink(), self._plan.faults, rng)
        try:
            yield uplink
        finally:
            await uplink.close()

    async def _in_thread(self, work: Callable[..., _T], *args: object) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._pool, work, *args)


def _first_of(error: BaseException) -> BaseException:
    return _first_of(error.exceptions[0]) if isinstance(error, BaseExceptionGroup) else error


def _duration_s(drive: Drive) -> float:
    return float(drive.trace.time_s[-1] - drive.trace.time_s[0])

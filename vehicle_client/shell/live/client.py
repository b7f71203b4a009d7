r"""The loop that runs in a car.

::

    source -> ring -> surroundings --open--> attendance: announce, map, advice ----> dashboard, CAN
                          ^    \--summarise--> pipeline (worker thread) --> report --> receipt, or the spool
    beacons, listings ----/                                                            \--> the next unit

One event loop does everything that is quick. What is not (the pipeline, some 10 ms; writing to the spool, which waits
for the disk) goes to one worker thread, so that the loop never waits for it: a thread and not a process, since a second
interpreter with numpy costs 30 MB, and numpy lets go of the interpreter's lock where it works long.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import OrderedDict
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from roadgrip.errors import RoadgripError
from roadgrip.records import VEHICLE_FRAME_BUDGET, Reason, Rejected
from vehicle_client.mapmatch.approach import Moment, SummariseOrder
from vehicle_client.mapmatch.section_line import line_of_section
from vehicle_client.mapmatch.surroundings import CloseOrder, OpenOrder, Order, Position, Surroundings
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.recording.own_columns import GNSS_ACCURACY_M
from vehicle_client.shell.exchange import Exchange
from vehicle_client.shell.live.attendance import Attendance, Nothing, Report, Tools, send_spooled
from vehicle_client.shell.live.cellular import QueryClock, list_sections
from vehicle_client.shell.live.cockpit import Cockpit, SendAdvice
from vehicle_client.shell.live.journal import Journal, Write, passage_entry
from vehicle_client.shell.live.key_renewal import keep_renewing
from vehicle_client.shell.live.learner import Learner
from vehicle_client.shell.live.map_store import MapStore
from vehicle_client.shell.live.ring import Recorded, SampleRing, trace_of
from vehicle_client.shell.live.source import SourceState
from vehicle_client.shell.live.units import BroadcastListener, Heard, UnitsInReach, listen_for_broadcasts
from vehicle_client.shell.patience import Patience
from vehicle_client.shell.spool import BootClock, Spool, SpooledSummary
from vehicle_client.shell.uplink import HTTP_TIMEOUT_S, HttpUplink, UdpUplink

if TYPE_CHECKING:
    import httpx

    from roadgrip.records import Advisory
    from roadgrip.section import RoadSection
    from vehicle_client.estimation.grip.memory import CarMemory
    from vehicle_client.shell.live.settings import LiveSettings
    from vehicle_client.shell.live.source import Source
    from vehicle_client.shell.uplink import UnitAddress, Uplink
    from vehicle_client.vehicle_profile import VehicleProfile

TICK_S = 0.1
MAPS_LIMIT_COUNT = 16
"""Maps in memory; some 100 kB each with the profile that is computed from it."""
MAPS_FOLDER = "maps"
"""In the spool's folder; as many maps on disk as in memory."""
ASSUMED_BEACON_S = 10.0
DELIVERY_PAUSE_S = 20.0
"""A summary that was not taken is tried again after this, while a unit is in reach."""
DELIVERY_TRIES_COUNT = 2
FINISH_LIMIT_S = 30.0
"""How long answers are awaited after a recording that is played once."""
STOP_LIMIT_S = 0.8


class LiveClient:
    """One car's client; `run` until `stop`."""

    def __init__(
        self,
        settings: LiveSettings,
        source: Source,
        *,
        write: Write,
        send_advice: SendAdvice | None = None,
    ) -> None:
        """Open the spool and take the ring's memory; needs a running event loop.

        Args:
            settings: What was chosen.
            source: Gives sensor values.
            write: Takes the lines of the log.
            send_advice: Puts advice on a CAN bus, if that is wanted.

        Raises:
            SpoolError: The spool's folder cannot be used.
        """
        self._settings = settings
        self._source = source
        self._journal = Journal(write)
        self._ring = SampleRing()
        self._around = Surroundings()
        self._units = UnitsInReach()
        self._clock = BootClock()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="worker")
        self._tools = Tools(
            keys=settings.keys,
            clock=self._clock,
            clock_id=self._clock.clock_id,
            spool=Spool(
                settings.spool_folder, clock_id=self._clock.clock_id, capacity_count=settings.spool_capacity_count
            ),
            worker=self._worker,
        )
        self._maps: OrderedDict[str, RoadSection] = OrderedDict()
        self._learner = Learner(settings.memory_file, settings.vehicle)
        self._map_store = MapStore(settings.spool_folder / MAPS_FOLDER, capacity_count=MAPS_LIMIT_COUNT)
        self._cockpit = Cockpit(
            self._clock,
            source_state_of=lambda: source.state,
            passes_of=lambda: self._around.passes,
            map_of=self._maps.get,
            counters=self.counters,
            counts=self._journal.counts,
            send=send_advice,
        )
        self._attendances: dict[str, Attendance] = {}
        self._made: dict[Attendance, Summarised] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._stopping = asyncio.Event()
        self._moment = Moment(0.0, 0.0, 0.0)
        self._driving = False
        self._assumed_s = -ASSUMED_BEACON_S
        self._delivery = asyncio.Lock()
        self._tried_s: dict[bytes, float] = {}
        self._served: frozenset[str] = frozenset()
        self._query = QueryClock()
        self._http: httpx.AsyncClient | None = None
        for section in self._map_store.load():
            self._learn_map(section)
        for section in settings.sections:
            self._learn_map(section)

    def stop(self) -> None:
        """Ask the client to end; it does within a second."""
        self._stopping.set()

    @property
    def cockpit(self) -> Cockpit:
        """What the driver is told."""
        return self._cockpit

    async def run(self) -> None:
        """Drive until stopped, or until the recording ends if it is to be played once.

        Raises:
            ConfigurationError: A socket cannot be opened.
        """
        settings = self._settings
        async with contextlib.AsyncExitStack() as stack:
            stack.callback(self._worker.shutdown)
            stack.callback(self._source.close)
            if settings.dashboard is not None:
                await self._cockpit.open(settings.dashboard)
                stack.push_async_callback(self._cockpit.close)
            if settings.beacons is not None:
                listener = BroadcastListener(
                    self._hear,
                    keys=settings.keys,
                    age_limit_s=settings.beacon_age_limit_s,
                    counts=self._journal.counts,
                )
                host, port = settings.beacons
                stack.callback((await listen_for_broadcasts(listener, host=host, port=port)).close)
            if settings.unit is not None and settings.unit.scheme != "udp":
                import httpx

                self._http = await stack.enter_async_context(httpx.AsyncClient(timeout=HTTP_TIMEOUT_S))
            started = {"event": "started", "spool_waiting_count": len(self._tools.spool), **self._lost()}
            self._journal.say(started | self._learner.state())
            for entry in self._learner.notes:
                self._journal.counts[entry["event"]] += 1
                self._journal.say(entry)
            await self._work()
            self._journal.say({"event": "stopped", **self.counters()})

    def counters(self) -> dict[str, Any]:
        """Return everything that is counted, as readers of the dashboard and the log get it."""
        ring = self._ring.counts
        return {
            "passages_open": len(self._around.passes),
            "pseudonyms_in_date": self._settings.keys.pseudonyms_count,
            "spool_waiting": len(self._tools.spool),
            **self._lost(),
            "values_late": ring.late_count,
            "values_unknown": ring.unknown_count,
            "channel_resets": ring.reset_count,
            "ring_bytes": self._ring.size_bytes,
            **self._learner.state(),
            **self._source.counts(),
            **dict(sorted(self._journal.counts.items())),
        }

    def log_counters(self) -> None:
        """Write the counters to the log."""
        self._journal.say({"event": "counters", **self.counters()})

    # ---------------------------------------------------------------------------------------- what conversations need

    def address_of(self, section_id: str) -> UnitAddress | None:
        """Return where a unit that serves the section is in reach now: by radio first, then over cellular."""
        heard = self._units.address_of(section_id, now_s=self._clock.now_s())
        unit = self._settings.unit
        if heard is not None or unit is None or unit.scheme == "udp":
            return heard if heard is not None else unit
        return unit if section_id in self._served else None

    @contextlib.asynccontextmanager
    async def open_uplink(self, address: UnitAddress) -> AsyncIterator[Uplink]:
        """Yield a way to a unit."""
        uplink: Uplink
        if address.scheme == "udp":
            uplink = await UdpUplink(address).open()
        else:
            assert self._http is not None  # noqa: S101 - such an address comes from the settings alone
            uplink = HttpUplink(address, self._http)
        try:
            yield uplink
        finally:
            await uplink.close()

    def known_section(self, section_id: str) -> RoadSection | None:
        """Return the map from an earlier pass."""
        return self._maps.get(section_id)

    def take_map(self, section: RoadSection) -> None:
        """Keep a map, and look for its section from now on."""
        if self._learn_map(section):
            self._begin(self._tools.work(self._map_store.keep, section))
            self._cockpit.show_map(section)
        else:
            self._begin(self._tools.work(self._map_store.touch, section.section_id))

    def _learn_map(self, section: RoadSection) -> bool:
        """Return whether a map is news."""
        known = self._maps.pop(section.section_id, None)
        self._maps[section.section_id] = section
        if known is not None and known.version == section.version:
            return False
        while len(self._maps) > MAPS_LIMIT_COUNT:
            self._maps.popitem(last=False)
        self._around.learn(line_of_section(section), has_map=True)
        return True

    def take_advice(self, section_id: str, advisory: Advisory) -> None:
        """Show advice to the driver, while its pass lasts and it holds."""
        self._cockpit.show_advice(section_id, advisory)

    def take_no_map(self, section_id: str) -> None:
        """Give up a pass whose map did not come."""
        self._obey(self._around.no_map(section_id, self._moment))

    # --------------------------------------------------------------------------------------------------- the car drives

    async def _work(self) -> None:
        loops = [
            self._drive(),
            self._deliver_by_listing(),
            self._cockpit.keep_going(),
            self._count_now_and_then(),
            keep_renewing(self._settings.keys, self._tools, self._journal),
        ]
        tasks = [asyncio.ensure_future(loop) for loop in loops]
        stopping = asyncio.ensure_future(self._stopping.wait())
        try:
            # Only the drive ends by itself, and whatever fails must not fail in silence.
            done, _ = await asyncio.wait({*tasks, stopping}, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                await task
        finally:
            left = [*tasks, stopping, *self._tasks]
            for task in left:
                task.cancel()
            await asyncio.wait(left, timeout=STOP_LIMIT_S)

    async def _drive(self) -> None:
        """Follow the sensors; returns after a recording that is played once."""
        at_s = self._source.start()
        self._assumed_s = at_s - ASSUMED_BEACON_S
        self._driving = True
        told = SourceState.RUNNING
        while (state := self._source.state) is not SourceState.ENDED:
            if state is not told:
                self._journal.say({"event": f"source_{state.value}"})
                told = state
            now_s = self._source.now_s()
            while at_s < now_s:
                at_s = min(now_s, at_s + self._source.step_s)
                self._step(at_s)
                # A recording played fast takes many steps at a time; the sockets get their turn in between.
                await asyncio.sleep(0.0)
            await asyncio.sleep(TICK_S)
        self._journal.say({"event": "source_ended"})
        if not self._settings.once:
            await self._stopping.wait()
        give_up_s = self._clock.now_s() + FINISH_LIMIT_S
        while self._tasks and self._clock.now_s() < give_up_s:
            self._obey(self._around.finish(self._moment))
            await asyncio.wait(set(self._tasks), timeout=TICK_S)

    def _step(self, at_s: float) -> None:
        self._ring.put(self._source.take(until_s=at_s))
        self._moment = Moment(at_s, self._ring.driven_m, self._ring.speed_mps)
        fix = self._fix()
        if at_s - self._assumed_s >= ASSUMED_BEACON_S:
            self._assumed_s = at_s
            for section in self._settings.sections:
                self._obey(self._around.hear(section.section_id, self._moment, fix))
        self._obey(self._around.move(self._moment, fix))
        self._cockpit.refresh()

    def _fix(self) -> Position | None:
        lat, lon, accuracy = (self._ring.last(name) for name in ("lat_deg", "lon_deg", "gnss_accuracy_m"))
        if lat is None or lon is None:
            return None
        accuracy_m = accuracy[1] if accuracy is not None and accuracy[1] == accuracy[1] else GNSS_ACCURACY_M
        return Position(min(lat[0], lon[0]), lat[1], lon[1], accuracy_m)

    def _hear(self, heard: Heard) -> None:
        self._units.note(heard, now_s=self._clock.now_s())
        if self._driving:
            self._obey(self._around.hear(heard.section_id, self._moment, self._fix()))
        if len(self._tools.spool):
            self._begin(self._deliver(frozenset({heard.section_id})))

    def _obey(self, orders: tuple[Order, ...]) -> None:
        for order in orders:
            match order:
                case OpenOrder(section_id):
                    self._journal.counts["passes_opened"] += 1
                    attendance = self._attendances[section_id] = Attendance(section_id, self, self._tools)
                    self._begin(self._attend(attendance))
                    if section_id in self._maps:
                        self._cockpit.show_map(self._maps[section_id])
                case SummariseOrder():
                    self._begin(self._summarise(order))
                case CloseOrder(section_id, why, summarised):
                    attendance_or_none = self._attendances.pop(section_id, None)
                    self._cockpit.withdraw(section_id)
                    if attendance_or_none is not None and not summarised:
                        attendance_or_none.settle(Nothing(why))

    def _begin(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(_reported(work, self._journal))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _summarise(self, order: SummariseOrder) -> None:
        attendance = self._attendances.get(order.section_id)
        section = None if attendance is None else attendance.section
        if attendance is None or section is None:
            # Mapped anew meanwhile: asked again when the newer map is there, or with the next metres.
            self._obey(self._around.answer(order.section_id, Reason.WRONG_ROAD, self._moment))
            return
        since_s = max(order.since_s, self._ring.time_at(order.since_m))
        recorded = self._ring.cut(since_s=since_s, missing=self._settings.missing)
        self._journal.counts["pipeline_runs"] += 1
        memory = self._learner.memory
        made = await self._tools.work(summarised, recorded, section, self._settings.vehicle, memory)
        if isinstance(made, Rejected):
            self._journal.counts[f"pipeline_{made.reason.value}"] += 1
            self._obey(self._around.answer(order.section_id, made.reason, self._moment))
            return
        # On the clock of the recording, which may be played fast, to the clock that ages are told by.
        ago_s = self._source.wall_s(self._source.now_s() - made.left_at_s)
        self._made[attendance] = made
        attendance.settle(Report(made.summary, section, left_at_s=self._clock.now_s() - max(0.0, ago_s)))
        self._obey(self._around.answer(order.section_id, None, self._moment, left_at_s=made.left_at_s))
        if memory is not None:
            # Nobody waits for it, and what fails here fails by itself.
            self._begin(self._learn(made, memory))

    async def _learn(self, made: Summarised, seen_with: CarMemory) -> None:
        taught = await self._tools.work(self._learner.learn, made, seen_with)
        self._journal.counts["lessons" if taught else "lessons_without_news"] += 1

    async def _attend(self, attendance: Attendance) -> None:
        record = await attendance.run()
        made = self._made.pop(attendance, None)
        age_s = None if made is None else self._source.wall_s(self._source.now_s() - made.left_at_s)
        self._journal.passage(
            passage_entry(attendance.section_id, record, made, via=attendance.via, late=False, age_s=age_s)
        )

    # ------------------------------------------------------------------------------------------------- what had to wait

    async def _deliver(self, section_ids: frozenset[str]) -> None:
        """Send what waits for these sections, one after the other."""
        if self._delivery.locked():
            return
        async with self._delivery:
            for entry in await self._tools.work(self._tools.spool.waiting):
                now_s = self._clock.now_s()
                tried_s = self._tried_s.get(entry.passage_id, -DELIVERY_PAUSE_S)
                address = self.address_of(entry.section_id)
                if entry.section_id in section_ids and address is not None and now_s - tried_s >= DELIVERY_PAUSE_S:
                    await self._deliver_one(entry, address)
            waiting = {entry.passage_id for entry in await self._tools.work(self._tools.spool.waiting)}
            self._tried_s = {known: at_s for known, at_s in self._tried_s.items() if known in waiting}

    async def _deliver_one(self, entry: SpooledSummary, address: UnitAddress) -> None:
        self._tried_s[entry.passage_id] = self._clock.now_s()
        exchange = Exchange(
            passage_id=entry.passage_id,
            section_id=entry.section_id,
            codec=self._settings.keys.codecs_for(entry.section_id)(entry.passage_id),
            patience=replace(Patience(), report_tries_count=DELIVERY_TRIES_COUNT),
            frames_spent_count=entry.frames_spent_count,
        )
        async with self.open_uplink(address) as uplink:
            sent = await send_spooled(
                entry, exchange, uplink, self._tools, map_version=entry.map_version, left_at_s=entry.left_at_s
            )
        record = exchange.record()
        if not sent:
            return  # its own pass is just sending it
        if record.may_spool:
            if record.frames_sent_count < VEHICLE_FRAME_BUDGET:
                return
            await self._tools.work(self._tools.spool.drop, entry.passage_id)
            self._journal.counts["spool_dropped_frames_spent"] += 1
        age_s = self._clock.now_s() - entry.left_at_s
        self._journal.passage(passage_entry(entry.section_id, record, None, via=address.scheme, late=True, age_s=age_s))

    async def _deliver_by_listing(self) -> None:
        """Ask the server over cellular what lies around, whenever that is due, and deliver what waits for it."""
        unit = self._settings.unit
        while self._http is not None and unit is not None:
            fix, now_s = self._fix(), self._clock.now_s()
            if self._query.due(fix, now_s=now_s, waiting=len(self._tools.spool) > 0):
                listing = await list_sections(self._http, unit, fix)
                self._query.asked(fix, now_s=now_s, answered=listing is not None)
                self._journal.counts["listings_failed" if listing is None else "listings"] += 1
                if listing is not None:
                    self._served = listing.section_ids
                    for line in listing.lines:
                        self._around.learn(line, has_map=False)
                    await self._deliver(self._served)
            await asyncio.sleep(1.0)
        await self._stopping.wait()

    async def _count_now_and_then(self) -> None:
        while True:
            await asyncio.sleep(self._settings.counters_period_s)
            self.log_counters()

    def _lost(self) -> dict[str, int]:
        counts = self._tools.spool.counts
        return {
            "spool_dropped_overflow": counts.overflowed_count,
            "spool_dropped_age_unknown": counts.age_unknown_count,
            "spool_dropped_unreadable": counts.unreadable_count,
            "maps_dropped_unreadable": self._map_store.unreadable_count,
        }


def summarised(
    recorded: Recorded, section: RoadSection, vehicle: VehicleProfile, memory: CarMemory | None = None
) -> Summarised | Rejected:
    """Return what the pipeline makes of a recording; runs in the worker."""
    trace = trace_of(recorded)
    if trace is None:
        return Rejected(Reason.TOO_SHORT, "a sensor has said nothing")
    try:
        return summarise_passage(
            trace,
            section,
            vehicle=vehicle.geometry,
            parameters=vehicle.parameters,
            handling=vehicle.handling,
            noise=vehicle.noise,
            memory=memory,
        )
    except RoadgripError as error:
        return Rejected(Reason.TOO_MANY_GAPS, str(error))


async def _reported(work: Any, journal: Journal) -> None:
    """Do work of which nobody awaits the end; what fails is counted and logged, and never ends the client."""
    try:
        await work
    except (RoadgripError, OSError) as error:
        journal.counts["failures"] += 1
        journal.say({"event": "failure", "what": str(error)})

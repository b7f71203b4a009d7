"""Real fleets against real units, with drives that take no simulator and summaries that every unit can judge."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path

import numpy as np

from roadgrip.section import RoadSection
from tests.rsu_app.fakes import make_passage
from tests.vehicle_client.shell.cars import Summarised, a_drive
from vehicle_client.estimation.trace import Trace
from vehicle_client.shell.fleet import FleetPlan, FleetTools, run_fleet
from vehicle_client.shell.fleet_events import FleetEvent, FleetReport, PassageEnded
from vehicle_client.shell.keys import Keys
from vehicle_client.shell.patience import Patience
from vehicle_client.shell.uplink import AirFaults, parse_unit_address, uplinks_to
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.plan import PassagePlan

MU = 0.4
"""What the linear model of `tests.bundles` reads from every summary made here."""
EXIT_ROAD_S = 2.0
"""Each recording goes on for so long beyond the section, unless told otherwise."""


@dataclass
class Fleet:
    """Vehicles that come to a section and do everything but drive.

    Attributes:
        section: The road they know by name; its map they get from the unit.
        vehicles_count: How many.
        speedup_ratio: Of their clock.
        arrivals_per_hour: On their clock; they come at equal distances.
        keys: What they sign with and believe.
        faults: Of their own air.
        patience: How long they wait; left out, it suits the speed-up.
        drive_s: How long each drives, by number.
        exit_road_s: How long it drives on after the section, by number.
        seed: Two fleets with different ones never send the same values.
        on_event: Told what happens.
        events: What happened.
        maps: Versions of the maps that summaries were cut with, in order.
    """

    section: RoadSection
    vehicles_count: int = 10
    speedup_ratio: float = 60.0
    arrivals_per_hour: float = 2400.0
    keys: Keys = field(default_factory=Keys)
    faults: AirFaults = field(default_factory=AirFaults)
    patience: Patience | None = None
    drive_s: Callable[[int], float] = lambda _: 30.0
    exit_road_s: Callable[[int], float] = lambda _: EXIT_ROAD_S
    seed: int = 1
    on_event: Callable[[FleetEvent], None] = lambda _: None
    events: list[FleetEvent] = field(default_factory=list)
    maps: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._traces: list[Trace] = []  # kept alive, since they are known by their id
        self._left_at_s: dict[int, float] = {}
        self._values = count(1_000_000 * self.seed)
        self._numbers = count(-1)  # the fleet lets the simulator warm up with a first drive that nobody drives

    @property
    def endings(self) -> list[PassageEnded]:
        """Exchanges that ended, deliveries from the spool included."""
        return [event for event in self.events if isinstance(event, PassageEnded)]

    async def run(self, address: str, *, spool_folder: Path) -> FleetReport:
        """Return the fleet's account. It talks to one unit, whatever the address's scheme."""
        async with AsyncExitStack() as stack:
            open_uplink = await stack.enter_async_context(uplinks_to(parse_unit_address(address)))
            tools = FleetTools(
                open_uplink=open_uplink,
                open_codec=self.keys.codecs_for(self.section.section_id, speedup_ratio=self.speedup_ratio),
                simulate=self._drive,
                summarise=self._summarise,
                patience=self.patience,
            )
            plan = FleetPlan(
                section=self.section,
                vehicles_count=self.vehicles_count,
                base_friction_mu=MU,
                arrivals_per_hour=self.arrivals_per_hour,
                regular=True,
                speedup_ratio=self.speedup_ratio,
                faults=self.faults,
                seed=self.seed,
            )
            return await run_fleet(plan, tools, spool_folder=spool_folder, watch=self._watch)

    def _watch(self, event: FleetEvent) -> None:
        self.events.append(event)
        self.on_event(event)

    def _drive(self, section: RoadSection, plan: PassagePlan) -> Drive:
        # Drives are asked for one after the other in the order of arrival, so counting them tells the number.
        number = max(0, next(self._numbers))
        drive = a_drive(section, plan)
        time_s = np.linspace(0.0, self.drive_s(number), drive.trace.samples_count)
        trace = replace(drive.trace, time_s=time_s)
        self._left_at_s[id(trace)] = self.drive_s(number) - self.exit_road_s(number)
        self._traces.append(trace)
        return replace(drive, trace=trace)

    def _summarise(self, trace: Trace, section: RoadSection) -> Summarised:
        self.maps.append(section.version)
        summary = make_passage(section, seed=next(self._values), mu=MU).summary
        return Summarised(summary, left_at_s=self._left_at_s[id(trace)])

"""What a fleet tells whoever watches it, and the account it gives at the end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

from roadgrip.records import Accepted, Advisory, NotCounted, Rejected
from vehicle_client.shell.exchange import Ending, ExchangeRecord
from vehicle_client.shell.uplink import AirCounts


@dataclass(frozen=True, slots=True)
class FleetReady:
    """The simulator answers and the first vehicle may come."""


@dataclass(frozen=True, slots=True)
class VehicleEntered:
    """A vehicle announced itself.

    Attributes:
        number: Of the vehicle, from 0.
        at_s: On the fleet's clock.
        base_friction_mu: What the road offers a new tyre.
        friction_mu: What this vehicle's tyres find.
    """

    number: int
    at_s: float
    base_friction_mu: float
    friction_mu: float


@dataclass(frozen=True, slots=True)
class VehicleAdvised:
    """A vehicle that left the section had this advice on its way, or none."""

    number: int
    at_s: float
    advisory: Advisory | None


@dataclass(frozen=True, slots=True)
class PassageEnded:
    """An exchange is over, for now or for good.

    Attributes:
        number: Of the vehicle.
        at_s: On the fleet's clock.
        base_friction_mu: What the road offered a new tyre when the vehicle came.
        friction_mu: What its tyres found.
        drive_outcome: How the drive ended.
        record: How the exchange ended.
        air: What the air did to its frames.
        spent_before_count: Frames of this passage that earlier exchanges had used; above zero, a summary was
            delivered that had waited in the spool.
    """

    number: int
    at_s: float
    base_friction_mu: float
    friction_mu: float
    drive_outcome: str
    record: ExchangeRecord
    air: AirCounts
    spent_before_count: int = 0

    @property
    def from_spool(self) -> bool:
        """Whether the summary had waited in the spool."""
        return self.spent_before_count > 0


FleetEvent: TypeAlias = FleetReady | VehicleEntered | VehicleAdvised | PassageEnded
Watch: TypeAlias = Callable[[FleetEvent], None]


@dataclass(slots=True)
class FleetReport:
    """The account of a fleet; counts add up to the vehicles that came.

    Attributes:
        vehicles_count: Vehicles that came.
        drives: How the drives ended.
        accepted_count: Passages the unit acknowledged.
        counted_count: Those of them that enter the unit's window.
        not_counted: Why the others do not.
        rejected: Passages the unit refused for good, by reason.
        withheld: Summaries the vehicles kept to themselves, by reason.
        no_map_count: Vehicles that never got the map.
        waiting_count: Passages without a receipt at the end; their summaries are still in the spool.
        spooled_count: Passages that had to wait in the spool.
        delivered_late_count: Those of them that were acknowledged after all.
        spool_dropped_count: Those that the spool had to drop, because it was full.
        frames_spent_count: Those that were given up, because the passage's frames were used up.
        frames_sent_count: Frames the vehicles sent.
        frames_received_count: Frames the vehicles received.
        frames_ignored_count: Spoiled frames that reached a vehicle.
        retries_count: Messages that were sent again.
        budget_peak_count: Most frames one vehicle sent for one passage; at most 12 by the rules.
        air: What the air did to the frames of both directions.
        recovered_count: Lost or spoiled frames of passages that were acknowledged all the same.
        passage_ids: What was acknowledged, to be looked for in the unit's store.
        simulated_s: Time that passed on the fleet's clock.
    """

    vehicles_count: int = 0
    drives: Counter[str] = field(default_factory=Counter)
    accepted_count: int = 0
    counted_count: int = 0
    not_counted: Counter[str] = field(default_factory=Counter)
    rejected: Counter[str] = field(default_factory=Counter)
    withheld: Counter[str] = field(default_factory=Counter)
    no_map_count: int = 0
    waiting_count: int = 0
    spooled_count: int = 0
    delivered_late_count: int = 0
    spool_dropped_count: int = 0
    frames_spent_count: int = 0
    frames_sent_count: int = 0
    frames_received_count: int = 0
    frames_ignored_count: int = 0
    retries_count: int = 0
    budget_peak_count: int = 0
    air: AirCounts = field(default_factory=AirCounts)
    recovered_count: int = 0
    passage_ids: list[bytes] = field(default_factory=list)
    simulated_s: float = 0.0

    def add(self, ended: PassageEnded) -> None:
        """Count an exchange, the first of its passage or a later delivery from the spool."""
        record, air = ended.record, ended.air
        if not ended.from_spool:
            self.vehicles_count += 1
            self.drives[ended.drive_outcome] += 1
        self.frames_sent_count += record.frames_sent_count - ended.spent_before_count
        self.frames_received_count += record.frames_received_count
        self.frames_ignored_count += record.frames_refused_count
        self.retries_count += max(0, record.arrival_tries_count - 1) + max(0, record.report_tries_count - 1)
        self.budget_peak_count = max(self.budget_peak_count, record.frames_sent_count)
        self.air.add(air)
        if record.ending is Ending.ACCEPTED and isinstance(record.outcome, Accepted):
            self.accepted_count += 1
            self.counted_count += record.outcome.counted
            self.not_counted.update(flag_names(record.outcome.flags))
            self.passage_ids.append(record.passage_id)
            self.recovered_count += air.missing_count
        elif record.ending is Ending.REJECTED and isinstance(record.outcome, Rejected):
            self.rejected[record.outcome.reason.value] += 1
        elif record.ending is Ending.WITHHELD and record.withheld is not None:
            self.withheld[record.withheld.value] += 1
        elif record.ending is Ending.NO_MAP:
            self.no_map_count += 1


def flag_names(flags: NotCounted) -> list[str]:
    """Return the names of the flags that are set, in small letters."""
    return [flag.name.lower() for flag in NotCounted if flag in flags and flag.name is not None and flag.value]

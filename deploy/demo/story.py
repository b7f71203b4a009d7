"""What happens in the demo, gathered from three sides: the fleet, the unit's answers, and the unit's own records."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from roadgrip.records import RSU_FRAME_BUDGET, VEHICLE_FRAME_BUDGET, Accepted, Advisory
from vehicle_client.shell.fleet_events import (
    FleetEvent,
    FleetReady,
    FleetReport,
    PassageEnded,
    VehicleEntered,
)

WORN_FACTOR = 0.8
"""A badly worn tyre finds this share of what a new one finds (the paper)."""
INTERVAL_ERROR_LIMIT_FRAC = 0.15
"""How far the published upper end may lie from the road's friction before it changes and at the end. The paper
reports 10 % as the worst error of a median of 50 vehicles; a demo of one seed gets half as much again."""


@dataclass(slots=True)
class Vehicle:
    """One vehicle of the fleet.

    Attributes:
        number: From 0.
        at_s: When it came, on the fleet's clock.
        base_friction_mu: What the road offered a new tyre.
        friction_mu: What its tyres found.
        passage_id: Of its passage; empty until its exchange ended.
        acknowledged: Whether it has a receipt that accepts the passage.
        ended: How drive and exchange ended, in words; empty while it is on its way.
    """

    number: int
    at_s: float
    base_friction_mu: float
    friction_mu: float
    passage_id: bytes = b""
    acknowledged: bool = False
    ended: str = ""


@dataclass(frozen=True, slots=True)
class Estimate:
    """What the unit stored about a passage.

    Attributes:
        sequence_number: In the order of arrival.
        passage_id: Of the passage.
        mu: The estimate, if the model gave one.
        counted: Whether it entered the window.
    """

    sequence_number: int
    passage_id: bytes
    mu: float | None
    counted: bool


@dataclass(frozen=True, slots=True)
class Reading:
    """What the unit published at one moment.

    Attributes:
        at_s: When, on the fleet's clock.
        advisory: The advice, with the interval behind it.
        base_friction_mu: What the road offered a new tyre at that moment.
    """

    at_s: float
    advisory: Advisory
    base_friction_mu: float


@dataclass(frozen=True, slots=True)
class Check:
    """One thing the demo promises.

    Attributes:
        promise: What should be true.
        kept: Whether it is.
        detail: The figures.
    """

    promise: str
    kept: bool
    detail: str


@dataclass
class Story:
    """Everything that is known so far.

    Attributes:
        vehicles_count: How many will come.
        first_mu: What the road offers a new tyre at first.
        second_mu: And later.
        started: Whether the fleet's clock runs.
        vehicles: Who came, by number.
        estimates: What the unit stored, by passage.
        readings: What the unit published, in order.
        account: The fleet's account so far.
        unit_frames_counts: Frames that the unit sent to each vehicle, by number, as the air saw them.
    """

    vehicles_count: int
    first_mu: float
    second_mu: float
    started: bool = False
    vehicles: dict[int, Vehicle] = field(default_factory=dict)
    estimates: dict[bytes, Estimate] = field(default_factory=dict)
    readings: list[Reading] = field(default_factory=list)
    account: FleetReport = field(default_factory=FleetReport)
    unit_frames_counts: Counter[int] = field(default_factory=Counter)

    def watch(self, event: FleetEvent) -> None:
        """Take what the fleet tells."""
        match event:
            case FleetReady():
                self.started = True
            case VehicleEntered(number, at_s, base_mu, mu):
                self.vehicles[number] = Vehicle(number, at_s, base_mu, mu)
            case PassageEnded():
                self.account.add(event)
                # The air saw the frames of both; what the vehicle did not send came from the unit.
                sent_count = event.record.frames_sent_count - event.spent_before_count
                self.unit_frames_counts[event.number] += event.air.offered_count - sent_count
                vehicle = self.vehicles[event.number]
                vehicle.passage_id = event.record.passage_id
                vehicle.acknowledged = isinstance(event.record.outcome, Accepted)
                vehicle.ended = event.record.ending.value if vehicle.acknowledged else _misfortune(event)

    def take_estimates(self, estimates: list[Estimate]) -> None:
        """Take what the unit stored since the last time."""
        for estimate in estimates:
            self.estimates[estimate.passage_id] = estimate

    def take_reading(self, at_s: float, advisory: Advisory) -> None:
        """Take what the unit publishes now."""
        self.readings.append(Reading(at_s, advisory, self.base_friction_mu))

    @property
    def base_friction_mu(self) -> float:
        """What the road offers a new tyre now."""
        return self.vehicles[max(self.vehicles)].base_friction_mu if self.vehicles else self.first_mu

    @property
    def on_the_road_count(self) -> int:
        """Vehicles that are on their way."""
        return sum(not v.ended for v in self.vehicles.values())

    @property
    def off_the_road_count(self) -> int:
        """Vehicles that slid off the road."""
        return self.account.drives.total() - self.account.drives["completed"]

    @property
    def changed_at_s(self) -> float | None:
        """When the first vehicle met the changed road; None before."""
        later = [v.at_s for v in self.vehicles.values() if v.base_friction_mu == self.second_mu]
        return min(later) if later and self.second_mu != self.first_mu else None

    def estimated(self) -> list[tuple[Vehicle, Estimate]]:
        """Return the vehicles whose passage the unit stored, in the order they came."""
        found = ((v, self.estimates.get(v.passage_id)) for _, v in sorted(self.vehicles.items()))
        return [(vehicle, estimate) for vehicle, estimate in found if estimate is not None]

    def last_reading(self, *, base_friction_mu: float) -> Reading | None:
        """Return what was published last while the road offered so much."""
        return next((r for r in reversed(self.readings) if r.base_friction_mu == base_friction_mu), None)

    def checks(self) -> list[Check]:
        """Return the promises about the whole run; to be asked when it is over."""
        stored = {v.passage_id for v in self.vehicles.values() if v.acknowledged} & set(self.estimates)
        acknowledged_count = sum(v.acknowledged for v in self.vehicles.values())
        peak_count = self.account.budget_peak_count
        unit_peak_count = max(self.unit_frames_counts.values(), default=0)
        came = len(self.vehicles)
        return [
            _interval_check("before the road changes", self.last_reading(base_friction_mu=self.first_mu)),
            _interval_check("at the end", self.last_reading(base_friction_mu=self.second_mu)),
            Check("every vehicle came", came == self.vehicles_count, f"{came} of {self.vehicles_count}"),
            Check(
                "every acknowledged passage is in the unit's database",
                0 < acknowledged_count == len(stored),
                f"{len(stored)} of {acknowledged_count}",
            ),
            Check(
                "no vehicle sent more frames than it may",
                peak_count <= VEHICLE_FRAME_BUDGET,
                f"{peak_count} of {VEHICLE_FRAME_BUDGET}",
            ),
            Check(
                "the unit sent no vehicle more frames than it may",
                unit_peak_count <= RSU_FRAME_BUDGET,
                f"{unit_peak_count} of {RSU_FRAME_BUDGET}",
            ),
        ]


def _interval_check(when: str, reading: Reading | None) -> Check:
    promise = f"the interval follows the road within {INTERVAL_ERROR_LIMIT_FRAC:.0%} {when}"
    interval = None if reading is None else reading.advisory.interval
    if reading is None or interval is None:
        return Check(promise, False, "no interval was published")  # noqa: FBT003 - a record, not a switch
    true_mu = reading.base_friction_mu
    error_frac = interval.mu_new / true_mu - 1.0
    return Check(
        promise,
        abs(error_frac) <= INTERVAL_ERROR_LIMIT_FRAC,
        f"published {interval.mu_low:.3f} to {interval.mu_new:.3f}, true {WORN_FACTOR * true_mu:.3f} to {true_mu:.3f}, "
        f"error {error_frac:+.1%}",
    )


def _misfortune(event: PassageEnded) -> str:
    if event.drive_outcome != "completed":
        return event.drive_outcome
    return event.record.ending.value

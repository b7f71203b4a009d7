from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from roadgrip.errors import ConfigurationError
from roadgrip.records import (
    VEHICLE_FRAME_BUDGET,
    Accepted,
    Arrival,
    NotCounted,
    Outcome,
    Passage,
    Reason,
    Receipt,
    Rejected,
)
from roadgrip.section import RoadSection
from tests.vehicle_client.shell.air import BEND, SUMMARY, Ether, TokenCodec, Unit, bend
from tests.vehicle_client.shell.cars import Summarised, WireToUnit, a_drive
from vehicle_client.estimation.trace import Trace
from vehicle_client.shell.exchange import Ending, Exchange
from vehicle_client.shell.fleet import (
    FleetPlan,
    FleetTools,
    FrictionChange,
    draw_visits,
    parse_friction_change,
    patience_at,
    run_fleet,
    simulator,
)
from vehicle_client.shell.fleet_events import (
    FleetEvent,
    FleetReady,
    FleetReport,
    PassageEnded,
    VehicleAdvised,
    VehicleEntered,
)
from vehicle_client.shell.patience import Patience
from vehicle_client.shell.uplink import AirCounts, AirFaults, Uplink
from vehicle_client.simulator.drive import Drive, DriveOutcome
from vehicle_client.simulator.plan import PassagePlan, SensorGrade

FAST = 2000.0
BRISK = Patience(reply_s=60.0, longest_s=120.0, postpone_s=60.0)
"""30 ms on the wall for an answer that comes in the same process."""

A_RECORD = Exchange(passage_id=bytes(16), section_id="bend", codec=TokenCodec(Ether())).record()


def a_plan(vehicles_count: int = 10, *, faults: AirFaults | None = None) -> FleetPlan:
    return FleetPlan(
        section=BEND,
        vehicles_count=vehicles_count,
        base_friction_mu=0.45,
        changes=(FrictionChange(0.25, 0.5),),
        arrivals_per_hour=100.0,
        regular=True,
        speedup_ratio=FAST,
        faults=faults if faults is not None else AirFaults(),
        seed=7,
    )


def summarised(trace: Trace, section: RoadSection) -> Summarised | Rejected:
    assert section == BEND
    return Summarised(SUMMARY, left_at_s=float(trace.time_s[-1]) - 2.0)


def play(
    plan: FleetPlan,
    folder: Path,
    *,
    unit: Unit | None = None,
    lost: Callable[[int], tuple[type, ...]] = lambda _: (),
    simulate: Callable[[RoadSection, PassagePlan], Drive] = a_drive,
    summarise: Callable[[Trace, RoadSection], Summarised | Rejected] = summarised,
) -> tuple[FleetReport, list[FleetEvent], list[WireToUnit]]:
    """Run a fleet against a unit; the n-th uplink that is opened reaches it but for the messages `lost(n)`."""
    ether = Ether()
    the_unit = unit if unit is not None else Unit(TokenCodec(ether), frames_left_count=10_000)
    the_unit.codec.ether = ether
    events: list[FleetEvent] = []
    links: list[WireToUnit] = []

    async def open_uplink() -> Uplink:
        links.append(WireToUnit(the_unit, lost=lost(len(links))))
        return links[-1]

    report = asyncio.run(
        run_fleet(
            plan,
            FleetTools(
                open_uplink=open_uplink,
                open_codec=lambda _passage_id: TokenCodec(ether),
                simulate=simulate,
                summarise=summarise,
                patience=BRISK,
            ),
            spool_folder=folder,
            watch=events.append,
        )
    )
    return report, events, links


def test_every_vehicle_of_a_fleet_is_answered(tmp_path: Path):
    report, events, links = play(a_plan(), tmp_path)
    assert report.vehicles_count == report.accepted_count == report.counted_count == 10
    assert report.budget_peak_count == 2
    assert report.frames_sent_count == 20
    assert len(set(report.passage_ids)) == 10
    assert all(link.closed for link in links)
    kinds = [type(e) for e in events]
    assert kinds[0] is FleetReady
    assert kinds.count(VehicleEntered) == kinds.count(VehicleAdvised) == kinds.count(PassageEnded) == 10


def test_the_road_changes_when_the_plan_says(tmp_path: Path):
    _, events, _ = play(a_plan(), tmp_path)
    entered = sorted((e.number, e.base_friction_mu) for e in events if isinstance(e, VehicleEntered))
    assert [mu for _, mu in entered] == [0.45] * 5 + [0.25] * 5


def test_an_age_is_what_the_fleets_clock_says(tmp_path: Path):
    unit = Unit(TokenCodec(Ether()), frames_left_count=10_000)
    play(a_plan(2), tmp_path, unit=unit)
    ages = [m.age_s for m in unit.heard if hasattr(m, "age_s")]
    # Two seconds of exit road, and whatever this machine took to answer.
    assert len(ages) == 2
    assert all(2.0 <= age_s < 3600.0 for age_s in ages)


def test_an_age_counts_from_the_end_of_the_section_whatever_the_trace_calls_its_start(tmp_path: Path):
    def recorded_later(section: RoadSection, plan: PassagePlan) -> Drive:
        drive = a_drive(section, plan)
        return replace(drive, trace=replace(drive.trace, time_s=drive.trace.time_s + 10_000.0))

    def left_long_ago(trace: Trace, _section: RoadSection) -> Summarised:
        return Summarised(SUMMARY, left_at_s=float(trace.time_s[0]) - 20_000.0)

    unit = Unit(TokenCodec(Ether()), frames_left_count=10_000)
    play(a_plan(1), tmp_path, unit=unit, simulate=recorded_later, summarise=left_long_ago)
    (passage,) = [m for m in unit.heard if isinstance(m, Passage)]
    assert passage.age_s >= 20_000.0


def test_nobody_comes_before_his_time(tmp_path: Path):
    plan = a_plan(3)
    _, events, _ = play(plan, tmp_path)
    due_s = {visit.number: visit.arrives_at_s for visit in draw_visits(plan)}
    entered_s = {e.number: e.at_s for e in events if isinstance(e, VehicleEntered)}
    assert due_s == {0: pytest.approx(36.0), 1: pytest.approx(72.0), 2: pytest.approx(108.0)}
    assert all(entered_s[number] >= due_s[number] for number in due_s)


def test_lossy_air_costs_frames_but_no_passages(tmp_path: Path):
    faults = AirFaults(lost_frac=0.1, doubled_frac=0.1, delayed_frac=0.1, spoiled_frac=0.05)
    report, events, _ = play(a_plan(20, faults=faults), tmp_path)
    assert report.accepted_count == 20
    assert len({e.air.lost_count for e in events if isinstance(e, PassageEnded)}) > 1
    assert report.air.missing_count > 0
    assert report.retries_count > 0
    assert report.recovered_count == report.air.missing_count
    assert report.budget_peak_count <= VEHICLE_FRAME_BUDGET


def test_a_unit_that_was_away_gets_its_passages_from_the_spool(tmp_path: Path):
    report, events, links = play(a_plan(2), tmp_path, lost=lambda number: (Passage,) if number < 4 else ())
    assert report.vehicles_count == report.drives["completed"] == 2
    assert report.frames_sent_count == sum(len(link.sent) for link in links)
    assert report.spooled_count == 2
    assert report.delivered_late_count == 2
    assert report.accepted_count == 2
    assert report.waiting_count == 0
    assert [e.record.ending for e in events if isinstance(e, PassageEnded) and e.from_spool][-1] is Ending.ACCEPTED
    assert list(tmp_path.iterdir()) == []


def test_a_summary_that_waits_is_tried_again_before_the_next_vehicle_comes(tmp_path: Path):
    # Half an hour between two vehicles; the spool is tried every five minutes.
    plan = replace(a_plan(2), arrivals_per_hour=2.0)
    _, events, _ = play(plan, tmp_path, lost=lambda number: (Passage,) if number == 0 else ())
    told = [type(e) for e in events if isinstance(e, VehicleEntered | PassageEnded)]
    assert told == [VehicleEntered, PassageEnded, PassageEnded, VehicleEntered, PassageEnded]


def test_tries_beyond_the_first_are_counted_as_retries():
    ended = PassageEnded(
        number=0,
        at_s=0.0,
        base_friction_mu=0.4,
        friction_mu=0.4,
        drive_outcome="completed",
        record=replace(A_RECORD, arrival_tries_count=3, report_tries_count=2),
        air=AirCounts(),
    )
    report = FleetReport()
    report.add(ended)
    report.add(replace(ended, record=replace(A_RECORD, arrival_tries_count=0, report_tries_count=0)))
    assert report.retries_count == 2 + 1


def test_a_unit_that_stays_away_leaves_no_map_and_no_summary(tmp_path: Path):
    report, _, _ = play(a_plan(2), tmp_path, lost=lambda _: (Arrival, Passage))
    assert report.no_map_count == 2
    assert report.accepted_count == report.waiting_count == 0


def test_a_passage_whose_frames_are_used_up_is_given_up_and_counted(tmp_path: Path):
    report, events, _ = play(a_plan(1), tmp_path, lost=lambda _: (Passage,))
    # One announcement and five tries on the spot; the spool spends the other six two at a time.
    assert sum(isinstance(e, PassageEnded) and e.from_spool for e in events) == 3
    assert report.budget_peak_count == VEHICLE_FRAME_BUDGET
    assert report.frames_spent_count == 1
    assert report.accepted_count == report.waiting_count == 0


def test_every_frame_is_accounted_for_also_of_a_delivery_that_the_last_passage_interrupts(tmp_path: Path):
    # The last exchange ends at 966 s, while the round that began at 900 s tries ten summaries.
    report, _, links = play(a_plan(11), tmp_path, lost=lambda _: (Passage,))
    assert report.frames_sent_count == sum(len(link.sent) for link in links)
    assert report.budget_peak_count <= VEHICLE_FRAME_BUDGET


def test_a_receipt_that_ends_the_exchange_during_the_drive_ends_no_fleet(tmp_path: Path):
    class EarlyVerdict(Unit):
        def answer(self, frame: bytes, now_s: float) -> list[bytes]:
            replies = super().answer(frame, now_s)
            arrival = self.heard[-1]
            assert isinstance(arrival, Arrival)
            refusal = Receipt(arrival.passage_id, Rejected(Reason.STALE_MAP))
            return [*replies, *self.codec.frames_of(refusal)]

    report, _, _ = play(a_plan(2), tmp_path, unit=EarlyVerdict(TokenCodec(Ether())))
    assert dict(report.rejected) == {"stale_map": 2}


def test_a_drive_that_left_the_road_sends_no_summary(tmp_path: Path):
    def off_the_road(section: RoadSection, plan: PassagePlan) -> Drive:
        return a_drive(section, plan, outcome=DriveOutcome.LEFT_ROAD)

    report, _, _ = play(a_plan(2), tmp_path, simulate=off_the_road)
    assert dict(report.drives) == {"left_road": 2}
    assert dict(report.withheld) == {"passage_aborted": 2}


def test_what_the_pipeline_refuses_is_withheld_with_its_reason(tmp_path: Path):
    report, _, _ = play(a_plan(2), tmp_path, summarise=lambda _trace, _section: Rejected(Reason.TOO_MANY_GAPS))
    assert dict(report.withheld) == {"too_many_gaps": 2}


@pytest.mark.parametrize(
    ("outcome", "counted", "rejected", "not_counted"),
    [
        (Accepted(), 2, {}, {}),
        (Accepted(NotCounted.OUT_OF_ENVELOPE), 0, {}, {"out_of_envelope": 2}),
        (Rejected(Reason.STALE_MAP), 0, {"stale_map": 2}, {}),
    ],
)
def test_the_account_says_what_became_of_every_passage(
    tmp_path: Path, outcome: Outcome, counted: int, rejected: dict[str, int], not_counted: dict[str, int]
):
    unit = Unit(TokenCodec(Ether()), outcomes=[outcome], frames_left_count=1000)
    report, _, _ = play(a_plan(2), tmp_path, unit=unit)
    assert report.counted_count == counted
    assert dict(report.rejected) == rejected
    assert dict(report.not_counted) == not_counted


def test_a_map_for_another_section_is_not_taken(tmp_path: Path):
    unit = Unit(TokenCodec(Ether()), section=bend("elsewhere"), frames_left_count=1000)
    report, _, _ = play(a_plan(1), tmp_path, unit=unit)
    assert report.no_map_count == 1


def test_a_simulator_that_fails_ends_the_fleet_with_its_error(tmp_path: Path):
    def broken(section: RoadSection, plan: PassagePlan) -> Drive:
        raise ConfigurationError("no road")

    with pytest.raises(ConfigurationError, match="no road"):
        play(a_plan(2), tmp_path, simulate=broken)


def test_a_simulator_that_fails_later_ends_the_fleet_too(tmp_path: Path):
    calls = iter([True, True, False])

    def breaking(section: RoadSection, plan: PassagePlan) -> Drive:
        if next(calls, False):
            return a_drive(section, plan)
        raise ConfigurationError("no road any more")

    with pytest.raises(ConfigurationError, match="no road any more"):
        play(a_plan(4), tmp_path, simulate=breaking)


def test_the_same_seed_brings_the_same_vehicles():
    assert draw_visits(a_plan()) == draw_visits(a_plan())


def test_the_latest_change_of_friction_holds_in_whatever_order_they_were_given():
    changes = (FrictionChange(0.2, 0.75), FrictionChange(0.3, 0.25))
    for given in (changes, changes[::-1]):
        plan = replace(a_plan(8), changes=given)
        assert [plan.base_friction_of(number) for number in range(8)] == [0.45] * 2 + [0.3] * 4 + [0.2] * 2


def test_vehicles_on_a_fast_clock_wait_as_long_on_the_wall_as_a_unit_needs():
    assert patience_at(1.0) == Patience()
    assert patience_at(100.0).reply_s / 100.0 == pytest.approx(0.15)


def test_random_arrivals_come_at_the_rate_that_was_asked_for():
    plan = FleetPlan(
        BEND, vehicles_count=3000, base_friction_mu=0.4, arrivals_per_hour=120.0, grade=SensorGrade.IDEAL, seed=1
    )
    times_s = np.array([v.arrives_at_s for v in draw_visits(plan)])
    gaps_s = np.diff(times_s)
    # Poisson arrivals: mean and standard deviation of the gaps agree; 3000 of them tell both within 6 %.
    assert gaps_s.mean() == pytest.approx(30.0, rel=0.06)
    assert gaps_s.std() == pytest.approx(30.0, rel=0.08)


def test_a_change_of_friction_is_read_as_people_write_it():
    assert parse_friction_change("0.25@0.5") == FrictionChange(0.25, 0.5)


@pytest.mark.parametrize("text", ["", "0.25", "0.25@", "0@0.5", "0.3@1.5", "-1@0.2", "a@b", "nan@0.5"])
def test_what_is_no_change_of_friction_is_refused_with_an_example(text: str):
    with pytest.raises(ConfigurationError, match=r"0\.25@0\.5"):
        parse_friction_change(text)


def test_a_client_without_the_simulator_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "vehicle_client.simulator.run", None)
    with pytest.raises(ConfigurationError, match=r"roadgrip\[sim\]"):
        simulator()

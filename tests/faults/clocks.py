"""Units whose wall clock is wrong, steps, or does what calendars make clocks do."""

from __future__ import annotations

import time
from datetime import UTC, datetime

from roadgrip.records import AdvisoryNotice, Arrival
from rsu_app.usecases.readiness import STEP_TOLERANCE_S
from tests.faults.machine import Machine
from tests.faults.remains import judge, remains_of
from tests.faults.scenario import Finding, Scenario, Stage
from tests.faults.traffic import SECTION_ID, Traffic, heard_after, section_of
from tests.faults.units import FragileUnit

HOUR_S = 3_600.0
BATCH_COUNT = 15
STEPS_COUNT = 4
AUTUMN_UNIX_S = datetime(2026, 10, 25, 1, 0, 0, tzinfo=UTC).timestamp()
"""When clocks in most of Europe go back by an hour."""
LEAP_STEP_S = -1.0
"""A clock without a second 60 shows second 59 twice: it goes back by one."""


def clock_at_1970(stage: Stage) -> Finding:
    """Start a unit whose clock has lost the date, and give it the date later; then start it without the date again."""
    found = Finding(runs_count=1)
    machine = _machine(stage, at_unix_s=stage.chance.uniform(0.0, 1e6))
    with FragileUnit(machine.folder, machine=machine, broken=stage.broken) as unit:
        traffic = Traffic(section_of(unit), first_number=stage.chance.randrange(100_000))
        _drive(found, unit, traffic)
        _expect_doubted_clock(found, unit, because="before 2024")
        _expect_issued(found, unit, traffic, at_unix_s=0)
        machine.set(wall_offset_ns=0)
        _drive(found, unit, traffic)
        _expect_doubted_clock(found, unit, because="stepped")
        _expect_issued(found, unit, traffic, at_unix_s=round(time.time()))
        unit.kill()
    stored = remains_of(unit.database)
    judge(found, stored, traffic.acknowledged)
    machine.set(wall_offset_ns=_offset_ns(stage.chance.uniform(0.0, 1e6)))
    with FragileUnit(machine.folder, machine=machine, broken=stage.broken) as unit:
        found.expect(unit.window_count() == 0, "a unit without the date knows how old its passages are")
        machine.set(wall_offset_ns=0)
        # Received in 1970, the first half has no age that anybody knows; the second half counts again.
        wanted_count = sum(row.received_unix_s > 1e9 for row in unit.stored())
        back = _until_count(unit, wanted_count)
        found.expect(back, f"{unit.window_count()} of {wanted_count} count once the date is known")
    found.acknowledged_count = len(traffic.acknowledged)
    stage.tell(1)
    return found


def clock_steps(stage: Stage) -> Finding:
    """Let the clock of a unit step by hours both ways, and start it again with one that has gone back."""
    chance, found = stage.chance, Finding(runs_count=1)
    machine = _machine(stage)
    with FragileUnit(machine.folder, machine=machine, broken=stage.broken) as unit:
        traffic = Traffic(section_of(unit), first_number=chance.randrange(100_000))
        _drive(found, unit, traffic)
        for number in range(STEPS_COUNT):
            step_s = (1, -1)[number % 2] * chance.uniform(2.0 * STEP_TOLERANCE_S, 12.0 * HOUR_S)
            machine.set(wall_offset_ns=machine.get("wall_offset_ns") + round(step_s * 1e9))
            _expect_doubted_clock(found, unit, because="stepped")
            _drive(found, unit, traffic)
        seen = unit.metric("roadgrip_clock_steps_total")
        found.expect(seen >= STEPS_COUNT, f"{STEPS_COUNT} steps, the metric knows of {seen:.0f}")
        unit.kill()
    judge(found, remains_of(unit.database), traffic.acknowledged)
    machine.set(wall_offset_ns=machine.get("wall_offset_ns") - round(chance.uniform(1.5, 12.0) * HOUR_S * 1e9))
    with FragileUnit(machine.folder, machine=machine, broken=stage.broken) as unit:
        future = sum(row.left_unix_s > machine.now_unix_s() for row in unit.stored())
        allowed_count = len(unit.stored()) - future
        found.expect(unit.window_count() <= allowed_count, "passages from the future count")
    found.acknowledged_count = len(traffic.acknowledged)
    stage.tell(1)
    return found


def leap_second(stage: Stage) -> Finding:
    """Let the clock show a second twice."""
    found = Finding(runs_count=1)
    machine = _machine(stage)
    with FragileUnit(machine.folder, machine=machine, broken=stage.broken) as unit:
        traffic = Traffic(section_of(unit), first_number=stage.chance.randrange(100_000))
        _drive(found, unit, traffic)
        machine.set(wall_offset_ns=machine.get("wall_offset_ns") + round(LEAP_STEP_S * 1e9))
        _drive(found, unit, traffic)
        _expect_calm(found, unit)
    found.acknowledged_count = len(traffic.acknowledged)
    stage.tell(1)
    return found


def daylight_saving(stage: Stage) -> Finding:
    """Let the hour in which clocks go back begin while a unit that keeps local time works."""
    found = Finding(runs_count=1)
    machine = _machine(stage, at_unix_s=AUTUMN_UNIX_S - 4.0)
    with FragileUnit(machine.folder, machine=machine, broken=stage.broken, time_zone="Europe/Oslo") as unit:
        traffic = Traffic(section_of(unit), first_number=stage.chance.randrange(100_000))
        _drive(found, unit, traffic)
        while machine.now_unix_s() < AUTUMN_UNIX_S + 0.5:
            time.sleep(0.1)
        _drive(found, unit, traffic)
        _expect_calm(found, unit)
        moments = [line["at"] for line in unit.lines()]
        found.expect(moments == sorted(moments), "the times of the log go back")
        received = [row.received_unix_s for row in unit.stored()]
        found.expect(max(received) - min(received) < HOUR_S / 2, "times in the database are an hour apart")
    found.acknowledged_count = len(traffic.acknowledged)
    stage.tell(1)
    return found


def _machine(stage: Stage, *, at_unix_s: float | None = None) -> Machine:
    folder = stage.folder / "unit"
    folder.mkdir()
    machine = Machine(folder, stage.folder)
    if at_unix_s is not None:
        machine.set(wall_offset_ns=_offset_ns(at_unix_s))
    return machine


def _offset_ns(at_unix_s: float) -> int:
    return round((at_unix_s - time.time()) * 1e9)


def _drive(found: Finding, unit: FragileUnit, traffic: Traffic) -> None:
    """Let vehicles come, and look whether each counts, as young as it is, and nobody else has gone."""
    before = unit.window_count()
    known = set(traffic.acknowledged)
    with traffic.driving(unit, http=False):
        reached = traffic.wait_for(len(known) + BATCH_COUNT)
    found.expect(reached, "nothing is acknowledged")
    interval = unit.client.get(f"/v1/sections/{SECTION_ID}/friction").json()["interval"]
    fresh_count = len(set(traffic.acknowledged) - known)
    count = 0 if interval is None else interval["passages_count"]
    found.expect(count >= before + fresh_count, f"{before} counted, {fresh_count} came, {count} count")
    age_s = None if interval is None else interval["newest_age_s"]
    found.expect(age_s is not None and 0.0 <= age_s < 60.0, f"the newest is {age_s} s old")
    found.problems += traffic.strange
    traffic.strange.clear()


def _expect_doubted_clock(found: Finding, unit: FragileUnit, *, because: str) -> None:
    ok, detail = unit.conditions()["clock"]
    found.expect(not ok and because in detail, f"readiness says of the clock: {detail}")
    metric = unit.metric("roadgrip_condition_ok", condition="clock")
    found.expect(metric == 0.0, "the metric says that the clock is well")


def _expect_calm(found: Finding, unit: FragileUnit) -> None:
    ok, detail = unit.conditions()["clock"]
    found.expect(ok, f"readiness says of the clock: {detail}")
    found.expect(unit.client.get("/health/ready").status_code == 200, "the unit is not ready")


def _expect_issued(found: Finding, unit: FragileUnit, traffic: Traffic, *, at_unix_s: int) -> None:
    """Look whether what vehicles are sent says when it was made, or that nobody knows: zero."""
    arrival = Arrival(b"arriving" + bytes(8), SECTION_ID)
    issued = [
        m.issued_unix_s for m in heard_after(unit, arrival, section=traffic.section) if isinstance(m, AdvisoryNotice)
    ]
    found.expect(issued, "an arriving vehicle is not advised")
    found.expect(all(abs(told - at_unix_s) < 60 for told in issued), f"issued at {issued}, not {at_unix_s}")


def _until_count(unit: FragileUnit, count: int, *, seconds: float = 40.0) -> bool:
    give_up_s = time.monotonic() + seconds
    while unit.window_count() < count:
        if time.monotonic() > give_up_s:
            return False
        time.sleep(0.1)
    return True


SCENARIOS = (
    Scenario(
        name="clock-at-1970",
        promise="A unit without the date takes passages and counts them by its monotonic clock, says in readiness and "
        "metrics that the clock is not to be believed, and sends times as unknown; once it has the date it says that, "
        "too, and has back of its memory what was stored with a date.",
        conditions="wall clock at a random moment of January 1970, then right; again at a start after SIGKILL",
        runs_count=5,
        perform=clock_at_1970,
        controls=("the window goes by the wall clock", "every clock is believed"),
    ),
    Scenario(
        name="clock-steps",
        promise="The window stays right by monotonic time, no passage is lost from it or ages by a step, and "
        "readiness and "
        "metrics tell of each step; after a start with a clock that went back nothing from the future counts.",
        conditions="four steps of up to twelve hours, forwards and back in turn, with traffic after each; "
        "SIGKILL; start "
        "with a clock 1.5 to 12 h further back",
        runs_count=5,
        perform=clock_steps,
        controls=("the window goes by the wall clock", "every clock is believed"),
    ),
    Scenario(
        name="leap-second",
        promise="Nothing happens: the unit stays ready and the window right.",
        conditions="the wall clock goes back by a second, as a clock without a second 60 does",
        runs_count=5,
        perform=leap_second,
        controls=("a second is a step",),
    ),
    Scenario(
        name="daylight-saving",
        promise="Nothing happens: the unit stays ready, the window right, and all times in log and database go on.",
        conditions="time zone Europe/Oslo, the wall clock running over 01:00 UTC on 25 October 2026",
        runs_count=2,
        perform=daylight_saving,
        controls=("times are local",),
    ),
)

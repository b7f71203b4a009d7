"""Units whose disk refuses to work for a while: full, read-only, or failing."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from roadgrip.records import AdvisoryNotice, Arrival
from tests.faults.machine import Machine
from tests.faults.remains import judge, remains_of
from tests.faults.scenario import Finding, Scenario, Stage
from tests.faults.traffic import SECTION_ID, Traffic, heard_after, section_of
from tests.faults.units import DATABASE_NAME, FragileUnit

PATIENCE_S = 40.0
"""A unit that could not open its database tries again every five seconds and reads its window every ten."""
BEFORE_COUNT, AFTER_COUNT = 30, 20


@dataclass(frozen=True)
class DiskFault:
    """What a disk does.

    Attributes:
        control: Fields of the machine's control block.
        refuses_writes: Whether no passage can be stored meanwhile.
    """

    control: Mapping[str, int]
    refuses_writes: bool = True


FULL = DiskFault({"room_bytes": 0})
READ_ONLY = DiskFault({"write_errno": errno.EROFS, "sync_errno": errno.EROFS, "open_errno": errno.EROFS})
WRITES_FAIL = DiskFault({"write_errno": errno.EIO, "open_errno": errno.EIO})
SYNCS_FAIL = DiskFault({"sync_errno": errno.EIO})
READS_FAIL = DiskFault({"read_errno": errno.EIO}, refuses_writes=False)


def suffering(fault: DiskFault) -> Callable[[Stage], Finding]:
    """Return the scenario of a disk that does so under load, later again while the unit starts, and gets well twice."""

    def perform(stage: Stage) -> Finding:
        chance, found = stage.chance, Finding(runs_count=1)
        folder = stage.folder / "unit"
        folder.mkdir()
        # Settings and bundle lie elsewhere on a unit that can lose the one without the other.
        machine = Machine(folder, stage.folder, beginning=DATABASE_NAME)
        with FragileUnit(folder, machine=machine, broken=stage.broken) as unit:
            traffic = Traffic(section_of(unit), first_number=chance.randrange(100_000))
            with traffic.driving(unit):
                found.expect(traffic.wait_for(BEFORE_COUNT), "nothing was acknowledged before the fault")
                time.sleep(chance.uniform(0.0, 0.3))
                _fall_ill(found, fault, unit, machine, traffic)
                _get_well(found, unit, machine, traffic)
            unit.kill()
        judge(found, remains_of(unit.database), traffic.acknowledged)
        _start_ill(found, stage, fault, machine, traffic)
        found.acknowledged_count = len(traffic.acknowledged)
        found.problems += traffic.strange
        found.expect(machine.refused_count, "the disk refused nothing")
        stage.tell(1)
        return found

    return perform


def _fall_ill(found: Finding, fault: DiskFault, unit: FragileUnit, machine: Machine, traffic: Traffic) -> None:
    counted_before = unit.window_count()
    refused_before = traffic.refused.total()
    machine.set(**fault.control)
    if fault.refuses_writes:
        refused = _until(lambda: traffic.refused.total() >= refused_before + 5, PATIENCE_S)
        found.expect(refused, "nobody was refused while nothing could be stored")
        _expect_unready(found, unit)
    else:
        time.sleep(0.5)
    _expect_answers(found, unit, traffic, at_least_count=counted_before)


def _expect_unready(found: Finding, unit: FragileUnit) -> None:
    answer = unit.client.get("/health/ready")
    store = unit.conditions()["store"]
    found.expect(answer.status_code == 503 and not store[0] and store[1], f"readiness says {answer.text}")
    found.expect(unit.metric("roadgrip_ready") == 0.0, "the metric says that the unit is ready")
    found.expect(
        unit.metric("roadgrip_condition_ok", condition="store") == 0.0, "the metric says that the store is well"
    )


def _expect_answers(found: Finding, unit: FragileUnit, traffic: Traffic, *, at_least_count: int) -> None:
    """Look whether the unit answers from memory, by radio and over HTTP."""
    found.expect(unit.window_count() >= at_least_count, f"{unit.window_count()} count, {at_least_count} did before")
    for place in ("advisory", "map", "friction"):
        status = unit.client.get(f"/v1/sections/{SECTION_ID}/{place}").status_code
        found.expect(status == 200, f"{place} is answered with {status}")
    found.expect(unit.client.get("/metrics").status_code == 200, "there are no metrics")
    arrival = Arrival(b"arriving" + bytes(8), SECTION_ID)
    notices = [m for m in heard_after(unit, arrival, section=traffic.section) if isinstance(m, AdvisoryNotice)]
    found.expect(notices, "an arriving vehicle is not advised")


def _get_well(found: Finding, unit: FragileUnit, machine: Machine, traffic: Traffic) -> None:
    machine.whole()
    began_s = time.monotonic()
    wanted_count = len(traffic.acknowledged) + AFTER_COUNT
    found.expect(traffic.wait_for(wanted_count, seconds=PATIENCE_S), "nothing is acknowledged after the fault")
    found.expect(_until(lambda: unit.conditions()["store"][0], PATIENCE_S), "the store is not ready after the fault")
    found.figures["recovery_s"] = round(time.monotonic() - began_s, 1)
    found.expect(unit.process.poll() is None, "the unit ended")


def _start_ill(found: Finding, stage: Stage, fault: DiskFault, machine: Machine, traffic: Traffic) -> None:
    """Start the unit on the ill disk: it must serve, say what is wrong, and have its memory back once the disk "
    "works."""
    machine.set(**fault.control)
    with FragileUnit(machine.folder, machine=machine, broken=stage.broken) as unit:
        if unit.conditions()["store"][0] and fault.refuses_writes:
            found.problems.append("started on an ill disk it calls its store ready")
        _expect_answers(found, unit, traffic, at_least_count=0)
        machine.whole()
        found.expect(_until(lambda: unit.conditions()["store"][0], PATIENCE_S), "the store never opened")
        stored = set(unit.stored_ids())
        back = _until(lambda: unit.window_count() >= len(stored), PATIENCE_S)
        found.expect(back, f"{unit.window_count()} of {len(stored)} count after the disk got well")
        found.duplicated_count += max(0, unit.window_count() - len(stored))
        with traffic.driving(unit):
            wanted_count = len(traffic.acknowledged) + AFTER_COUNT
            found.expect(traffic.wait_for(wanted_count, seconds=PATIENCE_S), "nothing is acknowledged any more")
        moved = [path.name for path in machine.folder.glob("*.damaged-*")]
        found.expect(not moved, f"a sound database was moved aside: {moved}")
    judge(found, remains_of(unit.database), traffic.acknowledged)


def _until(condition: Callable[[], bool], seconds: float) -> bool:
    give_up_s = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > give_up_s:
            return False
        time.sleep(0.05)
    return True


_PROMISE = (
    "The unit goes on answering from memory, by radio and over HTTP, refuses passages with a reason, says so in "
    "readiness "
    "and metrics, and stores again without a restart; started meanwhile, it serves and reads its memory later; nothing "
    "acknowledged is lost"
)


def _scenario(name: str, what: str, fault: DiskFault, *controls: str, promise: str = _PROMISE) -> Scenario:
    return Scenario(
        name=name,
        promise=promise + ".",
        conditions=f"{what}, under load at a random instant and again during a start, by a layer between SQLite and "
        "the kernel; SIGKILL in between",
        runs_count=5,
        perform=suffering(fault),
        controls=controls,
    )


SCENARIOS = (
    _scenario("disk-full", "no file can grow (ENOSPC)", FULL, "a failed write is called stored", "readiness is polite"),
    _scenario(
        "disk-read-only", "every write, fsync and open for writing gives EROFS", READ_ONLY, "readiness is polite"
    ),
    _scenario("disk-write-errors", "every write and open for writing gives EIO", WRITES_FAIL, "readiness is polite"),
    _scenario("disk-fsync-errors", "every fsync gives EIO", SYNCS_FAIL, "a failed write is called stored"),
    _scenario(
        "disk-read-errors",
        "every read of a file gives EIO",
        READS_FAIL,
        "what cannot be read is called damaged",
        "no second attempt",
        promise="The unit goes on answering from memory, by radio and over HTTP; started meanwhile, it serves "
        "and reads "
        "its memory later; a database that cannot be read just now is not taken for damaged; nothing "
        "acknowledged is lost",
    ),
)

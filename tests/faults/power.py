"""Units whose power goes: everything that was not made to last may be gone, or half of it, or torn."""

from __future__ import annotations

import errno
import random
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from tests.faults.machine import Machine
from tests.faults.power_cut import boundaries, cuts, restore, within_copying
from tests.faults.remains import judge, opened
from tests.faults.scenario import Finding, Scenario, Stage
from tests.faults.traffic import Traffic, section_of
from tests.faults.units import DATABASE_NAME, FragileUnit

CUTS_PER_RECORDING_COUNT = 125
SYNC_DELAY_US = 2_000
"""What a flash card takes; with none, commits would be so short that few cuts fall into one."""
LIFE_PASSAGES_COUNT = 120
SYNC_FAILS_S = (0.05, 0.4)


def power_cuts(stage: Stage) -> Finding:
    """Record two lives of a unit under load, one of them ended by a kill, and cut the power at random moments."""
    chance = stage.chance
    machine, folder = _machine(stage)
    traffic: Traffic | None = None
    for life in range(2):
        with FragileUnit(folder, machine=machine, broken=stage.broken, small_log=True) as unit:
            traffic = traffic or _traffic(unit, machine, chance)
            with traffic.driving(unit):
                traffic.wait_for((life + 1) * LIFE_PASSAGES_COUNT)
                unit.kill()
    assert traffic is not None
    return _cut_and_look(stage, machine, traffic, chance)


def power_cuts_after_failed_syncs(stage: Stage) -> Finding:
    """Record two lives of a unit under load whose `fsync` fails now and then, and cut the power at random moments.

    It fails when the first life is ended by a kill, too: the second begins with a log that is not on the disk.
    """
    chance = stage.chance
    machine, folder = _machine(stage)
    traffic: Traffic | None = None
    for last_life in (False, True):
        with FragileUnit(folder, machine=machine, broken=stage.broken, small_log=True) as unit:
            traffic = traffic or _traffic(unit, machine, chance)
            with traffic.driving(unit):
                for _ in range(1 if last_life else 2):
                    traffic.wait_for(len(traffic.acknowledged) + LIFE_PASSAGES_COUNT // 3)
                    _fail_to_sync(machine, chance)
                    machine.whole()
                traffic.wait_for(len(traffic.acknowledged) + LIFE_PASSAGES_COUNT // 3)
                if not last_life:
                    _fail_to_sync(machine, chance)
                unit.kill()
        machine.whole()
    assert traffic is not None
    finding = _cut_and_look(stage, machine, traffic, chance)
    finding.expect(machine.refused_count, "no call of fsync failed")
    finding.expect(traffic.refused["store_unavailable"], "nobody was refused while fsync failed")
    return finding


def _fail_to_sync(machine: Machine, chance: random.Random) -> None:
    machine.set(sync_errno=errno.EIO)
    time.sleep(chance.uniform(*SYNC_FAILS_S))


def _machine(stage: Stage) -> tuple[Machine, Path]:
    folder = stage.folder / "unit"
    folder.mkdir()
    machine = Machine(folder, stage.folder, recorded=True)
    machine.set(sync_delay_us=SYNC_DELAY_US)
    return machine, machine.folder


def _traffic(unit: FragileUnit, machine: Machine, chance: random.Random) -> Traffic:
    # The log has at least this length when a receipt comes: a cut from here on must not take the passage.
    return Traffic(section_of(unit), first_number=chance.randrange(100_000), moment=lambda: machine.recorded_bytes)


def _cut_and_look(stage: Stage, machine: Machine, traffic: Traffic, chance: random.Random) -> Finding:
    """Cut the power at random moments of a recording, and look at what is left each time."""
    log = machine.log_path.read_bytes()
    known = sorted(boundaries(log))
    dangerous = within_copying(log) or known
    count = min(stage.runs_count, CUTS_PER_RECORDING_COUNT)
    moments = [*(chance.choice(chance.choice((known, dangerous))) for _ in range(count - 1)), known[-1]]
    found = Finding(acknowledged_count=len(traffic.acknowledged), problems=list(traffic.strange))
    found.figures["log_calls"] = len(known)
    for moment, files in cuts(log, moments, chance=chance):
        acknowledged = [passage_id for passage_id, told_at in traffic.acknowledged.items() if told_at <= moment]
        with tempfile.TemporaryDirectory() as place:
            restore(files, folder=machine.folder, into=Path(place), beginning=DATABASE_NAME)
            left = opened(Path(place, DATABASE_NAME))
        judge(found, left, acknowledged)
        found.runs_count += 1
        stage.tell(1)
        last = files
    found.problems += _start_again(stage, machine.folder, last, traffic)
    return found


def _start_again(stage: Stage, folder: Path, files: Mapping[str, bytes], traffic: Traffic) -> list[str]:
    """Return what is wrong with a unit that starts where the last cut left it."""
    place = stage.folder / "again"
    place.mkdir()
    restore(dict(files), folder=folder, into=place, beginning=DATABASE_NAME)
    with FragileUnit(place) as unit:
        stored_count = len(unit.stored_ids())
        if unit.restored_count == unit.window_count() == stored_count >= len(traffic.acknowledged):
            return []
        return [f"{stored_count} are stored after the last cut, {unit.restored_count} were restored"]


SCENARIOS = (
    Scenario(
        name="power-cut",
        promise="No acknowledged passage is lost, the database is whole, and the unit starts with what was stored.",
        conditions="the last moments of two lives under load, one ended by SIGKILL: every write and fsync "
        "recorded, then "
        "power cut at random calls; each unsynced page there, not there or torn by sectors, each unsynced name too; "
        "the log emptied every 40 pages, so that cuts meet it",
        runs_count=500,
        perform=power_cuts,
        controls=("synchronous = OFF", "synchronous = NORMAL", "acknowledge before the commit"),
    ),
    Scenario(
        name="power-cut-after-failed-fsync",
        promise="What an fsync that failed did not make last is never counted on later: nothing acknowledged before, "
        "meanwhile or after is lost in a later power cut.",
        conditions="as power-cut, while fsync fails with EIO three times for up to 0.4 s, the last time until SIGKILL, "
        "and once in the life that follows; pages of a failed fsync count as clean and are lost, as Linux has it; "
        "every other cut while the log is copied behind an fsync that succeeded after one that failed",
        runs_count=1_500,
        perform=power_cuts_after_failed_syncs,
        controls=("the log is read back after a failure", "the log is worked in as it is", "synchronous = NORMAL"),
    ),
)

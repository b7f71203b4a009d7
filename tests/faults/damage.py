"""Units whose database, or its log, is not what they left."""

from __future__ import annotations

import random
import struct
import time
from collections.abc import Callable
from pathlib import Path

from tests.faults.remains import judge, remains_of
from tests.faults.scenario import Finding, Scenario, Stage
from tests.faults.traffic import Traffic, section_of
from tests.faults.units import FragileUnit

PAGE_BYTES, LOG_HEAD_BYTES = 4096, 32
FRAME_BYTES = 24 + PAGE_BYTES
LOGGED_COUNT = 5
"""Commits that a log holds before it is spoilt between the first and the last."""
FILLED_COUNT = 60


def damaged_database(stage: Stage) -> Finding:
    """Spoil a database between two starts."""
    chance, found = stage.chance, Finding(runs_count=1)
    traffic, database = _filled(stage, found, killed=False)
    spoilt = _spoil_database(database, chance)
    with FragileUnit(stage.folder, broken=stage.broken) as unit:
        _expect_alarm(found, unit, spoilt)
        found.expect(unit.restored_count == 0, "something was restored from a damaged database")
        (first,) = unit.rows("SELECT reason, evidence_json FROM ledger ORDER BY sequence_number LIMIT 1")
        found.expect("damaged" in str(first), f"the ledger begins with {first}")
        _expect_service(found, unit, traffic)
    stage.tell(1)
    return found


def damaged_log(stage: Stage) -> Finding:
    """Spoil the log of a unit that was killed, where it holds commits that are not the last."""
    chance, found = stage.chance, Finding(runs_count=1)
    traffic, database = _filled(stage, found, killed=True)
    log = database.with_name(database.name + "-wal")
    spoilt, whole_count = _spoil_log(log, chance)
    readable = set(remains_of(database).ids)
    with FragileUnit(stage.folder, broken=stage.broken) as unit:
        _expect_alarm(found, unit, spoilt)
        kept = set(unit.stored_ids())
        found.expect(kept in (readable, set()), f"{len(kept)} are kept, {len(readable)} of {whole_count} can be read")
        found.expect(unit.restored_count == unit.window_count() == len(kept), "what is kept does not count")
        _expect_service(found, unit, traffic)
    stage.tell(1)
    return found


def torn_log(stage: Stage) -> Finding:
    """Cut off or spoil the very end of a log, as a power cut does to a commit that was not acknowledged."""
    chance, found = stage.chance, Finding(runs_count=1)
    traffic, database = _filled(stage, found, killed=True)
    log = database.with_name(database.name + "-wal")
    content = log.read_bytes()
    # Something that was begun and never committed: frames behind the last commit, all but their beginning missing.
    tail = content[-FRAME_BYTES:][: chance.randrange(24, FRAME_BYTES)]
    log.write_bytes(content + tail)
    with FragileUnit(stage.folder, broken=stage.broken) as unit:
        moved = [path.name for path in stage.folder.glob("*.damaged-*")]
        found.expect(not moved, f"moved aside for a torn end: {moved}")
        judge(found, remains_of(unit.database), traffic.acknowledged)
        found.expect(unit.restored_count >= len(traffic.acknowledged), f"{unit.restored_count} were restored")
        _expect_service(found, unit, traffic)
    found.acknowledged_count = len(traffic.acknowledged)
    stage.tell(1)
    return found


def damaged_in_service(stage: Stage) -> Finding:
    """Spoil the database of a unit that runs."""
    chance, found = stage.chance, Finding(runs_count=1)
    with FragileUnit(stage.folder, broken=stage.broken, small_log=True) as unit:
        traffic = Traffic(section_of(unit), first_number=chance.randrange(100_000))
        with traffic.driving(unit):
            found.expect(traffic.wait_for(4 * FILLED_COUNT), "nothing was acknowledged")
        counted = unit.window_count()
        log = unit.database.with_name(unit.database.name + "-wal")
        # As if a card had lost its blocks, with the unit's cache still whole.
        for path, kept_bytes in ((unit.database, PAGE_BYTES), (log, LOG_HEAD_BYTES)):
            size_bytes = path.stat().st_size
            with path.open("r+b") as file:
                file.seek(kept_bytes)
                file.write(chance.randbytes(max(0, size_bytes - kept_bytes)))
        # The unit's own cache holds what it needs to write; whoever asks for the metrics reads the file.
        moved = _until_moved_aside(unit)
        with traffic.driving(unit):
            again = traffic.wait_for(len(traffic.acknowledged) + FILLED_COUNT)
        found.expect(again, "nothing is stored any more")
        found.expect(unit.window_count() >= counted, "the window forgot what it knew")
        found.expect(moved, "nothing was moved aside")
        _expect_told(found, unit)
    stage.tell(1)
    return found


def _until_moved_aside(unit: FragileUnit, *, seconds: float = 30.0) -> bool:
    """Return whether a damaged database lies beside the unit's in time, while its metrics are asked for."""
    give_up_s = time.monotonic() + seconds
    while time.monotonic() < give_up_s:
        if list(unit.folder.glob("*.damaged-*")):
            return True
        unit.client.get("/metrics")
        time.sleep(0.2)
    return False


def _filled(stage: Stage, found: Finding, *, killed: bool) -> tuple[Traffic, Path]:
    with FragileUnit(stage.folder) as unit:
        traffic = Traffic(section_of(unit), first_number=stage.chance.randrange(100_000))
        with traffic.driving(unit):
            found.expect(traffic.wait_for(FILLED_COUNT), "nothing was acknowledged before the fault")
            if killed:
                log = unit.database.with_name(unit.database.name + "-wal")
                # What arrives together shares a commit, however many that are.
                while len(_commits(log.read_bytes())) < LOGGED_COUNT:
                    found.expect(traffic.wait_for(len(traffic.acknowledged) + 1), "nothing more was acknowledged")
                unit.kill()
        if not killed:
            unit.stop()
    return traffic, unit.database


def _spoil_database(database: Path, chance: random.Random) -> bytes:
    content = bytearray(database.read_bytes())
    pages_count = len(content) // PAGE_BYTES

    def head() -> None:
        content[:100] = bytes(100)

    def pages() -> None:
        for page in chance.sample(range(1, pages_count), pages_count // 2):
            content[page * PAGE_BYTES : (page + 1) * PAGE_BYTES] = chance.randbytes(PAGE_BYTES)

    def half() -> None:
        del content[pages_count // 2 * PAGE_BYTES :]

    def noise() -> None:
        content[:] = chance.randbytes(len(content))

    chance.choice((head, pages, half, noise))()
    database.write_bytes(content)
    return bytes(content)


def _spoil_log(log: Path, chance: random.Random) -> tuple[bytes, int]:
    """Return what the log is now, and how many commits it had."""
    content = bytearray(log.read_bytes())
    ends = _commits(bytes(content))
    if chance.random() < 0.3:
        content[chance.randrange(LOG_HEAD_BYTES)] ^= 0xFF
    else:
        # Behind the first, before the last but two: what comes after can be seen to have been committed.
        frame = chance.randrange(ends[0] + 1, ends[-3])
        at = LOG_HEAD_BYTES + frame * FRAME_BYTES + chance.randrange(FRAME_BYTES)
        content[at] ^= 1 << chance.randrange(8)
    log.write_bytes(content)
    return bytes(content), len(ends)


def _commits(content: bytes) -> list[int]:
    """Return the numbers of the frames that end a commit."""
    count = (len(content) - LOG_HEAD_BYTES) // FRAME_BYTES
    sizes = (struct.unpack_from(">I", content, LOG_HEAD_BYTES + n * FRAME_BYTES + 4)[0] for n in range(count))
    return [number for number, size in enumerate(sizes) if size]


def _expect_alarm(found: Finding, unit: FragileUnit, spoilt: bytes) -> None:
    kept = [path for path in unit.folder.glob("*.damaged-*") if path.read_bytes() == spoilt]
    found.expect(kept, f"what was spoilt was not moved aside: {[p.name for p in unit.folder.iterdir()]}")
    for path in kept:
        stamp = path.name.partition(".damaged-")[2]
        found.expect(stamp[:8].isdigit() and "T" in stamp, f"{path.name} has no time in its name")
    _expect_told(found, unit)


def _expect_told(found: Finding, unit: FragileUnit) -> None:
    _, detail = unit.conditions()["store"]
    found.expect("damaged" in detail, f"readiness says {detail!r}")
    found.expect(unit.metric("roadgrip_store_damaged_kept") >= 1.0, "the metric knows of no damaged database")
    alarms = [line for line in unit.lines() if "damaged" in str(line) and line["level"] in {"error", "critical"}]
    found.expect(alarms, "the log has no error about it")


def _expect_service(found: Finding, unit: FragileUnit, traffic: Traffic) -> None:
    with traffic.driving(unit):
        found.expect(traffic.wait_for(len(traffic.acknowledged) + 20), "nothing is acknowledged afterwards")
    found.expect(unit.client.get("/health/ready").status_code == 200, "the unit is not ready afterwards")
    found.problems += traffic.strange


def _scenario(name: str, promise: str, what: str, perform: Callable[[Stage], Finding], *controls: str) -> Scenario:
    return Scenario(name, promise, what, runs_count=10, perform=perform, controls=controls)


SCENARIOS = (
    _scenario(
        "database-damaged",
        "It is moved aside with the time in its name and byte for byte; a fresh one is begun; readiness, log, "
        "metric and "
        "ledger say so.",
        "head, half of the pages, second half or everything overwritten between two starts",
        damaged_database,
        "damage is not looked for",
    ),
    _scenario(
        "log-damaged",
        "It is moved aside with the time in its name and byte for byte; what can be read is kept if the database is "
        "whole with it, or else a fresh one begun; readiness, log and metric say so.",
        "one byte of the head or one bit of a commit that is not among the last spoilt, after SIGKILL",
        damaged_log,
        "damage is not looked for",
    ),
    _scenario(
        "log-torn-at-its-end",
        "What a power cut leaves of a commit that was not acknowledged is dropped without alarm; nothing is "
        "moved aside "
        "and nothing acknowledged is lost.",
        "the end of the log followed by part of a frame, after SIGKILL",
        torn_log,
        "every log is called damaged",
    ),
    _scenario(
        "database-damaged-in-service",
        "It is moved aside and a fresh one begun without a restart; the window goes on; readiness, log and "
        "metric say so.",
        "everything but the first page and the head of the log overwritten while the unit runs and its metrics are "
        "asked for",
        damaged_in_service,
        "damage is not looked for",
    ),
)

"""Units that end in the middle of their work: killed, or asked to stop."""

from __future__ import annotations

import time
from pathlib import Path

from tests.faults.remains import judge, remains_of
from tests.faults.scenario import Finding, Scenario, Stage
from tests.faults.traffic import Traffic, again, section_of
from tests.faults.units import FragileUnit

KILLS_PER_LIFE_COUNT = 10
"""Kills of one unit with one database; then the next begins with none."""


def kills_under_load(stage: Stage) -> Finding:
    """Kill a unit at a random instant under load, look at its database, start it again, and so on."""
    chance, found = stage.chance, Finding()
    traffic: Traffic | None = None
    for _ in range(min(stage.runs_count, KILLS_PER_LIFE_COUNT)):
        with FragileUnit(stage.folder, broken=stage.broken) as unit:
            traffic = traffic or Traffic(section_of(unit), first_number=chance.randrange(100_000))
            _check_restored(found, unit, traffic)
            with traffic.driving(unit):
                alive = traffic.wait_for(len(traffic.acknowledged) + 1)
                found.expect(alive, "nothing was acknowledged within 30 s")
                time.sleep(chance.uniform(0.0, 0.6))
                unit.kill()
        if chance.random() < 0.2:
            _kill_while_it_starts(stage.folder, after_s=chance.uniform(0.0, 0.5), broken=stage.broken)
        judge(found, remains_of(unit.database), traffic.acknowledged)
        found.runs_count += 1
        stage.tell(1)
        if not found.passed:  # more of this life would tell nothing new
            break
    with FragileUnit(stage.folder) as unit:
        assert traffic is not None
        _check_restored(found, unit, traffic)
        judge(found, remains_of(unit.database), traffic.acknowledged)
    found.acknowledged_count = len(traffic.acknowledged)
    found.problems += traffic.strange
    return found


def _kill_while_it_starts(folder: Path, *, after_s: float, broken: str) -> None:
    unit = FragileUnit(folder, broken=broken)
    with unit.log.open("wb") as sink:
        process = unit.begin(sink)
        time.sleep(after_s)
        process.kill()
        process.wait()


def _check_restored(found: Finding, unit: FragileUnit, traffic: Traffic) -> None:
    """Look whether all that is stored counts again, and send again what nobody answered: it counts once."""
    stored = set(unit.stored_ids())
    restored_count = unit.window_count_once(len(stored))
    found.expect(restored_count == len(stored), f"{len(stored)} are stored, {restored_count} count again")
    unanswered = [passage for passage_id, passage in traffic.sent.items() if passage_id not in traffic.acknowledged]
    known = [traffic.sent[passage_id] for passage_id in list(traffic.acknowledged)[-5:]]
    for passage in (*unanswered, *known):
        found.expect(again(unit, passage, traffic), f"{passage.passage_id.hex()} was refused after the restart")
    found.duplicated_count += max(0, unit.window_count() - len(stored | set(traffic.sent)))
    found.expect(
        unit.window_count() == len(stored | {passage.passage_id for passage in unanswered}),
        "what was sent again does not count once",
    )


def stops_under_load(stage: Stage) -> Finding:
    """Ask a unit to stop under load; whoever waits for an answer then gets one."""
    chance, found = stage.chance, Finding()
    with FragileUnit(stage.folder, broken=stage.broken) as unit:
        traffic = Traffic(section_of(unit), first_number=chance.randrange(100_000))
        with traffic.driving(unit):
            found.expect(traffic.wait_for(20), "nothing was acknowledged within 30 s")
            time.sleep(chance.uniform(0.0, 0.6))
            asked_s = time.monotonic()
            found.expect(unit.stop() == 0, "it ended with an error")
            found.figures["stop_s"] = round(time.monotonic() - asked_s, 2)
        last = unit.lines()[-1]["event"]
        found.expect(last == "stopped", f"its last word was {last!r}")
        complaints = [line["event"] for line in unit.lines() if line["level"] in {"error", "critical"}]
        found.expect(not complaints, f"it complained: {complaints}")
    left = remains_of(unit.database)
    judge(found, left, traffic.acknowledged)
    unanswered = set(left.ids) - set(traffic.acknowledged)
    found.expect(not unanswered, f"{len(unanswered)} were stored and nobody was told")
    found.expect(not unit.database.with_name(unit.database.name + "-wal").exists(), "its log was left behind")
    found.acknowledged_count = len(traffic.acknowledged)
    found.problems += traffic.strange
    found.runs_count = 1
    stage.tell(1)
    return found


SCENARIOS = (
    Scenario(
        name="kill-under-load",
        promise="No acknowledged passage is lost and none counts twice; the database is whole; the window holds again "
        "what was stored; a passage whose receipt was lost is answered when it is sent again.",
        conditions="SIGKILL at a random instant under load by radio and cellular at once, one in five again while it "
        "starts; lives of ten kills with one database",
        runs_count=200,
        perform=kills_under_load,
        controls=("acknowledge before the commit", "the window is not restored"),
    ),
    Scenario(
        name="stop-under-load",
        promise="A unit that is asked to stop stores everything it acknowledged, answers everybody whose passage it "
        "stored, and leaves a database that is whole and has no log.",
        conditions="SIGTERM at a random instant under load by radio and cellular at once",
        runs_count=10,
        perform=stops_under_load,
        controls=("nobody is answered at the end",),
    ),
)

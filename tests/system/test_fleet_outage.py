"""What becomes of a fleet while its unit is gone, and after it has come back: killed, out of reach, with a new map."""

from __future__ import annotations

import asyncio
import json
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest

from roadgrip.protocol import Kind
from roadgrip.records import NotCounted
from roadgrip.section import RoadSection
from roadgrip.section_file import section_from_json, section_to_json
from roadgrip.sections import read_section
from roadgrip.units import WINDOW_S
from tests.rsu_app.fakes import make_passage
from tests.rsu_app.sites import passage_json
from tests.system.daemons import Daemon
from tests.system.ether import Ether, air_to
from tests.system.fleets import Fleet
from vehicle_client.shell.exchange import Ending
from vehicle_client.shell.fleet_events import FleetEvent, FleetReport, PassageEnded, VehicleEntered
from vehicle_client.shell.patience import Patience

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

PACE = 60.0
CLOCK = f"[clock]\nspeedup_ratio = {PACE}\n"
STEADFAST = Patience(reply_s=3.0, backoff_ratio=1.0).stretched(PACE)
"""Four announcements last longer on the wall than a unit takes to start."""


def test_a_unit_killed_under_a_fleet_comes_back_and_nothing_acknowledged_is_lost(tmp_path: Path):
    acknowledged_before: set[bytes] = set()

    async def play(stack: ExitStack) -> tuple[FleetReport, Daemon]:
        first = stack.enter_context(Daemon(tmp_path, CLOCK))
        ten_answered = asyncio.Event()

        def listen(event: FleetEvent) -> None:
            if isinstance(event, PassageEnded) and event.record.ending is Ending.ACCEPTED:
                acknowledged.add(event.record.passage_id)
                if len(acknowledged) == 10:
                    first.kill()
                    acknowledged_before.update(acknowledged)
                    ten_answered.set()

        acknowledged: set[bytes] = set()
        fleet = Fleet(read_section("long-turn"), 40, patience=STEADFAST, seed=31, on_event=listen)
        address = f"udp://127.0.0.1:{first.udp_port}"
        running = asyncio.create_task(fleet.run(address, spool_folder=tmp_path / "spool"))
        await ten_answered.wait()
        second = Daemon(tmp_path, CLOCK, ports=first.ports)
        await asyncio.to_thread(stack.enter_context, second)
        return await running, second

    with ExitStack() as stack:
        report, second = asyncio.run(play(stack))
        rows = {row.passage_id for row in second.stored()}
        assert 10 <= second.restored_count < 40, "the kill must come in the middle"
        assert second.window_count() == len(rows)

    assert acknowledged_before <= set(report.passage_ids) <= rows
    assert len(set(report.passage_ids)) == report.accepted_count
    # Whoever was on the road when the unit died tried again until it was back.
    assert report.retries_count > 0
    assert (report.accepted_count, report.counted_count, len(rows)) == (40, 40, 40)
    assert report.waiting_count + report.no_map_count + report.frames_spent_count == 0


def test_a_passage_that_waited_for_a_unit_enters_the_window_with_its_true_age(tmp_path: Path):
    # Two vehicles leave the section early, more than an hour before they can report it; two late. All get their map,
    # then the unit is out of reach until all four have given up.
    drive_s, early_s, late_s = 4000.0, 100.0, 3990.0
    ether = Ether()
    reach_again_s: list[float] = []

    def out_of_reach() -> None:
        if ether.exchanges_with(Kind.MAP) == ether.exchanges_with(Kind.ADVISORY) == 4 and not reach_again_s:
            ether.open = False

    def listen(event: FleetEvent) -> None:
        unheard = [e for e in fleet.endings if e.record.ending is Ending.UNANSWERED and not e.from_spool]
        if len(unheard) == 4 and not reach_again_s:
            reach_again_s.append(event.at_s if isinstance(event, PassageEnded) else 0.0)
            ether.open = True

    fleet = Fleet(
        read_section("long-turn"),
        4,
        speedup_ratio=1000.0,
        arrivals_per_hour=100_000.0,
        patience=Patience(reply_s=100.0, longest_s=200.0, report_tries_count=1),
        drive_s=lambda _: drive_s,
        exit_road_s=lambda number: drive_s - (early_s if number < 2 else late_s),
        seed=32,
        on_event=listen,
    )
    ether.on_delivery = out_of_reach

    async def play(daemon: Daemon) -> FleetReport:
        async with air_to(daemon.udp_port, ether) as address:
            return await fleet.run(address, spool_folder=tmp_path / "spool")

    with Daemon(tmp_path, "[clock]\nspeedup_ratio = 1000.0\n") as daemon:
        report = asyncio.run(play(daemon))
        interval = daemon.client.get("/v1/sections/long-turn/friction").json()["interval"]
        rows = {row.passage_id: row for row in daemon.stored()}

    assert (report.spooled_count, report.delivered_late_count, report.accepted_count) == (4, 4, 4)
    entered_at_s = {e.number: e.at_s for e in fleet.events if isinstance(e, VehicleEntered)}
    for ended in (e for e in fleet.endings if e.record.ending is Ending.ACCEPTED):
        row = rows[ended.record.passage_id]
        left_at_s = entered_at_s[ended.number] + (early_s if ended.number < 2 else late_s)
        # Sent between the moment the unit came into reach and the receipt; a second for what the wire rounds.
        assert reach_again_s[0] - left_at_s - 1.0 <= row.age_s <= ended.at_s - left_at_s + 1.0
        assert row.left_unix_s == pytest.approx(row.received_unix_s - row.age_s, abs=0.01)
        assert (row.age_s > WINDOW_S) == bool(row.flags & NotCounted.OLDER_THAN_WINDOW) == (ended.number < 2)
    # The receipts told them so, and those that count do so from when they left, not from when they were heard.
    assert dict(report.not_counted) == {"older_than_window": 2}
    assert report.counted_count == interval["passages_count"] == 2
    assert interval["newest_age_s"] >= min(row.age_s for row in rows.values())


def changed(section: RoadSection) -> RoadSection:
    content = json.loads(section_to_json(section))
    content["speed_limit_mps"] += 1.0
    del content["version"]
    return section_from_json(json.dumps(content))


def test_after_a_change_of_the_map_old_summaries_are_refused_and_old_passages_still_count(tmp_path: Path):
    old, road_file = read_section("sharp-turn"), tmp_path / "road.json"
    new = changed(old)
    settings = f'{CLOCK}[[sections]]\nfile = "road.json"\n'
    before = make_passage(old, seed=33)
    ether = Ether()
    caught = Fleet(old, 4, patience=STEADFAST, drive_s=lambda _: 60.0, seed=34)
    later = Fleet(old, 3, seed=35)

    async def play(stack: ExitStack) -> tuple[FleetReport, FleetReport, Daemon]:
        first = stack.enter_context(Daemon(tmp_path, settings))
        assert post(first).json()["counted"] is True
        everyone_has_the_map = asyncio.Event()

        def listen() -> None:
            complete = ether.exchanges_with(Kind.MAP) == ether.exchanges_with(Kind.ADVISORY) == 4
            if complete and not everyone_has_the_map.is_set():
                ether.open = False
                everyone_has_the_map.set()

        ether.on_delivery = listen
        async with air_to(first.udp_port, ether) as address:
            on_the_road = asyncio.create_task(caught.run(address, spool_folder=tmp_path / "caught"))
            await everyone_has_the_map.wait()
            await asyncio.to_thread(first.stop)
            road_file.write_text(section_to_json(new), encoding="utf-8")
            second = Daemon(tmp_path, settings, ports=first.ports)
            await asyncio.to_thread(stack.enter_context, second)
            ether.open = True
            caught_report = await on_the_road
            return caught_report, await later.run(address, spool_folder=tmp_path / "later"), second

    def post(daemon: Daemon) -> httpx.Response:
        return daemon.client.post("/v1/sections/sharp-turn/passages", json=passage_json(before))

    road_file.write_text(section_to_json(old), encoding="utf-8")
    with ExitStack() as stack:
        caught_report, later_report, second = asyncio.run(play(stack))
        assert second.restored_count == 1
        # Sent again, it is recognised before its map is looked at.
        assert post(second).json()["counted"] is True
        assert second.window_count("sharp-turn") == 4
        assert [row.map_version for row in second.stored()] == [old.version, *[new.version] * 3]

    # A summary cut with the old map is worth nothing with the new one: refused for good, nothing kept to try again.
    assert set(caught.maps) == {old.version}
    assert dict(caught_report.rejected) == {"stale_map": 4}
    assert caught_report.waiting_count + caught_report.spooled_count == 0
    assert set(later.maps) == {new.version}
    assert later_report.counted_count == 3

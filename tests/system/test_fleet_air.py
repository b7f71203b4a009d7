"""Whole fleets against a real unit through bad air: what is acknowledged is stored once, and nobody talks too much."""

from __future__ import annotations

import asyncio
import random
from pathlib import Path

import pytest

from roadgrip.records import RSU_FRAME_BUDGET, VEHICLE_FRAME_BUDGET
from roadgrip.sections import read_section
from tests.system.daemons import Daemon
from tests.system.ether import Ether, air_to
from tests.system.fleets import Fleet
from vehicle_client.shell.fleet_events import FleetReport
from vehicle_client.shell.uplink import AirFaults

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

SECTIONS = ("long-turn", "s-turn", "sharp-turn")
SETTINGS = "[clock]\nspeedup_ratio = 60.0\n" + "".join(f'[[sections]]\nfile = "{name}"\n' for name in SECTIONS)


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    with Daemon(tmp_path_factory.mktemp("unit"), SETTINGS) as running:
        yield running


@pytest.fixture
def radio_unit(tmp_path_factory):
    """Behind a radio, whose senders can forge no address: it asks for no cookies, which take a turn of their own."""
    with Daemon(tmp_path_factory.mktemp("unit"), "cookies = false\n" + SETTINGS) as running:
        yield running


def assert_adds_up(report: FleetReport, vehicles_count: int) -> None:
    assert report.vehicles_count == vehicles_count
    ends = report.accepted_count + report.no_map_count + report.waiting_count + report.frames_spent_count
    assert ends + report.rejected.total() + report.withheld.total() + report.spool_dropped_count == vehicles_count


def test_every_acknowledged_passage_is_stored_and_counted_once_over_cellular(daemon: Daemon, tmp_path: Path):
    air = AirFaults(lost_frac=0.15, doubled_frac=0.2, delayed_frac=0.2, spoiled_frac=0.05, delay_s=0.2)
    fleet = Fleet(read_section("long-turn"), 60, faults=air, seed=11)
    report = asyncio.run(fleet.run(daemon.url, spool_folder=tmp_path))

    assert_adds_up(report, 60)
    assert report.accepted_count >= 50, "this air is bad, not dead"
    assert min(report.air.lost_count, report.air.doubled_count, report.air.delayed_count) > 0
    assert report.air.spoiled_count > 0
    rows = [row for row in daemon.stored() if row.section_id == "long-turn"]
    assert len(set(report.passage_ids)) == len(report.passage_ids) == report.accepted_count
    assert len({row.passage_id for row in rows}) == len(rows)
    assert set(report.passage_ids) <= {row.passage_id for row in rows}
    assert report.counted_count == report.accepted_count
    # A passage whose receipts were all lost is stored without being acknowledged; it counts all the same.
    assert daemon.window_count("long-turn") == len(rows)
    labels = {"section": "long-turn", "via": "http"}
    assert daemon.metric("roadgrip_passages_total", outcome="counted", **labels) == len(rows)
    assert daemon.metric("roadgrip_passages_total", outcome="repeated", **labels) > 0, "nothing came twice"


def test_over_half_dead_air_nobody_sends_more_frames_than_allowed(radio_unit: Daemon, tmp_path: Path):
    ether = Ether(lost_frac=0.5, doubled_frac=0.3, late_frac=0.2, chance=random.Random(3))

    async def play() -> FleetReport:
        async with air_to(radio_unit.udp_port, ether) as address:
            return await Fleet(read_section("s-turn"), 30, seed=12).run(address, spool_folder=tmp_path)

    report = asyncio.run(play())

    assert_adds_up(report, 30)
    assert max(ether.up.values()) <= VEHICLE_FRAME_BUDGET
    assert max(ether.down.values()) <= RSU_FRAME_BUDGET
    assert max((ether.up + ether.down).values()) <= 20
    # The vehicles' own account is the same as what was seen on the air.
    assert len(ether.up) == 30
    assert report.frames_sent_count == ether.up.total()
    assert report.budget_peak_count == max(ether.up.values())
    assert radio_unit.metric("roadgrip_frames_sent_total", via="udp") >= ether.down.total()
    # The limits were felt, and the job was done all the same.
    assert max(ether.down.values()) == RSU_FRAME_BUDGET
    assert report.accepted_count >= 15
    rows = {row.passage_id for row in radio_unit.stored() if row.section_id == "s-turn"}
    assert set(report.passage_ids) <= rows
    assert radio_unit.window_count("s-turn") == len(rows)


def test_passages_count_for_their_own_section_only(daemon: Daemon, tmp_path: Path):
    before = {name: daemon.window_count(name) for name in SECTIONS}
    few, many = Fleet(read_section("sharp-turn"), 5, seed=13), Fleet(read_section("long-turn"), 8, seed=14)

    async def play() -> tuple[FleetReport, FleetReport]:
        address = f"udp://127.0.0.1:{daemon.udp_port}"
        return await asyncio.gather(
            few.run(address, spool_folder=tmp_path / "few"), many.run(address, spool_folder=tmp_path / "many")
        )

    few_report, many_report = asyncio.run(play())

    assert (few_report.counted_count, many_report.counted_count) == (5, 8)
    assert set(few.maps) == {read_section("sharp-turn").version}
    assert set(many.maps) == {read_section("long-turn").version}
    section_of = {row.passage_id: row.section_id for row in daemon.stored()}
    assert {section_of[passage_id] for passage_id in few_report.passage_ids} == {"sharp-turn"}
    assert {section_of[passage_id] for passage_id in many_report.passage_ids} == {"long-turn"}
    after = {name: daemon.window_count(name) - before[name] for name in SECTIONS}
    assert after == {"long-turn": 8, "s-turn": 0, "sharp-turn": 5}

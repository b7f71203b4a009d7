"""What a person reads when a vehicle and a unit did not meet."""

from __future__ import annotations

import pytest
from rich.console import Console

from roadgrip.reasons import Reason
from roadgrip.records import Rejected
from tests.vehicle_client.shell.air import Ether, TokenCodec
from vehicle_client.shell.exchange import Exchange
from vehicle_client.shell.fleet_events import FleetReport
from vehicle_client.shell.replay import receipt_text, refusal_text
from vehicle_client.shell.views import fleet_report_table


def told(report: FleetReport) -> str:
    console = Console(width=150)
    with console.capture() as seen:
        console.print(fleet_report_table(report))
    return seen.get()


def test_where_nothing_came_back_one_is_asked_whether_a_unit_runs():
    exchange = Exchange(passage_id=bytes(16), section_id="bend", codec=TokenCodec(Ether()))
    assert "is a unit running there?" in receipt_text(exchange.record())


@pytest.mark.parametrize(("accepted_count", "asked"), [(0, True), (3, False)])
def test_a_fleet_that_met_no_unit_asks_whether_one_runs(accepted_count, asked):
    report = FleetReport(vehicles_count=4, no_map_count=1, accepted_count=accepted_count)
    assert ("does a unit run there" in told(report)) is asked


def test_a_refusal_is_told_with_its_detail_if_there_is_one():
    assert refusal_text(Rejected(Reason.WRONG_ROAD, "elsewhere")) == "wrong_road: elsewhere"
    assert refusal_text(Rejected(Reason.BUSY)) == "busy"

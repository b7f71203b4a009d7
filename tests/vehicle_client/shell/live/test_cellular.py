import asyncio
import json
from math import inf

import httpx
import pytest

from roadgrip.sections import read_section
from tests.rsu_app.sites import make_unit
from vehicle_client.mapmatch.section_line import line_of_section
from vehicle_client.mapmatch.surroundings import Position
from vehicle_client.shell.live.cellular import (
    QUERY_M,
    QUERY_S,
    RETRY_S,
    SECTIONS_LIMIT_COUNT,
    WAITING_QUERY_S,
    QueryClock,
    bbox_around,
    list_sections,
    listing_of,
)
from vehicle_client.shell.uplink import UnitAddress

ROAD = read_section("long-turn")
HERE = Position(0.0, ROAD.anchors[0].lat_deg, ROAD.anchors[0].lon_deg, 2.0)
ADDRESS = UnitAddress("http", "unit", 80)


def north_of(position: Position, distance_m: float) -> Position:
    return Position(position.time_s, position.lat_deg + distance_m / 111_195.0, position.lon_deg, 2.0)


def entry(section_id: str = "long-turn", shift_deg: float = 0.0) -> dict[str, object]:
    anchors = [{"station_m": a.station_m, "lat_deg": a.lat_deg + shift_deg, "lon_deg": a.lon_deg} for a in ROAD.anchors]
    return {"section_id": section_id, "length_m": ROAD.length_m, "anchors": anchors}


def test_a_real_unit_lists_its_section_to_a_car_nearby_and_not_to_one_far_away():
    async def story() -> None:
        unit = make_unit(section=ROAD)
        async with unit.client() as client:
            near = await list_sections(client, ADDRESS, HERE)
            far = await list_sections(client, ADDRESS, north_of(HERE, 100_000.0))
            everywhere = await list_sections(client, ADDRESS, None)
        assert near is not None
        assert [line.section_id for line in near.lines] == ["long-turn"]
        assert near.section_ids == {"long-turn"}
        assert far is not None
        assert not far.section_ids
        assert everywhere is not None
        assert everywhere.section_ids == {"long-turn"}

    asyncio.run(story())


def test_the_line_of_anchors_is_the_maps_to_some_metres():
    (line,) = listing_of({"sections": [entry()]}, HERE).lines
    exact = line_of_section(ROAD)
    for anchor in ROAD.anchors:
        place = line.place_of(lat_deg=anchor.lat_deg, lon_deg=anchor.lon_deg)
        truth = exact.place_of(lat_deg=anchor.lat_deg, lon_deg=anchor.lon_deg)
        assert place is not None
        assert truth is not None
        assert place.station_m == pytest.approx(truth.station_m, abs=3.0)


def test_the_nearest_sections_are_taken_first_and_no_more_than_there_is_room_for():
    entries = [entry(f"s-{n}", shift_deg=0.001 * n) for n in reversed(range(60))]
    listing = listing_of({"sections": entries}, HERE)
    assert [line.section_id for line in listing.lines] == [f"s-{n}" for n in range(SECTIONS_LIMIT_COUNT)]
    assert len(listing.section_ids) == 60


@pytest.mark.parametrize("answer", [None, [], {"sections": 5}, {"sections": [{"section_id": "x"}, None, 7]}])
def test_what_is_not_understood_is_left_out(answer: object):
    assert listing_of(answer, HERE).lines == ()


@pytest.mark.parametrize(
    "answer",
    [
        httpx.Response(503),
        httpx.Response(200, content=b"<html>"),
        httpx.Response(200, content=json.dumps({"sections": []}).encode() + b" " * 1_000_000),
    ],
    ids=["busy", "a proxy's page", "too much"],
)
def test_a_server_that_does_not_tell_is_asked_again_later(answer: httpx.Response):
    async def story() -> None:
        async with httpx.AsyncClient(transport=httpx.MockTransport(lambda _: answer)) as client:
            assert await list_sections(client, ADDRESS, HERE) is None

    asyncio.run(story())


def test_a_query_is_due_when_the_last_answer_is_old_or_far_away():
    query = QueryClock()
    assert query.due(HERE, now_s=0.0)
    query.asked(HERE, now_s=0.0, answered=True)
    assert not query.due(HERE, now_s=QUERY_S - 1.0)
    assert query.due(HERE, now_s=QUERY_S)
    assert not query.due(north_of(HERE, QUERY_M - 100.0), now_s=100.0)
    assert query.due(north_of(HERE, QUERY_M + 100.0), now_s=100.0)
    assert query.due(HERE, now_s=WAITING_QUERY_S, waiting=True)


def test_a_failed_query_is_made_again_soon_but_not_at_once():
    query = QueryClock()
    query.asked(HERE, now_s=0.0, answered=False)
    assert not query.due(north_of(HERE, 1e5), now_s=RETRY_S - 1.0)
    assert query.due(HERE, now_s=RETRY_S)


def test_the_box_lies_within_what_degrees_can_be():
    west, south, east, north = (float(v) for v in bbox_around(Position(0.0, 89.99, 179.99, 1.0)).split(","))
    assert -180.0 <= west < east <= 180.0
    assert -90.0 <= south < north <= 90.0
    assert inf > north

import asyncio

import httpx
import pytest

from roadgrip.frames import iter_frames, join_frames
from roadgrip.records import Accepted, AdvisoryNotice, Arrival, MapOffer, Receipt
from tests.rsu_app.fakes import make_passage, make_section
from tests.rsu_app.sites import UnitUnderTest, frame_of_passage, frames_of, make_unit, read_frames

SECTION = make_section()
FRAMES = {"content-type": "application/vnd.roadgrip.frames"}


def posted(under_test: UnitUnderTest, body: bytes, headers: dict[str, str] | None = None) -> httpx.Response:
    async def post() -> httpx.Response:
        async with under_test.client() as client:
            return await client.post("/v1/frames", content=body, headers=FRAMES if headers is None else headers)

    return asyncio.run(post())


def test_an_exchange_over_cellular_is_that_of_the_radio():
    under_test = make_unit(section=SECTION)
    passage = make_passage(SECTION)
    arrival = frames_of(
        Arrival(passage.passage_id, SECTION.section_id), passage_id=passage.passage_id, section_id=SECTION.section_id
    )
    answer = posted(under_test, join_frames([*arrival, frame_of_passage(passage)]))
    assert answer.headers["content-type"] == "application/vnd.roadgrip.frames"
    offer, notice, receipt = read_frames(list(iter_frames(answer.content)))
    assert isinstance(offer, MapOffer)
    assert isinstance(notice, AdvisoryNotice)
    assert receipt == Receipt(passage.passage_id, Accepted())
    assert under_test.count("roadgrip_frames_sent_total", via="http", message="receipt") == 1


def test_no_frames_are_answered_with_none():
    answer = posted(make_unit(section=SECTION), b"")
    assert (answer.status_code, answer.content) == (200, b"")


def test_another_media_type_is_refused():
    answer = posted(make_unit(section=SECTION), b"{}", {"content-type": "application/json"})
    assert (answer.status_code, answer.json()["reason"]) == (415, "unsupported_media_type")


@pytest.mark.parametrize("tail", [b"RG", b"rubbish", bytes(100)])
def test_a_body_that_is_broken_behind_a_good_frame_changes_nothing(tail):
    under_test = make_unit(section=SECTION)
    answer = posted(under_test, frame_of_passage(make_passage(SECTION)) + tail)
    assert (answer.status_code, answer.json()["reason"]) == (422, "malformed")
    assert under_test.store.entries == []


def test_more_frames_than_a_passage_has_are_refused():
    answer = posted(make_unit(section=SECTION), frame_of_passage(make_passage(SECTION)) * 21)
    assert (answer.status_code, answer.json()["reason"]) == (413, "oversized")

import asyncio
from math import inf
from typing import Any

import httpx
import pytest

from roadgrip.frames import Complete, section_key_of
from roadgrip.protocol import Kind
from roadgrip.records import MapOffer
from roadgrip.section import GnssAnchor, build_section
from roadgrip.section_file import section_from_json
from roadgrip.wire import decode_message
from rsu_app.adapters.http.models import refined_model
from rsu_app.domain.pooling import RefinedInterval
from rsu_app.sender_guards import SenderGuards
from tests.rsu_app.fakes import make_passage, make_section
from tests.rsu_app.sites import UnitUnderTest, make_unit, passage_json

SECTION = make_section()
HERE = f"/v1/sections/{SECTION.section_id}"
ANCHORED = build_section(
    section_id="bend",
    name="Bend",
    nodes_m=SECTION.nodes_m,
    speed_limit_mps=SECTION.speed_limit_mps,
    anchors=[GnssAnchor(0.0, 61.5, 10.2), GnssAnchor(200.0, 61.502, 10.204)],
)


def asked(under_test: UnitUnderTest, path: str, *, method: str = "GET", **arguments: Any) -> httpx.Response:
    async def ask() -> httpx.Response:
        async with under_test.client() as client:
            return await client.request(method, path, **arguments)

    return asyncio.run(ask())


def test_json_beyond_the_limit_of_an_address_is_refused_and_counted_as_a_passage():
    under_test = make_unit(section=SECTION, guards=SenderGuards(frames_per_s=1.0))

    async def ask(transport):
        async with httpx.AsyncClient(transport=transport, base_url="http://unit") as client:
            return [
                await client.post(f"{HERE}/passages", json=passage_json(make_passage(SECTION, seed=seed)))
                for seed in (1, 2)
            ]

    # From elsewhere: this machine's own addresses are not counted.
    answers = asyncio.run(ask(httpx.ASGITransport(under_test.app, client=("192.0.2.7", 4000))))
    assert [answer.status_code for answer in answers] == [200, 429]
    assert answers[1].json()["reason"] == "rate_limited"
    labels = {"section": SECTION.section_id, "outcome": "rejected", "reason": "rate_limited", "via": "json"}
    assert under_test.count("roadgrip_passages_total", **labels) == 1.0


def test_the_listing_says_where_to_go():
    (listed,) = asked(make_unit(section=SECTION), "/v1/sections").json()["sections"]
    assert (listed["section_id"], listed["map_version"]) == (SECTION.section_id, SECTION.version)
    for link in ("map", "advisory", "friction"):
        assert asked(make_unit(section=SECTION), listed["links"][link]).status_code == 200


def test_one_section_is_shown_as_in_the_listing():
    under_test = make_unit(section=SECTION)
    assert asked(under_test, HERE).json() == asked(under_test, "/v1/sections").json()["sections"][0]


@pytest.mark.parametrize(
    ("bbox", "found"),
    [("10.1,61.4,10.3,61.6", 1), ("10.203,61.5015,10.3,61.6", 1), ("0,0,1,1", 0), ("10.21,61.4,10.3,61.6", 0)],
)
def test_a_box_keeps_sections_with_an_anchor_inside(bbox, found):
    assert len(asked(make_unit(section=ANCHORED), f"/v1/sections?bbox={bbox}").json()["sections"]) == found


def test_a_section_without_anchors_is_in_no_box():
    assert asked(make_unit(section=SECTION), "/v1/sections?bbox=-180,-90,180,90").json()["sections"] == []


@pytest.mark.parametrize("bbox", ["1,2,3", "a,b,c,d", "", "3,0,1,1", "0,0,1,100", "nan,0,1,1", "0,0,inf,1"])
def test_a_box_that_is_none_is_refused(bbox):
    answer = asked(make_unit(section=SECTION), f"/v1/sections?bbox={bbox}")
    assert answer.status_code == 422
    assert answer.json()["reason"] in {"malformed", "out_of_range"}


def test_the_map_is_the_section_file():
    answer = asked(make_unit(section=SECTION), f"{HERE}/map")
    assert section_from_json(answer.text) == SECTION
    assert answer.headers["etag"] == f'"{SECTION.version}"'


def test_the_map_comes_as_vehicles_get_it():
    answer = asked(make_unit(section=SECTION), f"{HERE}/map", headers={"accept": "application/cbor"})
    assert answer.headers["content-type"] == "application/cbor"
    complete = Complete(Kind.MAP, section_key_of(SECTION.section_id), bytes(8), answer.content)
    offer = decode_message(complete.kind, complete.payload)
    assert isinstance(offer, MapOffer)
    assert offer.section == SECTION


@pytest.mark.parametrize("accept", ["application/json", "application/cbor"])
def test_who_has_the_map_is_told_so_without_it(accept):
    under_test = make_unit(section=SECTION)
    etag = asked(under_test, f"{HERE}/map", headers={"accept": accept}).headers["etag"]
    answer = asked(under_test, f"{HERE}/map", headers={"accept": accept, "if-none-match": etag})
    assert (answer.status_code, answer.content) == (304, b"")


def test_the_two_spellings_of_a_map_have_two_tags():
    under_test = make_unit(section=SECTION)
    etag = asked(under_test, f"{HERE}/map").headers["etag"]
    answer = asked(under_test, f"{HERE}/map", headers={"accept": "application/cbor", "if-none-match": etag})
    assert answer.status_code == 200


def test_who_has_an_old_map_gets_the_new_one():
    answer = asked(make_unit(section=SECTION), f"{HERE}/map", headers={"if-none-match": '"0123456789abcdef"'})
    assert answer.status_code == 200


def test_an_empty_window_advises_the_winter_speed():
    advisory = asked(make_unit(section=SECTION), f"{HERE}/advisory").json()
    assert (advisory["reason"], advisory["confidence"]) == ("winter_speed_few_vehicles", "insufficient")
    assert advisory["interval"] is None


def test_friction_follows_the_passages():
    under_test = make_unit(section=SECTION)
    assert asked(under_test, f"{HERE}/friction").json()["interval"] is None
    for seed in range(12):
        body = passage_json(make_passage(SECTION, seed=seed, mu=0.45))
        assert asked(under_test, f"{HERE}/passages", method="POST", json=body).json()["counted"] is True
    friction = asked(under_test, f"{HERE}/friction").json()
    assert friction["confidence"] == "provisional"
    assert friction["interval"]["passages_count"] == 12
    assert friction["interval"]["mu_new"] == pytest.approx(0.5, abs=1e-5)


def test_beside_the_interval_stands_what_expected_errors_make_of_it():
    under_test = make_unit(section=SECTION)
    for seed in range(12):
        body = passage_json(make_passage(SECTION, seed=seed, mu=0.45))
        asked(under_test, f"{HERE}/passages", method="POST", json=body)
    interval = asked(under_test, f"{HERE}/friction").json()["interval"]
    assert asked(under_test, f"{HERE}/advisory").json()["interval"] == interval
    assert (interval["at_least"], interval["since_change_s"]) == (False, None)
    refined = interval["refined"]
    assert refined["mu_new"] == pytest.approx(interval["mu_new"], rel=0.021)
    assert refined["mu_low"] == pytest.approx(0.8 * refined["mu_new"])
    assert 0.0 < refined["half_width_mu"] < 0.1
    assert (refined["informative_count"], refined["censored_count"], refined["at_least"]) == (12, 0, False)


def test_a_bound_from_above_that_is_not_there_is_null():
    refined = RefinedInterval(0.4, 0.5, inf, informative_count=1, censored_count=9, clipped=False, at_least=True)
    shown = refined_model(refined)
    assert shown.half_width_mu is None
    assert shown.at_least
    assert not shown.clipped


def test_that_the_median_held_it_back_is_told():
    refined = RefinedInterval(0.4, 0.5, 0.1, informative_count=9, censored_count=1, clipped=True)
    assert refined_model(refined).clipped


def test_a_receipt_says_what_became_of_the_passage_and_never_the_estimate():
    passage = make_passage(SECTION)
    receipt = asked(make_unit(section=SECTION), f"{HERE}/passages", method="POST", json=passage_json(passage)).json()
    assert receipt == {
        "passage_id": passage.passage_id.hex(),
        "outcome": "accepted",
        "counted": True,
        "not_counted": [],
    }


def test_a_passage_older_than_the_window_is_accepted_and_says_why_it_does_not_count():
    body = passage_json(make_passage(SECTION, age_s=4000.0))
    receipt = asked(make_unit(section=SECTION), f"{HERE}/passages", method="POST", json=body).json()
    assert (receipt["counted"], receipt["not_counted"]) == (False, ["older_than_window"])


def test_a_detection_broadcasts_map_and_advisory():
    under_test = make_unit(section=SECTION)
    answer = asked(under_test, f"{HERE}/detections", method="POST", json={"source": "loop-1"}).json()
    assert under_test.broadcasts == [SECTION.section_id]
    assert answer["frames_sent_count"] >= 2
    assert under_test.count("roadgrip_detections_total", section=SECTION.section_id) == 1


def test_detections_that_come_too_fast_are_refused_and_may_be_repeated():
    under_test = make_unit(section=SECTION, detections_count=2)
    given = [asked(under_test, f"{HERE}/detections", method="POST", json={}) for _ in range(3)]
    assert [answer.status_code for answer in given] == [200, 200, 503]
    assert (given[2].json()["reason"], given[2].json()["may_retry"]) == ("busy", True)
    assert len(under_test.broadcasts) == 2


def test_a_detection_without_anybody_to_tell_says_so():
    answer = asked(make_unit(section=SECTION, broadcast=False), f"{HERE}/detections", method="POST", json={})
    assert (answer.status_code, answer.json()["reason"]) == (503, "no_broadcast")


@pytest.mark.parametrize(
    ("method", "place"),
    [
        ("GET", ""),
        ("GET", "/map"),
        ("GET", "/advisory"),
        ("GET", "/friction"),
        ("GET", "/friction/stream"),
        ("POST", "/detections"),
    ],
)
def test_an_unknown_section_is_a_problem_with_its_reason(method, place):
    body: dict[str, Any] = {"json": {}} if method == "POST" else {}
    answer = asked(make_unit(section=SECTION), f"/v1/sections/elsewhere{place}", method=method, **body)
    assert (answer.status_code, answer.json()["reason"]) == (404, "unknown_section")
    assert answer.headers["content-type"] == "application/problem+json"

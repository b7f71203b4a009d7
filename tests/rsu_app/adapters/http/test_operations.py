import asyncio
import json
from http import HTTPStatus

import httpx
import pytest

from roadgrip.errors import StoreError
from roadgrip.reasons import Reason
from rsu_app.adapters.http import models, problems
from rsu_app.adapters.http.problems import STATUS_OF_REASON
from rsu_app.usecases import RoadSideUnit
from tests.rsu_app.fakes import make_passage, make_section
from tests.rsu_app.sites import UnitUnderTest, make_unit, passage_json

SECTION = make_section()


def asked(under_test: UnitUnderTest, path: str, **arguments) -> httpx.Response:
    async def ask() -> httpx.Response:
        async with under_test.client() as client:
            return await client.request(arguments.pop("method", "GET"), path, **arguments)

    return asyncio.run(ask())


def test_a_whole_unit_is_ready():
    answer = asked(make_unit(section=SECTION), "/health/ready")
    assert (answer.status_code, answer.json()["ready"]) == (200, True)


def conditions(answer: httpx.Response) -> dict[str, bool]:
    return {c["name"]: c["ok"] for c in answer.json()["conditions"]}


def test_a_unit_without_a_model_is_alive_but_not_ready():
    under_test = make_unit(section=SECTION, model=False)
    answer = asked(under_test, "/health/ready")
    assert (answer.status_code, conditions(answer)["model"]) == (503, False)
    assert asked(under_test, "/health/live").status_code == 200
    assert under_test.count("roadgrip_ready") == 0


def test_a_unit_that_cannot_write_is_not_ready_and_still_advises():
    under_test = make_unit(section=SECTION)
    under_test.store.error = StoreError("the disk is gone")
    answer = asked(under_test, "/health/ready")
    assert (answer.status_code, conditions(answer)["store"]) == (503, False)
    assert asked(under_test, f"/v1/sections/{SECTION.section_id}/advisory").status_code == 200


def test_a_unit_in_1970_is_not_ready():
    under_test = make_unit(section=SECTION)
    under_test.clock.now_unix_s = 100.0
    assert conditions(asked(under_test, "/health/ready"))["clock"] is False


def test_metrics_count_passages_by_outcome_and_way():
    under_test = make_unit(section=SECTION)
    path = f"/v1/sections/{SECTION.section_id}/passages"
    asked(under_test, path, method="POST", json=passage_json(make_passage(SECTION)))
    asked(under_test, path, method="POST", json=passage_json(make_passage(SECTION, seed=1, age_s=4000.0)))
    asked(under_test, path, method="POST", json=passage_json(make_passage(SECTION, seed=2, age_s=-1.0)))
    lost = passage_json(make_passage(SECTION, seed=3))
    asked(under_test, "/v1/sections/" + "x" * 40 + "/passages", method="POST", json=lost)
    text = asked(under_test, "/metrics").text
    series = 'roadgrip_passages_total{outcome="%s",reason="%s",section="%s",via="json"} 1.0'
    assert series % ("counted", "", "bend") in text
    assert series % ("uncounted", "older_than_window", "bend") in text
    assert series % ("rejected", "impossible_age", "bend") in text
    assert series % ("rejected", "unknown_section", "other") in text


def test_a_passage_that_comes_again_is_counted_apart():
    under_test = make_unit(section=SECTION)
    path = f"/v1/sections/{SECTION.section_id}/passages"
    for _ in range(3):
        asked(under_test, path, method="POST", json=passage_json(make_passage(SECTION)))
    labels = {"section": "bend", "reason": "", "via": "json"}
    assert under_test.count("roadgrip_passages_total", outcome="counted", **labels) == 1
    assert under_test.count("roadgrip_passages_total", outcome="repeated", **labels) == 2


def test_requests_are_counted_by_route_so_that_nobody_can_make_series():
    under_test = make_unit(section=SECTION)
    for number in range(5):
        asked(under_test, f"/v1/sections/s{number}/advisory")
        asked(under_test, f"/nowhere/{number}")
    route = "/v1/sections/{section_id}/advisory"
    assert under_test.count("roadgrip_http_requests_total", route=route, status="404") == 5
    assert under_test.count("roadgrip_http_requests_total", route="none", status="404") == 5


def test_the_page_shows_speed_and_why_without_anything_from_elsewhere():
    page = asked(make_unit(section=SECTION), "/").text
    assert "60 km/h" in page
    assert "winter speed few vehicles" in page
    assert "//" not in page.replace("</", "")


def test_the_page_shows_the_second_opinion():
    under_test = make_unit(section=SECTION)
    for seed in range(12):
        asyncio.run(under_test.unit.ingest_passage(make_passage(SECTION, seed=seed, mu=0.45)))
    assert "With each vehicle&#x27;s expected error: 0.4" in asked(under_test, "/").text


def test_the_page_of_a_unit_that_is_not_ready_says_why():
    assert "no model is loaded" in asked(make_unit(section=SECTION, model=False), "/").text


def test_every_reason_has_its_status():
    assert set(STATUS_OF_REASON) == set(Reason)
    assert all(status >= HTTPStatus.BAD_REQUEST for status in STATUS_OF_REASON.values())


def test_what_may_be_tried_again_says_so_by_status():
    later = {HTTPStatus.SERVICE_UNAVAILABLE, HTTPStatus.TOO_MANY_REQUESTS}
    assert {STATUS_OF_REASON[reason] for reason in Reason if reason.may_retry} == later
    unavailable = {reason for reason, status in STATUS_OF_REASON.items() if status is HTTPStatus.SERVICE_UNAVAILABLE}
    assert all(reason.may_retry for reason in unavailable)


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [("GET", "/nowhere", 404), ("DELETE", "/v1/sections", 405), ("PUT", "/v1/frames", 405)],
)
def test_what_is_not_there_is_a_problem_too(method, path, status):
    answer = asked(make_unit(section=SECTION), path, method=method)
    assert answer.status_code == status
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_bug_is_answered_without_inner_details(monkeypatch):
    def broken(*_: object) -> None:
        raise ZeroDivisionError("secret")

    monkeypatch.setattr(RoadSideUnit, "advisory_notice", broken)
    answer = asked(make_unit(section=SECTION), f"/v1/sections/{SECTION.section_id}/advisory")
    assert (answer.status_code, answer.json()["reason"]) == (500, "internal")
    assert "secret" not in answer.text


def test_the_description_of_the_interface_has_examples_and_no_kilometres_per_hour():
    document = asked(make_unit(section=SECTION), "/openapi.json").json()
    assert document["components"]["schemas"]["PassageModel"]["examples"]
    assert "kph" not in json.dumps(document)
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            assert operation["tags"], (method, path)
            assert operation["summary"], (method, path)


@pytest.mark.parametrize(
    "model",
    [
        models.AdvisoryModel,
        models.DetectionModel,
        models.FrictionModel,
        models.IntervalModel,
        models.PassageModel,
        models.ReadinessModel,
        models.ReceiptModel,
        problems.Problem,
    ],
    ids=lambda model: model.__name__,
)
def test_an_example_in_the_description_is_what_it_is_an_example_of(model):
    document = asked(make_unit(section=SECTION), "/openapi.json").json()
    (example,) = document["components"]["schemas"][model.__name__]["examples"]
    assert json.loads(model.model_validate(example).model_dump_json()) == example


def test_every_refusal_of_a_passage_is_in_the_description():
    document = asked(make_unit(section=SECTION), "/openapi.json").json()
    told = document["paths"]["/v1/sections/{section_id}/passages"]["post"]["responses"]
    assert {str(status.value) for status in STATUS_OF_REASON.values()} <= set(told)

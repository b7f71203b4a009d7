"""What the front answers is what the framework would have answered, only sooner."""

import asyncio
from dataclasses import replace
from typing import Any

import httpx
import pytest

from rsu_app.adapters.http.app import bug_response
from rsu_app.adapters.http.front import ADVISORY_LIFE_S, Front
from tests.rsu_app.fakes import FakeModel, make_passage, make_section
from tests.rsu_app.sites import UnitUnderTest, frame_of_passage, json_text, make_unit, passage_json

SECTION = make_section()
HERE = f"/v1/sections/{SECTION.section_id}"
FRAMES = {"content-type": "application/vnd.roadgrip.frames"}
JSON = {"content-type": "application/json"}


def asked(under_test: UnitUnderTest, *requests: tuple[str, str, dict[str, Any]]) -> list[httpx.Response]:
    """Ask one application for several things, one after the other."""

    async def ask() -> list[httpx.Response]:
        async with under_test.client() as client:
            return [await client.request(method, path, **arguments) for method, path, arguments in requests]

    return asyncio.run(ask())


def without_front(monkeypatch: pytest.MonkeyPatch) -> None:
    async def hand_on(self: Front, *connection: Any) -> None:
        await self._app(*connection)

    monkeypatch.setattr(Front, "__call__", hand_on)


def said(answer: httpx.Response) -> tuple[int, dict[str, str], bytes]:
    return answer.status_code, dict(answer.headers), answer.content


REQUESTS: list[tuple[str, str, dict[str, Any]]] = [
    ("GET", f"{HERE}/advisory", {}),
    ("GET", f"{HERE}/advisory?odd=1", {}),
    ("GET", f"{HERE}/advisory", {"content": b"a body"}),
    ("HEAD", f"{HERE}/advisory", {}),
    ("POST", f"{HERE}/advisory", {}),
    ("GET", f"{HERE}/map", {}),
    ("GET", f"{HERE}/map", {"headers": {"accept": "application/cbor"}}),
    ("GET", f"{HERE}/map", {"headers": {"if-none-match": f'"{SECTION.version}"'}}),
    ("GET", f"{HERE}/map", {"headers": {"if-none-match": '"another"'}}),
    ("GET", "/v1/sections/elsewhere/map", {}),
    ("POST", f"{HERE}/passages", {"json": passage_json(make_passage(SECTION, seed=1))}),
    ("POST", f"{HERE}/passages", {"json": passage_json(make_passage(SECTION, seed=2, age_s=4_000.0))}),
    ("POST", f"{HERE}/passages", {"json": passage_json(make_passage(SECTION, seed=3, age_s=-1.0))}),
    ("POST", f"{HERE}/passages", {"json": passage_json(make_passage(SECTION, seed=4, map_version="old"))}),
    ("POST", f"{HERE}/passages", {"json": passage_json(make_passage(SECTION, seed=5), duration_s="27")}),
    ("POST", f"{HERE}/passages", {"json": passage_json(make_passage(SECTION, seed=6), extra=1)}),
    ("POST", f"{HERE}/passages", {"content": b"", "headers": JSON}),
    ("POST", f"{HERE}/passages", {"content": b"{", "headers": JSON}),
    ("POST", f"{HERE}/passages", {"content": b"[" * 5_000, "headers": JSON}),
    ("POST", f"{HERE}/passages", {"content": b"\xff", "headers": JSON}),
    ("POST", f"{HERE}/passages", {"content": b"{}", "headers": {"content-type": "text/plain"}}),
    ("POST", f"{HERE}/passages", {"content": b"x" * 70_000, "headers": JSON}),
    (
        "POST",
        f"{HERE}/passages",
        {"content": json_text(passage_json(make_passage(SECTION, seed=7), age_s=float("nan"))), "headers": JSON},
    ),
    (
        "POST",
        f"{HERE}/passages",
        {
            "content": json_text(passage_json(make_passage(SECTION, seed=8))),
            "headers": {"content-type": "application/json; charset=utf-8"},
        },
    ),
    ("POST", "/v1/sections/elsewhere/passages", {"json": passage_json(make_passage(SECTION, seed=9))}),
    ("POST", "/v1/frames", {"content": frame_of_passage(make_passage(SECTION, seed=10)), "headers": FRAMES}),
    ("POST", "/v1/frames", {"content": b"", "headers": FRAMES}),
    ("POST", "/v1/frames", {"content": b"rubbish", "headers": FRAMES}),
    ("POST", "/v1/frames", {"content": b"{}", "headers": JSON}),
    ("PUT", "/v1/frames", {}),
]


def test_the_front_answers_as_the_framework_does(monkeypatch):
    quick = asked(make_unit(section=SECTION), *REQUESTS)
    without_front(monkeypatch)
    thorough = asked(make_unit(section=SECTION), *REQUESTS)
    for request, one, other in zip(REQUESTS, quick, thorough, strict=True):
        assert said(one) == said(other), request


def test_the_front_counts_as_the_framework_does(monkeypatch):
    def counts() -> dict[tuple[str, ...], float]:
        under_test = make_unit(section=SECTION)
        asked(under_test, *REQUESTS)
        wanted = {"roadgrip_http_requests_total", "roadgrip_passages_total", "roadgrip_frames_dropped_total"}
        return {
            (sample.name, *sample.labels.values()): sample.value
            for family in under_test.metrics.registry.collect()
            for sample in family.samples
            # A body that is too long was refused before the framework knew for what.
            if sample.name in wanted and sample.labels.get("status") != "413"
        }

    quick = counts()
    without_front(monkeypatch)
    assert quick == counts()


def test_the_framework_is_not_asked_for_what_is_as_it_should_be(monkeypatch):
    async def refuse(*_: object) -> None:
        raise AssertionError("asked")

    under_test = make_unit(section=SECTION)
    front = Front(refuse, site=under_test.site, on_bug=bug_response)

    async def ask() -> list[int]:
        transport = httpx.ASGITransport(app=front)
        async with httpx.AsyncClient(transport=transport, base_url="http://unit") as client:
            frame, passage = (make_passage(SECTION, seed=seed) for seed in (1, 2))
            answers = [
                await client.get(f"{HERE}/advisory"),
                await client.get(f"{HERE}/map"),
                await client.post(f"{HERE}/passages", json=passage_json(passage)),
                await client.post("/v1/frames", content=frame_of_passage(frame), headers=FRAMES),
            ]
            return [answer.status_code for answer in answers]

    assert asyncio.run(ask()) == [200] * 4
    assert len(under_test.store.entries) == 2


def passages_in(answer: httpx.Response) -> int:
    interval = answer.json()["interval"]
    return 0 if interval is None else int(interval["passages_count"])


def test_an_advisory_is_said_again_for_a_quarter_of_a_second_and_then_anew():
    under_test = make_unit(section=SECTION)
    now_s = 100.0
    under_test.site = replace(under_test.site, now_s=lambda: now_s)

    async def story() -> list[int]:
        nonlocal now_s
        async with under_test.client() as client:
            heard = [passages_in(await client.get(f"{HERE}/advisory"))]
            await under_test.unit.ingest_passage(make_passage(SECTION))
            now_s += 0.99 * ADVISORY_LIFE_S
            heard.append(passages_in(await client.get(f"{HERE}/advisory")))
            now_s += 0.02 * ADVISORY_LIFE_S
            heard.append(passages_in(await client.get(f"{HERE}/advisory")))
            return heard

    assert asyncio.run(story()) == [0, 0, 1]


def test_another_model_is_heard_of_at_once():
    under_test = make_unit(section=SECTION, model=False)
    under_test.site = replace(under_test.site, now_s=lambda: 100.0)

    async def story() -> list[str]:
        async with under_test.client() as client:
            heard = [(await client.get(f"{HERE}/advisory")).json()["reason"]]
            under_test.unit.switch_model(FakeModel())
            return [*heard, (await client.get(f"{HERE}/advisory")).json()["reason"]]

    assert asyncio.run(story()) == ["winter_speed_no_model", "winter_speed_few_vehicles"]

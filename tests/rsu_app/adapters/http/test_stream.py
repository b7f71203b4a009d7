import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from starlette.types import Message

from tests.rsu_app.fakes import make_passage, make_section
from tests.rsu_app.sites import UnitUnderTest, make_unit

SECTION = make_section()


class Listener:
    """A client of the stream: the web application driven by hand, since no answer ever ends."""

    def __init__(self) -> None:
        self.status = 0
        self.headers: dict[str, str] = {}
        self.pieces: asyncio.Queue[bytes] = asyncio.Queue()
        self.leave = asyncio.Event()
        self._asked = False

    async def receive(self) -> Message:
        if not self._asked:
            self._asked = True
            return {"type": "http.request", "body": b"", "more_body": False}
        await self.leave.wait()
        return {"type": "http.disconnect"}

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]
            self.headers = {k.decode(): v.decode() for k, v in message["headers"]}
        elif message.get("body"):
            await self.pieces.put(message["body"])

    async def next(self) -> str:
        return (await asyncio.wait_for(self.pieces.get(), 5.0)).decode()

    async def event(self) -> dict[str, Any]:
        """Return the data of the next event; comments and the like are passed over."""
        while True:
            lines = (await self.next()).splitlines()
            data = [line.removeprefix("data: ") for line in lines if line.startswith("data: ")]
            if data:
                found: dict[str, Any] = json.loads(data[0])
                return found


@asynccontextmanager
async def listening(under_test: UnitUnderTest) -> AsyncIterator[Listener]:
    listener = Listener()
    scope = {
        "type": "http",
        "asgi": {"version": "3.0", "spec_version": "2.3"},
        "http_version": "1.1",
        "method": "GET",
        "path": f"/v1/sections/{SECTION.section_id}/friction/stream",
        "raw_path": b"",
        "query_string": b"",
        "root_path": "",
        "scheme": "http",
        "headers": [],
        "client": ("test", 1),
        "server": ("unit", 80),
    }
    task = asyncio.create_task(under_test.app(scope, listener.receive, listener.send))
    try:
        yield listener
    finally:
        listener.leave.set()
        await asyncio.wait_for(task, 5.0)


async def pass_by(under_test: UnitUnderTest, count: int, *, mu: float, seed: int = 0) -> None:
    for number in range(count):
        await under_test.unit.ingest_passage(make_passage(SECTION, seed=seed + number, mu=mu))


def test_the_advice_that_stands_comes_first_and_then_each_change():
    async def scenario() -> None:
        under_test = make_unit(section=SECTION)
        async with listening(under_test) as listener:
            assert (await listener.event())["reason"] == "winter_speed_few_vehicles"
            assert listener.headers["content-type"].startswith("text/event-stream")
            await pass_by(under_test, 60, mu=0.3)
            while (event := await listener.event())["confidence"] != "recommended":
                pass
            assert event["interval"]["passages_count"] >= 50

    asyncio.run(scenario())


def test_a_silent_stream_shows_that_it_is_alive():
    async def scenario() -> None:
        async with listening(make_unit(section=SECTION, stream_heartbeat_s=0.01)) as listener:
            await listener.event()
            assert await listener.next() == ": alive\n\n"

    asyncio.run(scenario())


def test_a_client_that_leaves_frees_its_place():
    async def scenario() -> None:
        under_test = make_unit(section=SECTION, subscribers_count=1)
        for _ in range(3):
            async with listening(under_test) as listener:
                await listener.event()
                assert under_test.count("roadgrip_stream_clients") == 1
        assert under_test.count("roadgrip_stream_clients") == 0

    asyncio.run(scenario())


def test_more_clients_than_there_are_places_are_told_to_come_later():
    async def scenario() -> None:
        under_test = make_unit(section=SECTION, subscribers_count=1)
        async with listening(under_test) as first:
            await first.event()
            async with listening(under_test) as second:
                assert json.loads(await second.next())["reason"] == "busy"
                assert (second.status, second.headers["retry-after"]) == (503, "5")

    asyncio.run(scenario())


def test_a_unit_that_stops_ends_its_streams():
    async def scenario() -> None:
        under_test = make_unit(section=SECTION)
        async with listening(under_test) as listener:
            await listener.event()
            under_test.site.streams.close()
            listener.leave.clear()

    asyncio.run(scenario())

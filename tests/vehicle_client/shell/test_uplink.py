from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable
from typing import cast

import httpx
import numpy as np
import pytest

from roadgrip.errors import ConfigurationError
from roadgrip.frames import exchange_id_of, join_frames, section_key_of, split_into_frames
from roadgrip.records import Accepted, Receipt
from roadgrip.wire import encode_message, kind_of
from tests.vehicle_client.shell.air import PASSAGE_ID
from vehicle_client.shell.uplink import (
    FRAMES_MEDIA_TYPE,
    QUEUE_LIMIT_COUNT,
    AirCounts,
    AirFaults,
    HttpUplink,
    LossyUplink,
    UdpUplink,
    UnitAddress,
    parse_unit_address,
)

UNIT = UnitAddress("http", "unit.test", 8080)


def a_receipt() -> bytes:
    message = Receipt(PASSAGE_ID, Accepted())
    (frame,) = split_into_frames(
        kind_of(message),
        encode_message(message),
        exchange_id=exchange_id_of(PASSAGE_ID),
        section_key=section_key_of("bend"),
    )
    return frame


async def soon(something: Awaitable[bytes]) -> bytes | None:
    try:
        return await asyncio.wait_for(something, timeout=2.0)
    except TimeoutError:
        return None


async def at_once(something: Awaitable[bytes]) -> bytes | None:
    try:
        return await asyncio.wait_for(something, timeout=0.05)
    except TimeoutError:
        return None


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("udp://127.0.0.1:4740", UnitAddress("udp", "127.0.0.1", 4740)),
        ("udp://127.0.0.1", UnitAddress("udp", "127.0.0.1", 4740)),
        ("http://unit.example:8080/", UnitAddress("http", "unit.example", 8080)),
        ("https://unit.example", UnitAddress("https", "unit.example", 443)),
        ("http://[::1]:80", UnitAddress("http", "::1", 80)),
    ],
)
def test_a_units_address_is_read_as_people_write_it(text: str, address: UnitAddress):
    assert parse_unit_address(text) == address
    assert parse_unit_address(str(address)) == address


@pytest.mark.parametrize(
    "text", ["", "127.0.0.1:4740", "ftp://x", "udp://:1", "udp://x:0", "udp://x:99999", "http://x/y"]
)
def test_what_is_no_address_is_refused_with_an_example(text: str):
    with pytest.raises(ConfigurationError, match="udp://HOST:PORT"):
        parse_unit_address(text)


class _Mirror(asyncio.DatagramProtocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.transport.sendto(data[::-1], addr)


def test_datagrams_go_there_and_answers_come_back():
    async def play() -> bytes | None:
        loop = asyncio.get_running_loop()
        unit, _ = await loop.create_datagram_endpoint(_Mirror, local_addr=("127.0.0.1", 0))
        uplink = await UdpUplink(UnitAddress("udp", "127.0.0.1", unit.get_extra_info("sockname")[1])).open()
        await uplink.send(b"abc")
        answer = await soon(uplink.receive())
        await uplink.close()
        await uplink.send(b"nobody hears this")
        unit.close()
        return answer

    assert asyncio.run(play()) == b"cba"


def test_a_unit_that_is_not_there_is_silence():
    async def play() -> bytes | None:
        loop = asyncio.get_running_loop()
        gone, _ = await loop.create_datagram_endpoint(_Mirror, local_addr=("127.0.0.1", 0))
        port = gone.get_extra_info("sockname")[1]
        gone.close()
        await asyncio.sleep(0)
        uplink = await UdpUplink(UnitAddress("udp", "127.0.0.1", port)).open()
        await uplink.send(b"abc")
        await uplink.send(b"abc")
        answer = await at_once(uplink.receive())
        await uplink.close()
        return answer

    assert asyncio.run(play()) is None


def test_an_unknown_host_is_said():
    async def play() -> None:
        await UdpUplink(UnitAddress("udp", "no-such-host.invalid", 4740)).open()

    with pytest.raises(ConfigurationError, match=r"udp://no-such-host\.invalid:4740"):
        asyncio.run(play())


def over_http(answer: httpx.Response | Exception) -> tuple[list[httpx.Request], list[bytes]]:
    """Send one frame to a unit that answers so; return what it was asked and what came back."""
    asked: list[httpx.Request] = []

    def unit(request: httpx.Request) -> httpx.Response:
        asked.append(request)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def play() -> list[bytes]:
        async with httpx.AsyncClient(transport=httpx.MockTransport(unit)) as client:
            uplink = HttpUplink(UNIT, client)
            await uplink.send(b"frame")
            frames = []
            while (frame := await at_once(uplink.receive())) is not None:
                frames.append(frame)
            await uplink.close()
            return frames

    return asked, asyncio.run(play())


def test_a_frame_is_a_request_and_the_answer_holds_frames():
    body = join_frames([a_receipt(), a_receipt()])
    (asked,), frames = over_http(httpx.Response(200, content=body, headers={"content-type": FRAMES_MEDIA_TYPE}))
    assert str(asked.url) == "http://unit.test:8080/v1/frames"
    assert (asked.method, asked.content) == ("POST", b"frame")
    assert asked.headers["content-type"] == FRAMES_MEDIA_TYPE
    assert frames == [a_receipt(), a_receipt()]


@pytest.mark.parametrize(
    "answer",
    [
        httpx.Response(502, text="a proxy's page"),
        httpx.Response(200, content=b"not frames", headers={"content-type": FRAMES_MEDIA_TYPE}),
        httpx.Response(422, json={"reason": "malformed"}),
        httpx.ConnectError("refused"),
        httpx.ReadTimeout("slow"),
    ],
)
def test_whatever_else_comes_over_http_is_a_lost_frame(answer: httpx.Response | Exception):
    _, frames = over_http(answer)
    assert frames == []


class _Echo:
    """Sends every frame back, at once."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.inbox: asyncio.Queue[bytes] = asyncio.Queue()

    async def send(self, frame: bytes) -> None:
        self.sent.append(frame)
        self.inbox.put_nowait(frame)

    async def receive(self) -> bytes:
        return await self.inbox.get()

    async def close(self) -> None:
        return


def through(faults: AirFaults, frames_count: int, *, seed: int = 0) -> tuple[AirCounts, _Echo, list[bytes]]:
    async def play() -> tuple[AirCounts, _Echo, list[bytes]]:
        echo = _Echo()
        uplink = LossyUplink(echo, faults, np.random.default_rng(seed))
        arrived = []
        for number in range(frames_count):
            await uplink.send(b"frame %d" % number)
            while not uplink._inbox.empty():  # noqa: SLF001 - waiting would take real time
                arrived.append(await uplink.receive())
            await asyncio.sleep(0)
        while (frame := await at_once(uplink.receive())) is not None:
            arrived.append(frame)
        await uplink.close()
        return uplink.counts, echo, arrived

    return asyncio.run(play())


def test_clean_air_changes_nothing():
    counts, _, arrived = through(AirFaults(), 50)
    assert arrived == [b"frame %d" % n for n in range(50)]
    assert counts == AirCounts(offered_count=100)


def test_what_is_lost_is_counted_in_both_directions():
    counts, echo, arrived = through(AirFaults(lost_frac=0.3), 400)
    assert 400 - len(echo.sent) + len(echo.sent) - len(arrived) == counts.lost_count
    # 640 frames or so at 30 %: 0.3 within five standard deviations.
    assert abs(counts.lost_count / counts.offered_count - 0.3) < 0.1


def test_doubled_frames_arrive_twice():
    counts, echo, _ = through(AirFaults(doubled_frac=1.0), 5)
    assert echo.sent == [b"frame %d" % (n // 2) for n in range(10)]
    assert counts.doubled_count == 15


def test_delayed_frames_come_behind_later_ones_and_none_is_lost():
    _, _, arrived = through(AirFaults(delayed_frac=0.3, delay_s=0.01), 40, seed=3)
    assert arrived != sorted(arrived, key=lambda f: int(f.split()[1]))
    assert Counter(arrived) == Counter(b"frame %d" % n for n in range(40))


def test_spoiled_frames_differ_in_one_byte():
    counts, echo, _ = through(AirFaults(spoiled_frac=1.0), 10)
    assert counts.spoiled_count == 20
    for number, frame in enumerate(echo.sent):
        whole = b"frame %d" % number
        assert sum(a != b for a, b in zip(frame, whole, strict=True)) == 1


@pytest.mark.parametrize("bad", [-0.1, 1.1, float("nan")])
def test_what_is_no_probability_is_refused(bad: float):
    with pytest.raises(ConfigurationError, match="lost_frac"):
        AirFaults(lost_frac=bad)


def test_a_flood_does_not_grow_the_inbox():
    async def play() -> int:
        loop = asyncio.get_running_loop()
        unit, _ = await loop.create_datagram_endpoint(_Mirror, local_addr=("127.0.0.1", 0))
        uplink = await UdpUplink(UnitAddress("udp", "127.0.0.1", unit.get_extra_info("sockname")[1])).open()
        for _ in range(QUEUE_LIMIT_COUNT * 3):
            await uplink.send(b"abc")
            await asyncio.sleep(0)
        await asyncio.sleep(0.05)
        waiting = uplink._inbox.qsize()  # noqa: SLF001 - the bound under test
        await uplink.close()
        unit.close()
        return waiting

    assert asyncio.run(play()) <= QUEUE_LIMIT_COUNT

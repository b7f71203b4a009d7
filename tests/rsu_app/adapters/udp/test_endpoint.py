import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from roadgrip.errors import ConfigurationError
from roadgrip.frames import parse_frame
from roadgrip.protocol import Kind
from roadgrip.records import Accepted, AdvisoryNotice, Arrival, MapOffer, Message, Receipt
from rsu_app.adapters.udp.endpoint import FrameEndpoint, open_endpoint
from tests.rsu_app.fakes import make_passage, make_section
from tests.rsu_app.sites import UnitUnderTest, frame_of_passage, frames_of, make_unit, read_frames

SECTION = make_section()


class Radio(asyncio.DatagramProtocol):
    """A vehicle's end of the air."""

    def __init__(self) -> None:
        self.heard: asyncio.Queue[bytes] = asyncio.Queue()
        self.transport: Any = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        self.heard.put_nowait(data)

    async def messages(self, frames_count: int) -> list[Message]:
        return read_frames([await asyncio.wait_for(self.heard.get(), 5.0) for _ in range(frames_count)])


@asynccontextmanager
async def on_the_air(under_test: UnitUnderTest) -> AsyncIterator[tuple[FrameEndpoint, Radio]]:
    """Open the endpoint and a radio that sends to it and hears its broadcasts."""
    loop = asyncio.get_running_loop()
    transport, radio = await loop.create_datagram_endpoint(Radio, local_addr=("127.0.0.1", 0))
    endpoint, (host, port) = await open_endpoint(
        under_test.gateway,
        metrics=under_test.metrics,
        host="127.0.0.1",
        port=0,
        broadcast_address=transport.get_extra_info("sockname"),
        receive_buffer_bytes=65_536,
    )
    radio.address = (host, port)  # type: ignore[attr-defined]
    try:
        yield endpoint, radio
    finally:
        await endpoint.close()
        transport.close()
        await asyncio.sleep(0)


def send(radio: Radio, *frames: bytes) -> None:
    for frame in frames:
        radio.transport.sendto(frame, radio.address)  # type: ignore[attr-defined]


def test_an_exchange_over_the_air():
    async def scenario() -> None:
        under_test = make_unit(section=SECTION)
        passage = make_passage(SECTION)
        arrival = Arrival(passage.passage_id, SECTION.section_id)
        async with on_the_air(under_test) as (_, radio):
            send(radio, *frames_of(arrival, passage_id=passage.passage_id, section_id=SECTION.section_id))
            offer, notice = await radio.messages(2)
            assert isinstance(offer, MapOffer)
            assert isinstance(notice, AdvisoryNotice)
            send(radio, frame_of_passage(passage))
            assert await radio.messages(1) == [Receipt(passage.passage_id, Accepted())]

    asyncio.run(scenario())


def test_rubbish_does_not_stop_what_follows():
    async def scenario() -> None:
        passage = make_passage(SECTION)
        async with on_the_air(make_unit(section=SECTION)) as (_, radio):
            send(radio, b"", b"RG", bytes(9000), frame_of_passage(passage)[:-1], frame_of_passage(passage))
            (receipt,) = (await radio.messages(1))[-1:]
            assert receipt == Receipt(passage.passage_id, Accepted())

    asyncio.run(scenario())


def test_passages_in_work_are_answered_before_the_socket_closes():
    async def scenario() -> None:
        under_test = make_unit(section=SECTION)
        under_test.store.gate = asyncio.Event()
        passage = make_passage(SECTION)
        async with on_the_air(under_test) as (endpoint, radio):
            arrival = Arrival(bytes(16), SECTION.section_id, known_map_version=SECTION.version)
            send(radio, frame_of_passage(passage))
            send(radio, *frames_of(arrival, passage_id=bytes(16), section_id=SECTION.section_id))
            await radio.messages(1)  # the passage, which was sent before, is in work by now
            closing = asyncio.create_task(endpoint.close())
            await asyncio.sleep(0.01)
            under_test.store.gate.set()
            await closing
            assert await radio.messages(1) == [Receipt(passage.passage_id, Accepted())]

    asyncio.run(scenario())


def test_beacons_are_announced_again_and_again():
    async def scenario() -> None:
        async with on_the_air(make_unit(section=SECTION)) as (endpoint, radio):
            task = asyncio.create_task(endpoint.announce(period_s=0.01))
            kinds = [parse_frame(await asyncio.wait_for(radio.heard.get(), 5.0)).kind for _ in range(3)]
            task.cancel()
            assert kinds == [Kind.BEACON] * 3

    asyncio.run(scenario())


def test_a_detection_is_broadcast():
    async def scenario() -> None:
        under_test = make_unit(section=SECTION)
        async with on_the_air(under_test) as (endpoint, radio):
            sent_bytes = endpoint.broadcast(under_test.gateway.guidance(SECTION.section_id))
            offer, _ = await radio.messages(2)
            assert isinstance(offer, MapOffer)
            assert sent_bytes > 0

    asyncio.run(scenario())


def test_an_address_of_another_machine_is_refused_in_words():
    async def scenario() -> None:
        under_test = make_unit(section=SECTION)
        with pytest.raises(ConfigurationError, match=r"192\.0\.2\.1"):
            await open_endpoint(
                under_test.gateway,
                metrics=under_test.metrics,
                host="192.0.2.1",
                port=1,
                broadcast_address=None,
                receive_buffer_bytes=65_536,
            )

    asyncio.run(scenario())


def test_what_the_kernel_drops_is_counted():
    async def story():
        under_test = make_unit()
        async with on_the_air(under_test) as (endpoint, radio):
            send(radio, *[bytes(1400)] * 400)  # many times what the socket's buffer holds, before anybody reads
            await asyncio.sleep(0.1)  # the socket is read before timers are looked at
            endpoint.observe()
            received = under_test.count("roadgrip_frames_received_total", via="udp")
            dropped = under_test.count("roadgrip_frames_dropped_total", via="udp", reason="kernel_buffer_full")
            assert dropped > 0
            assert received + dropped == 400
            endpoint.observe()
            again = under_test.count("roadgrip_frames_dropped_total", via="udp", reason="kernel_buffer_full")
            assert again == dropped

    asyncio.run(story())

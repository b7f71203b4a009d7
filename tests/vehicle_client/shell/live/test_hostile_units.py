"""Units that answer garbage, nothing, halves, drops, or what nobody asked: a pass still ends, within its frames."""

import asyncio
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from roadgrip.features import NEWEST_TABLE
from roadgrip.frames import exchange_id_of, parse_frame, section_key_of, split_into_frames
from roadgrip.protocol import Kind
from roadgrip.records import VEHICLE_FRAME_BUDGET, Accepted, AdvisoryNotice, MapOffer, Message, Receipt
from roadgrip.wire import encode_message, kind_of
from tests.vehicle_client.shell.air import ADVICE, BEND
from tests.vehicle_client.shell.live.cars import ROAD, a_drive
from vehicle_client.shell.live.client import LiveClient
from vehicle_client.shell.live.settings import LiveSettings
from vehicle_client.shell.live.source import PlayedTrace
from vehicle_client.shell.uplink import UnitAddress

pytestmark = [pytest.mark.system, pytest.mark.long, pytest.mark.timeout(120)]

SPEEDUP = 20.0
STORY_LIMIT_S = 90.0
DRIP_S = 5.0
Sends = Callable[[bytes], object]
Behaviour = Callable[[bytes, Sends], None]


def frames_about(message: Message, exchange_id: bytes, *, section_id: str) -> Sequence[bytes]:
    return split_into_frames(
        kind_of(message), encode_message(message), exchange_id=exchange_id, section_key=section_key_of(section_id)
    )


def right_answers(data: bytes) -> list[bytes]:
    """Return map and advice, as a unit would answer an announcement."""
    frame = parse_frame(data)
    if frame.kind is not Kind.ARRIVAL:
        return []
    notice = AdvisoryNotice(ROAD.section_id, ROAD.version, ADVICE, issued_unix_s=0)
    messages: list[Message] = [MapOffer(ROAD, (NEWEST_TABLE.digest,)), notice]
    return [f for m in messages for f in frames_about(m, frame.exchange_id, section_id=ROAD.section_id)]


def garbage(data: bytes, send: Sends) -> None:
    rng = np.random.default_rng(len(data))
    for _ in range(200):
        send(rng.bytes(int(rng.integers(1, 1_400))))


def nothing(_: bytes, send: Sends) -> None:
    del send


def halves(data: bytes, send: Sends) -> None:
    for frame in right_answers(data) * 3:
        send(frame[: len(frame) // 2])


def drops() -> Behaviour:
    """Return a unit that says one frame in five seconds."""
    due: list[float] = []

    def answer(data: bytes, send: Sends) -> None:
        loop = asyncio.get_running_loop()
        for frame in right_answers(data):
            due.append(max([loop.time(), *due[-1:]]) + DRIP_S)
            loop.call_at(due[-1], send, frame)

    return answer


def elsewhere(data: bytes, send: Sends) -> None:
    """Answer in the car's exchange, but about another section and another car's passage."""
    exchange_id = parse_frame(data).exchange_id
    another_id = bytes(16)
    notice = AdvisoryNotice(BEND.section_id, BEND.version, ADVICE, issued_unix_s=0)
    messages: list[Message] = [MapOffer(BEND, (NEWEST_TABLE.digest,)), notice, Receipt(another_id, Accepted())]
    for message in messages:
        for heading in (BEND.section_id, ROAD.section_id):
            for frame in frames_about(message, exchange_id, section_id=heading):
                send(frame)
    for frame in frames_about(messages[-1], exchange_id_of(another_id), section_id=ROAD.section_id):
        send(frame)


class BadUnit(asyncio.DatagramProtocol):
    """Counts what it is sent, and answers as badly as it was made to."""

    def __init__(self, behaviour: Behaviour) -> None:
        self.behaviour = behaviour
        self.heard_count = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.link: Any = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.heard_count += 1
        self.behaviour(data, lambda frame: None if self.link.is_closing() else self.link.sendto(frame, addr))


class Story:
    """One drive past one bad unit."""

    def __init__(self, folder: Path, behaviour: Behaviour) -> None:
        self.spool = folder
        self.unit = BadUnit(behaviour)
        self.lines: list[dict[str, Any]] = []

    async def play(self) -> None:
        loop = asyncio.get_running_loop()
        link, _ = await loop.create_datagram_endpoint(lambda: self.unit, local_addr=("127.0.0.1", 0))
        address = UnitAddress("udp", "127.0.0.1", link.get_extra_info("sockname")[1])
        settings = LiveSettings(spool_folder=self.spool, unit=address, sections=(ROAD,), once=True)
        source = PlayedTrace(a_drive(), speedup_ratio=SPEEDUP)
        client = LiveClient(settings, source, write=lambda line: self.lines.append(json.loads(line)))
        await asyncio.wait_for(client.run(), STORY_LIMIT_S)
        link.close()

    @property
    def passage(self) -> dict[str, Any]:
        (passage,) = [line for line in self.lines if line["event"] == "passage"]
        return passage

    @property
    def counters(self) -> dict[str, Any]:
        assert self.lines[-1]["event"] == "stopped"
        return self.lines[-1]


BEHAVIOURS = {
    "garbage": lambda: garbage,
    "nothing": lambda: nothing,
    "halves": lambda: halves,
    "drops": drops,
    "elsewhere": lambda: elsewhere,
}


@pytest.fixture(scope="module")
def stories(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Story]:
    """All drives at one time: what they take is waiting."""
    folder = tmp_path_factory.mktemp("cars")
    played = {name: Story(folder / name, make()) for name, make in BEHAVIOURS.items()}

    async def play() -> None:
        await asyncio.gather(*(story.play() for story in played.values()))

    asyncio.run(play())
    return played


@pytest.mark.parametrize("name", BEHAVIOURS)
def test_the_drive_is_followed_to_its_end_and_the_summary_waits_for_another_unit(stories: dict[str, Story], name: str):
    story = stories[name]
    assert [line["event"] for line in story.lines if line["event"] != "passage"] == [
        "started",
        "source_ended",
        "stopped",
    ]
    assert story.passage["ending"] == "unanswered"
    assert story.counters["passages_open"] == 0
    assert story.counters["spool_waiting"] == 1


@pytest.mark.parametrize("name", BEHAVIOURS)
def test_the_budget_holds(stories: dict[str, Story], name: str):
    story = stories[name]
    assert 2 <= story.unit.heard_count <= VEHICLE_FRAME_BUDGET
    assert story.passage["frames_sent_count"] == story.unit.heard_count


@pytest.mark.parametrize("name", ["garbage", "halves", "elsewhere"])
def test_what_cannot_be_read_or_believed_is_counted(stories: dict[str, Story], name: str):
    counters = stories[name].counters
    assert counters["frames_refused"] == stories[name].passage["frames_refused_count"] > 0


def test_what_is_about_another_section_is_counted_and_advises_nobody(stories: dict[str, Story]):
    story = stories["elsewhere"]
    assert story.counters["messages_ignored"] > 0
    assert story.passage["advised_speed_mps"] is None


def test_a_unit_that_speaks_slowly_is_heard_out(stories: dict[str, Story]):
    assert stories["drops"].passage["frames_received_count"] >= 1
    assert stories["drops"].counters["frames_refused"] == 0

"""Units among those who are slow, endless or broken: clients that hold on, floods of pieces, air that flips bits."""

from __future__ import annotations

import contextlib
import random
import socket
import time
from collections.abc import Iterator
from http import HTTPStatus

import httpx

from roadgrip.features import NEWEST_TABLE
from roadgrip.frames import Reassembler, parse_frame, section_key_of, split_into_frames
from roadgrip.protocol import FRAGMENT_BYTES, Kind
from tests.faults.remains import judge, remains_of
from tests.faults.sabotage import summed_again
from tests.faults.scenario import Finding, Scenario, Stage
from tests.faults.traffic import PASSAGES_PATH, SECTION_ID, Traffic, receipt_of, section_of
from tests.faults.units import FragileUnit
from tests.rsu_app.sites import frame_of_passage

HALF_OPEN_COUNT, SILENT_COUNT, DRIBBLING_COUNT, DEAF_COUNT = 400, 100, 50, 50
"""More together than the unit serves at one time."""
LET_GO_S = 45.0
"""The longest of the unit's patiences twice: for a header, for a body, for a client that does not read."""
GROWTH_LIMIT_BYTES = 32 * 1024 * 1024
PARTS_COUNT = 100_000
HELD_LIMIT_COUNT = 256
FLIPPED_PASSAGES_COUNT = 200


def slow_clients(stage: Stage) -> Finding:
    """Fill a unit with clients that hold on to their connections, and see who is served meanwhile and afterwards."""
    found = Finding(runs_count=1)
    with FragileUnit(stage.folder, broken=stage.broken) as unit, contextlib.ExitStack() as stack:
        traffic = Traffic(section_of(unit), first_number=stage.chance.randrange(100_000))
        before_bytes = unit.metric("process_resident_memory_bytes")
        ask_for_map = f"GET /v1/sections/{SECTION_ID}/map HTTP/1.1\r\nhost: unit\r\n\r\n"
        post = f"POST {PASSAGES_PATH} HTTP/1.1\r\nhost: unit\r\ncontent-length: 3000\r\n\r\n"
        _crowd(stack, unit, DEAF_COUNT, ask_for_map.encode() * 300)
        dribbling = _crowd(stack, unit, DRIBBLING_COUNT, post.encode())
        _crowd(stack, unit, SILENT_COUNT, b"")
        dribbling += _crowd(stack, unit, HALF_OPEN_COUNT, b"GET /v1/sections HTTP/1.1\r\nhost: unit\r\nx-slow:")
        with traffic.driving(unit, http=False):
            found.expect(traffic.wait_for(50), "by radio nothing is acknowledged meanwhile")
        began_s = time.monotonic()
        answered = _until_answered(unit, dribbling, seconds=LET_GO_S)
        found.expect(answered, f"over HTTP nobody new was answered within {LET_GO_S:.0f} s")
        found.figures["answered_again_s"] = round(time.monotonic() - began_s, 1)
        if answered:
            with traffic.driving(unit, udp=False):
                again = traffic.wait_for(len(traffic.acknowledged) + 20)
            found.expect(again, "over HTTP nothing is acknowledged afterwards")
            growth_bytes = unit.metric("process_resident_memory_bytes") - before_bytes
            found.figures["growth_mb"] = round(growth_bytes / 1e6, 1)
            found.expect(growth_bytes < GROWTH_LIMIT_BYTES, f"memory grew by {growth_bytes / 1e6:.0f} MB")
    found.acknowledged_count = len(traffic.acknowledged)
    found.problems += traffic.strange
    stage.tell(1)
    return found


def _crowd(stack: contextlib.ExitStack, unit: FragileUnit, count: int, beginning: bytes) -> list[socket.socket]:
    """Return connections on which something was begun, and of which nothing is ever read."""
    links = [stack.enter_context(socket.socket()) for _ in range(count)]
    for link in links:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        link.settimeout(5.0)
        with contextlib.suppress(OSError):
            link.connect(("127.0.0.1", unit.ports[0]))
            link.setblocking(False)
            link.send(beginning)
    return links


def _until_answered(unit: FragileUnit, dribbling: list[socket.socket], *, seconds: float) -> bool:
    """Return whether somebody new is answered in time, while those who dribble go on to do so."""
    give_up_s = time.monotonic() + seconds
    while time.monotonic() < give_up_s:
        for link in dribbling:
            with contextlib.suppress(OSError):
                link.send(b"x")
        with contextlib.suppress(httpx.TransportError):
            if httpx.get(f"{unit.url}/v1/sections/{SECTION_ID}/advisory", timeout=5.0).status_code == HTTPStatus.OK:
                return True
        time.sleep(0.5)
    return False


def partial_messages(stage: Stage) -> Finding:
    """Send the unit, and a reassembler of its own making, 100,000 messages of which one piece is missing."""
    chance, found = stage.chance, Finding(runs_count=1)
    with FragileUnit(stage.folder, broken=stage.broken) as unit:
        traffic = Traffic(section_of(unit), first_number=chance.randrange(100_000))
        with traffic.driving(unit):
            traffic.wait_for(20)
        before_bytes = unit.metric("process_resident_memory_bytes")
        received_before = unit.metric("roadgrip_frames_received_total", via="udp")
        with traffic.driving(unit):
            _flood(unit, chance)
            found.expect(traffic.wait_for(len(traffic.acknowledged) + 20), "whole messages are no longer answered")
        received = unit.metric("roadgrip_frames_received_total", via="udp") - received_before
        growth_bytes = unit.metric("process_resident_memory_bytes") - before_bytes
        found.figures |= {"growth_mb": round(growth_bytes / 1e6, 1), "parts_received": received}
        found.expect(received >= PARTS_COUNT / 2, f"only {received:.0f} of the pieces arrived")
        found.expect(growth_bytes < GROWTH_LIMIT_BYTES, f"memory grew by {growth_bytes / 1e6:.0f} MB")
        held = unit.metric("roadgrip_assemblies")
        found.expect(held <= HELD_LIMIT_COUNT, f"{held:.0f} incomplete messages are held")
        dropped = unit.metric("roadgrip_frames_dropped_total") + unit.metric("roadgrip_assemblies_given_up") + held
        found.expect(dropped >= 0.99 * min(received, PARTS_COUNT) - len(traffic.sent), f"{dropped:.0f} were counted")
    found.problems += traffic.strange
    found.problems += _reassembler_problems(chance, broken=stage.broken)
    found.acknowledged_count = len(traffic.acknowledged)
    stage.tell(1)
    return found


def _flood(unit: FragileUnit, chance: random.Random) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", unit.udp_port))
        for number, piece in enumerate(_parts(chance, PARTS_COUNT)):
            with contextlib.suppress(ConnectionError, BlockingIOError):
                link.send(piece)
            if number % 200 == 0:
                time.sleep(0.02)  # what the kernel drops for want of room reaches nobody


def _parts(chance: random.Random, count: int) -> Iterator[bytes]:
    """Yield the first piece of messages of three pieces, each of another exchange, of kinds in turn."""
    payload = chance.randbytes(2 * FRAGMENT_BYTES + 1)
    template = split_into_frames(Kind.MAP, payload, exchange_id=bytes(8), section_key=section_key_of(SECTION_ID))[0]
    for number in range(count):
        kind = (Kind.SUMMARY, Kind.ARRIVAL, Kind.MAP)[number % 3]
        piece = bytearray(template)
        piece[3], piece[8:16] = kind, number.to_bytes(8, "big")
        yield summed_again(piece)


def _reassembler_problems(chance: random.Random, *, broken: str) -> list[str]:
    """Return what is wrong with a reassembler under the same flood, of a kind of message that has pieces."""
    limit_count = 10 * PARTS_COUNT if broken else HELD_LIMIT_COUNT
    reassembler = Reassembler(limit_count=limit_count, limit_bytes=1_048_576 * (1_000 if broken else 1), timeout_s=30.0)
    payload = chance.randbytes(2 * FRAGMENT_BYTES + 1)
    key = section_key_of(SECTION_ID)
    held_most = 0
    for number in range(PARTS_COUNT // 10):
        (first, *_) = split_into_frames(Kind.MAP, payload, exchange_id=number.to_bytes(8, "big"), section_key=key)
        reassembler.offer(parse_frame(first), source="unit", now_s=0.0)
        held_most = max(held_most, reassembler.held_count)
    frames = split_into_frames(Kind.MAP, payload, exchange_id=b"whole-id", section_key=key)
    done = [reassembler.offer(parse_frame(frame), source="unit", now_s=0.0) for frame in frames][-1]
    problems = [] if held_most <= HELD_LIMIT_COUNT else [f"a reassembler holds {held_most} incomplete messages"]
    return (
        problems if done is not None and done.payload == payload else [*problems, "a whole message does not complete"]
    )


def flipped_bits(stage: Stage) -> Finding:
    """Send passages through air that flips one bit in a hundred of every other frame, until each is acknowledged."""
    chance, found = stage.chance, Finding(runs_count=1)
    with FragileUnit(stage.folder, "[frames]\nrefusals_per_s = 1000.0\n", broken=stage.broken) as unit:
        traffic = Traffic(section_of(unit), first_number=chance.randrange(100_000))
        passages = [traffic.next_passage() for _ in range(FLIPPED_PASSAGES_COUNT)]
        spoilt_count = 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.connect(("127.0.0.1", unit.udp_port))
            link.settimeout(0.2)
            for passage in passages:
                frame = frame_of_passage(passage)
                # Some with a single bit, which is the hardest to see.
                for count in (1, 1, max(1, len(frame) * 8 // 100)):
                    link.send(_flipped(frame, count, chance))
                    spoilt_count += 1
                    _drain(link)
            found.figures["spoilt_frames"] = spoilt_count
            dropped = _settled(unit, spoilt_count)
            found.expect(dropped == spoilt_count, f"{spoilt_count} frames were spoilt, {dropped:.0f} were counted")
            found.expect(not unit.stored_ids(), "something was stored of spoilt frames alone")
            for passage in passages:
                for _ in range(20):
                    link.send(frame_of_passage(passage))
                    receipts = [receipt_of(frame) for frame in _drain(link, wait=True)]
                    if any(receipt is not None and traffic.note(receipt) for receipt in receipts):
                        break
        found.expect(len(traffic.acknowledged) == len(passages), f"{len(traffic.acknowledged)} were acknowledged")
        rows = dict(unit.rows("SELECT passage_id, features FROM passages"))
        width = len(NEWEST_TABLE.kinematic)
        changed = [
            passage_id
            for passage_id, values in rows.items()
            if passage_id not in traffic.sent
            or tuple(memoryview(values).cast("f")[:width]) != tuple(traffic.sent[passage_id].summary.values)
        ]
        found.expect(not changed, f"{len(changed)} stored passages are not as anybody sent them")
        unit.kill()
    judge(found, remains_of(unit.database), traffic.acknowledged)
    found.acknowledged_count = len(traffic.acknowledged)
    stage.tell(1)
    return found


def _flipped(frame: bytes, count: int, chance: random.Random) -> bytes:
    spoilt = bytearray(frame)
    for bit in chance.sample(range(len(frame) * 8), count):
        spoilt[bit // 8] ^= 1 << bit % 8
    return bytes(spoilt)


def _drain(link: socket.socket, *, wait: bool = False) -> list[bytes]:
    """Return what has come; waits for the first a little if asked to."""
    heard: list[bytes] = []
    link.settimeout(1.0 if wait else 0.002)
    with contextlib.suppress(TimeoutError, ConnectionError):
        while True:
            heard.append(link.recv(2000))
            link.settimeout(0.001)
    return heard


def _settled(unit: FragileUnit, count: int) -> float:
    """Return how many frames were dropped, once it is as many as expected or no longer grows."""
    give_up_s = time.monotonic() + 10.0
    dropped = unit.metric("roadgrip_frames_dropped_total", via="udp")
    while dropped < count and time.monotonic() < give_up_s:
        time.sleep(0.1)
        dropped = unit.metric("roadgrip_frames_dropped_total", via="udp")
    return dropped


SCENARIOS = (
    Scenario(
        name="slow-clients",
        promise="Passages by radio are acknowledged meanwhile; over HTTP somebody new is answered as soon as the "
        "slow are "
        "let go, after 45 s at most; memory grows by less than 32 MB.",
        conditions="600 connections at once, above the limit of 512: 400 half a header and a byte now and then, "
        "100 silent, "
        "50 half a body, 50 that ask 300 times for the map and never read",
        runs_count=3,
        perform=slow_clients,
        controls=("patience has no end",),
    ),
    Scenario(
        name="partial-messages",
        promise="At most 256 incomplete messages are held, memory grows by less than 32 MB, each piece is counted, and "
        "whole messages are answered meanwhile.",
        conditions="100,000 first pieces of messages whose other pieces never come, each of another exchange, by UDP "
        "among traffic; 10,000 more to a reassembler alone",
        runs_count=2,
        perform=partial_messages,
        controls=("incomplete messages have no limit",),
    ),
    Scenario(
        name="flipped-bits",
        promise="Nothing is accepted that was not sent, each spoilt frame is counted, and the same passages are "
        "accepted "
        "whole afterwards.",
        conditions="200 passages by UDP, each three times with flipped bits (one, one, and one in a hundred), "
        "then whole",
        runs_count=5,
        perform=flipped_bits,
        controls=("sums are not looked at",),
    ),
)

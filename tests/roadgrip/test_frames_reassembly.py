"""Pieces become messages again whatever the air does, and memory stays bounded."""

import tracemalloc
import zlib
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from roadgrip.errors import WireError
from roadgrip.frames import (
    ENTRY_BYTES,
    Complete,
    Reassembler,
    parse_frame,
    section_key_of,
    split_into_frames,
)
from roadgrip.protocol import FRAGMENT_BYTES, FRAMES_LIMIT_COUNT
from roadgrip.wire import Kind, decode_message, encode_message
from tests.roadgrip.wire_samples import SAMPLES

EXCHANGE_ID = bytes(range(8))
SECTION_KEY = section_key_of("long-turn")


def frames_of(payload: bytes, *, kind: Kind = Kind.MAP, exchange_id: bytes = EXCHANGE_ID) -> tuple[bytes, ...]:
    return split_into_frames(kind, payload, exchange_id=exchange_id, section_key=SECTION_KEY)


def reassembler(*, limit_count: int = 100, limit_bytes: int = 1_000_000, timeout_s: float = 5.0) -> Reassembler:
    return Reassembler(limit_count=limit_count, limit_bytes=limit_bytes, timeout_s=timeout_s)


def offer_all(
    assembly: Reassembler, datagrams: Iterable[bytes], *, source: str = "unit", now_s: float = 0.0
) -> list[Complete]:
    answers = [assembly.offer(parse_frame(datagram), source=source, now_s=now_s) for datagram in datagrams]
    return [answer for answer in answers if answer is not None]


PAYLOAD = bytes(np.random.default_rng(1).integers(0, 256, 4000, dtype=np.uint8))
OTHER_PAYLOAD = PAYLOAD[:2000] + bytes(2000)


@given(st.permutations(range(5)), st.integers(1, FRAGMENT_BYTES))
def test_any_order_will_do(order, last_bytes):
    payload = np.random.default_rng(last_bytes).bytes(4 * FRAGMENT_BYTES + last_bytes)
    frames = frames_of(payload)
    (complete,) = offer_all(reassembler(), [frames[i] for i in order])
    assert complete == Complete(Kind.MAP, SECTION_KEY, EXCHANGE_ID, payload)


def test_a_message_of_one_frame_passes_straight_through_every_time():
    assembly = reassembler()
    (frame,) = frames_of(b"short", kind=Kind.SUMMARY)
    assert [c.payload for c in offer_all(assembly, [frame, frame])] == [b"short", b"short"]
    assert assembly.held_count == 0


def test_the_pieces_of_a_retransmission_add_up_with_those_of_the_first_transmission():
    frames = frames_of(PAYLOAD)
    assembly = reassembler()
    assert offer_all(assembly, [frames[0]]) == []
    assert [c.payload for c in offer_all(assembly, [frames[0], frames[2], frames[1]])] == [PAYLOAD]
    assert assembly.counters.duplicates_count == 1


def test_a_message_of_many_frames_is_delivered_once_and_late_pieces_are_known():
    frames = frames_of(PAYLOAD)
    assembly = reassembler()
    assert len(offer_all(assembly, [*frames, *frames])) == 1
    assert assembly.counters.duplicates_count == len(frames)
    assert assembly.held_bytes == ENTRY_BYTES


def test_after_the_timeout_it_is_delivered_again():
    assembly = reassembler(timeout_s=5.0)
    frames = frames_of(PAYLOAD)
    assert len(offer_all(assembly, frames, now_s=0.0)) == 1
    assert len(offer_all(assembly, frames, now_s=5.1)) == 1
    assert assembly.counters.expired_count == 0


def test_what_stays_incomplete_expires():
    assembly = reassembler(timeout_s=5.0)
    frames = frames_of(PAYLOAD)
    offer_all(assembly, frames[:2], now_s=0.0)
    assert offer_all(assembly, frames[2:], now_s=5.1) == []
    assert assembly.counters.expired_count == 1
    assembly.expire(now_s=11.0)
    assert (assembly.held_count, assembly.held_bytes) == (0, 0)


def test_pieces_of_different_sources_exchanges_and_kinds_never_mix():
    frames = frames_of(PAYLOAD)
    assembly = reassembler()
    offer_all(assembly, frames[:2], source="one unit")
    assert offer_all(assembly, frames[2:], source="another unit") == []
    assert offer_all(assembly, frames_of(PAYLOAD, exchange_id=bytes(8))[2:], source="one unit") == []
    assert [c.payload for c in offer_all(assembly, frames[2:], source="one unit")] == [PAYLOAD]


@given(st.permutations([(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)]))
def test_two_messages_under_one_key_both_arrive_whole(order):
    both = (frames_of(PAYLOAD), frames_of(OTHER_PAYLOAD))
    arrived = offer_all(reassembler(), [both[which][piece] for which, piece in order])
    assert sorted(c.payload for c in arrived) == sorted([PAYLOAD, OTHER_PAYLOAD])


@given(st.permutations(range(5)))
def test_a_longer_message_under_the_same_key_does_not_disturb(order):
    longer = PAYLOAD + bytes(2000)
    frames = [*frames_of(longer)[:2], *frames_of(PAYLOAD)]
    assert [c.payload for c in offer_all(reassembler(), [frames[i] for i in order])] == [PAYLOAD]


def lying_piece(index: int) -> bytes:
    """Return a piece of PAYLOAD with other content but valid checksums, as only a forger makes it."""
    honest = frames_of(PAYLOAD)[index]
    fragment = bytes(len(honest) - 28)
    return honest[:24] + zlib.crc32(honest[:24] + fragment).to_bytes(4, "big") + fragment


def test_a_forged_piece_never_yields_a_wrong_message_and_a_retransmission_heals():
    frames = frames_of(PAYLOAD)
    assembly = reassembler()
    assert offer_all(assembly, [frames[0], lying_piece(1), frames[2]]) == []
    assert assembly.counters.conflicting_count == 1
    assert assembly.held_count == 0
    assert [c.payload for c in offer_all(assembly, frames)] == [PAYLOAD]


def test_an_honest_piece_replaces_a_forged_one():
    frames = frames_of(PAYLOAD)
    assembly = reassembler()
    assert [c.payload for c in offer_all(assembly, [lying_piece(1), frames[0], frames[1], frames[2]])] == [PAYLOAD]
    assert assembly.counters.conflicting_count == 1


def test_the_oldest_gives_way():
    assembly = reassembler(limit_count=2)
    exchanges = [bytes([i]) * 8 for i in range(3)]
    for exchange_id in exchanges:
        offer_all(assembly, frames_of(PAYLOAD, exchange_id=exchange_id)[:1])
    assert assembly.held_count == 2
    assert assembly.counters.evicted_count == 1
    assert offer_all(assembly, frames_of(PAYLOAD, exchange_id=exchanges[0])[1:]) == []
    # The attempt above pushed out the second one; the third is still there.
    assert len(offer_all(assembly, frames_of(PAYLOAD, exchange_id=exchanges[2])[1:])) == 1


def test_a_flood_of_pieces_does_not_hold_up_messages_of_one_frame():
    assembly = reassembler(limit_count=10)
    for i in range(1000):
        offer_all(assembly, frames_of(PAYLOAD, exchange_id=i.to_bytes(8, "big"))[:1])
    assert len(offer_all(assembly, frames_of(b"short", kind=Kind.SUMMARY))) == 1


def test_a_hundred_thousand_incomplete_messages_stay_within_the_memory_that_was_granted():
    limit_bytes = 2_000_000
    assembly = reassembler(limit_count=10_000, limit_bytes=limit_bytes, timeout_s=1e9)
    datagram = frames_of(bytes(2 * FRAGMENT_BYTES), exchange_id=bytes(8))[0]
    template = parse_frame(datagram)
    tracemalloc.start()
    try:
        for i in range(100_000):
            frame = template._replace(exchange_id=i.to_bytes(8, "big"), fragment=bytes(FRAGMENT_BYTES))
            assembly.offer(frame, source=("192.0.2.1", i % 60_000), now_s=float(i))
            if i % 10_000 == 0:
                assert assembly.held_bytes <= limit_bytes
        held_bytes, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert assembly.counters.evicted_count == 100_000 - assembly.held_count
    assert assembly.held_count == limit_bytes // (ENTRY_BYTES + FRAGMENT_BYTES)
    assert held_bytes < 1.25 * limit_bytes
    assert peak_bytes < 1.5 * limit_bytes


class Air:
    """Loses, repeats, reorders, damages and delays frames, as a seed says."""

    def __init__(self, seed: int, *, loss_frac: float, duplicate_frac: float, damage_frac: float) -> None:
        self.rng = np.random.default_rng(seed)
        self.loss_frac = loss_frac
        self.duplicate_frac = duplicate_frac
        self.damage_frac = damage_frac

    def carry(self, sent: list[tuple[str, bytes]]) -> list[tuple[str, bytes]]:
        arrived = []
        for source, datagram in sent:
            copies = 0 if self.rng.random() < self.loss_frac else 1 + (self.rng.random() < self.duplicate_frac)
            for _ in range(copies):
                bits = np.unpackbits(np.frombuffer(datagram, np.uint8))
                if self.rng.random() < self.damage_frac:
                    bits ^= self.rng.random(len(bits)) < 0.01
                arrived.append((source, np.packbits(bits).tobytes()))
        self.rng.shuffle(arrived)
        return arrived


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32),
    loss_frac=st.floats(0.0, 0.5),
    duplicate_frac=st.floats(0.0, 0.5),
    damage_frac=st.floats(0.0, 0.5),
)
def test_many_exchanges_at_once_over_bad_air_deliver_every_message_and_no_other(
    seed, loss_frac, duplicate_frac, damage_frac
):
    air = Air(seed, loss_frac=loss_frac, duplicate_frac=duplicate_frac, damage_frac=damage_frac)
    assembly = reassembler(limit_count=1000, limit_bytes=10_000_000, timeout_s=1e6)
    sent: dict[tuple[str, bytes, Kind], bytes] = {}
    for i in range(12):
        for kind in (Kind.MAP, Kind.SUMMARY):
            size = int(air.rng.integers(1, FRAGMENT_BYTES * FRAMES_LIMIT_COUNT[kind] + 1))
            sent[f"vehicle {i % 5}", i.to_bytes(8, "big"), kind] = air.rng.bytes(size)
    missing = dict(sent)
    for attempt in range(200):
        flying = [
            (source, datagram)
            for (source, exchange_id, kind), payload in missing.items()
            for datagram in frames_of(payload, kind=kind, exchange_id=exchange_id)
        ]
        for source, datagram in air.carry(flying):
            try:
                frame = parse_frame(datagram)
            except WireError:
                continue
            complete = assembly.offer(frame, source=source, now_s=float(attempt))
            if complete is not None:
                key = (source, complete.exchange_id, complete.kind)
                assert sent[key] == complete.payload
                missing.pop(key, None)
        if not missing:
            break
    assert missing == {}


def test_a_real_map_survives_the_air_in_pieces():
    offer = SAMPLES["map-in-pieces"]
    frames = frames_of(encode_message(offer))
    assert len(frames) == 3
    (complete,) = offer_all(reassembler(), reversed(frames))
    assert decode_message(complete.kind, complete.payload) == offer


class ReassemblyLife(RuleBasedStateMachine):
    """Whatever is offered in whatever order: limits hold, the books balance, nothing wrong comes out."""

    def __init__(self) -> None:
        super().__init__()
        self.assembly = reassembler(limit_count=4, limit_bytes=12_000, timeout_s=10.0)
        self.now_s = 0.0
        self.payloads = [bytes([i]) * (FRAGMENT_BYTES * (i % 3 + 1) + 7) for i in range(6)]

    @rule(which=st.integers(0, 5), piece=st.integers(0, 3), exchange=st.integers(0, 5))
    def offer(self, which, piece, exchange):
        frames = frames_of(self.payloads[which], exchange_id=bytes([exchange]) * 8)
        frame = parse_frame(frames[piece % len(frames)])
        complete = self.assembly.offer(frame, source="unit", now_s=self.now_s)
        if complete is not None:
            assert complete.payload == self.payloads[which]

    @precondition(lambda self: self.now_s < 1000)
    @rule(step_s=st.floats(0.0, 6.0))
    def wait(self, step_s):
        self.now_s += step_s

    @rule()
    def expire(self):
        self.assembly.expire(now_s=self.now_s)

    @invariant()
    def memory_is_bounded(self):
        assert self.assembly.held_count <= 4
        assert 0 <= self.assembly.held_bytes <= 12_000
        assert (self.assembly.held_count == 0) == (self.assembly.held_bytes == 0)


TestReassemblyLife = pytest.mark.filterwarnings("error")(ReassemblyLife.TestCase)
TestReassemblyLife.settings = settings(max_examples=40, stateful_step_count=40, deadline=None)

"""Frames: cut, checked, refused."""

import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.errors import WireError
from roadgrip.frames import (
    BODY_LIMIT_COUNT,
    answerable_exchange,
    exchange_id_of,
    iter_frames,
    join_frames,
    parse_frame,
    section_key_of,
    split_into_frames,
    unread_passage_id,
)
from roadgrip.protocol import FRAGMENT_BYTES, FRAME_LIMIT_BYTES, FRAMES_LIMIT_COUNT, HEADER_BYTES
from roadgrip.reasons import Reason
from roadgrip.wire import Kind

EXCHANGE_ID = bytes(range(8))
SECTION_KEY = section_key_of("long-turn")


def frames_of(payload: bytes, *, kind: Kind = Kind.MAP, exchange_id: bytes = EXCHANGE_ID) -> tuple[bytes, ...]:
    return split_into_frames(kind, payload, exchange_id=exchange_id, section_key=SECTION_KEY)


def forged(fragment: bytes = b"x", **changes: int | bytes) -> bytes:
    """Return a frame with a header of any content and right checksums."""
    header: dict[str, int | bytes] = {
        "magic": b"RG",
        "version": 1,
        "kind": 2,
        "section_key": SECTION_KEY,
        "exchange_id": EXCHANGE_ID,
        "index": 0,
        "count": 1,
        "length": len(fragment),
        "message_crc": zlib.crc32(fragment),
    }
    head = struct.pack(">2sBB4s8sBBHI", *{**header, **changes}.values())
    return head + struct.pack(">I", zlib.crc32(head + fragment)) + fragment


def reason_of(datagram: bytes) -> Reason:
    with pytest.raises(WireError) as caught:
        parse_frame(datagram)
    return caught.value.reason


@given(st.binary(min_size=1, max_size=5 * FRAGMENT_BYTES))
def test_the_pieces_make_up_the_message_and_say_where_they_belong(payload):
    frames = [parse_frame(datagram) for datagram in frames_of(payload)]
    assert b"".join(frame.fragment for frame in frames) == payload
    assert [frame.piece_index for frame in frames] == list(range(len(frames)))
    assert {frame.pieces_count for frame in frames} == {len(frames)}
    assert {(frame.kind, frame.exchange_id, frame.section_key) for frame in frames} == {
        (Kind.MAP, EXCHANGE_ID, SECTION_KEY)
    }


@given(st.binary(min_size=1, max_size=5 * FRAGMENT_BYTES))
def test_no_frame_is_longer_than_a_packet(payload):
    assert max(len(datagram) for datagram in frames_of(payload)) <= 1400


def test_the_header_is_as_documented_and_leaves_1372_bytes():
    (datagram,) = frames_of(b"abc", kind=Kind.SUMMARY)
    head = b"RG\x01\x04" + SECTION_KEY + EXCHANGE_ID + b"\x00\x01\x00\x03" + zlib.crc32(b"abc").to_bytes(4, "big")
    assert datagram == head + zlib.crc32(head + b"abc").to_bytes(4, "big") + b"abc"
    assert (HEADER_BYTES, FRAGMENT_BYTES, FRAME_LIMIT_BYTES) == (28, 1372, 1400)


def test_the_same_message_gives_the_same_frames_again():
    assert frames_of(bytes(5000)) == frames_of(bytes(5000))


@pytest.mark.parametrize("kind", Kind)
def test_a_message_longer_than_its_kind_may_be_is_not_cut(kind):
    longest = FRAMES_LIMIT_COUNT[kind] * FRAGMENT_BYTES
    assert len(frames_of(bytes(longest), kind=kind)) == FRAMES_LIMIT_COUNT[kind]
    with pytest.raises(WireError) as caught:
        frames_of(bytes(longest + 1), kind=kind)
    assert caught.value.reason is Reason.OVERSIZED


def test_an_empty_message_is_not_cut():
    with pytest.raises(WireError):
        frames_of(b"")


def test_ids_of_another_length_are_a_mistake():
    with pytest.raises(ValueError):
        split_into_frames(Kind.MAP, b"x", exchange_id=b"short", section_key=SECTION_KEY)
    with pytest.raises(ValueError):
        split_into_frames(Kind.MAP, b"x", exchange_id=EXCHANGE_ID, section_key=b"long-turn")


def test_a_forged_frame_with_nothing_wrong_is_read():
    assert parse_frame(forged()).fragment == b"x"


@pytest.mark.parametrize(
    ("datagram", "reason"),
    [
        (b"", Reason.MALFORMED),
        (b"RG", Reason.MALFORMED),
        (frames_of(b"x")[0][:-2], Reason.MALFORMED),
        (b"XX" + frames_of(b"x")[0][2:], Reason.MALFORMED),
        (frames_of(b"xyz")[0][:-1], Reason.BAD_CHECKSUM),
        (frames_of(b"xyz")[0] + b"\x00", Reason.BAD_CHECKSUM),
        (frames_of(bytes(FRAGMENT_BYTES))[0] + b"\x00", Reason.OVERSIZED),
        (bytes(65_507), Reason.OVERSIZED),
        (forged(version=0), Reason.UNSUPPORTED_VERSION),
        (forged(version=2), Reason.UNSUPPORTED_VERSION),
        (b"RG\x02" + bytes(40), Reason.UNSUPPORTED_VERSION),
        (forged(kind=0), Reason.MALFORMED),
        (forged(kind=8), Reason.MALFORMED),
        (forged(count=0), Reason.MALFORMED),
        (forged(index=1), Reason.MALFORMED),
        (forged(count=2), Reason.MALFORMED),  # only the last piece may be short
        (forged(count=6), Reason.OVERSIZED),
        (forged(kind=4, count=2), Reason.OVERSIZED),
        (forged(length=2), Reason.MALFORMED),
        (forged(b""), Reason.MALFORMED),
        (forged(message_crc=1), Reason.MALFORMED),
    ],
)
def test_what_is_no_frame_is_refused_with_its_reason(datagram, reason):
    assert reason_of(datagram) is reason


@given(st.binary(max_size=1500))
def test_random_bytes_are_no_frame(datagram):
    with pytest.raises(WireError):
        parse_frame(datagram)


@given(st.binary(max_size=1500))
def test_random_bytes_behind_a_magic_are_no_frame(datagram):
    with pytest.raises(WireError):
        parse_frame(b"RG\x01\x04" + datagram)


@given(st.integers(1, FRAGMENT_BYTES), st.sets(st.integers(0, 2**20), min_size=1, max_size=40))
def test_no_flipped_bit_goes_unnoticed(size, positions):
    (datagram,) = frames_of(bytes(i % 251 for i in range(size)))
    damaged = bytearray(datagram)
    bits = {position % (8 * len(datagram)) for position in positions}
    for bit in bits:
        damaged[bit // 8] ^= 1 << bit % 8
    with pytest.raises(WireError):
        parse_frame(bytes(damaged))


# Answers to what could not be read.


@pytest.mark.parametrize(
    "datagram", [forged(version=2), forged(kind=9), forged(count=9), forged(version=2) + bytes(2000)]
)
def test_a_refusal_finds_the_exchange_in_any_version(datagram):
    assert answerable_exchange(datagram, reason_of(datagram)) == EXCHANGE_ID


@pytest.mark.parametrize("datagram", [b"", b"RG\x01", b"HTTP" * 20, forged()[:-1] + b"y"])
def test_noise_and_damaged_frames_are_met_with_silence(datagram):
    assert answerable_exchange(datagram, reason_of(datagram)) is None


def test_the_receipt_of_an_unread_message_names_its_exchange():
    passage_id = unread_passage_id(EXCHANGE_ID)
    assert len(passage_id) == 16
    assert exchange_id_of(passage_id) == EXCHANGE_ID


# Bodies of HTTP requests.


@given(st.lists(st.binary(min_size=1, max_size=2000), max_size=10))
def test_joined_frames_come_apart_again(payloads):
    frames = [frame for payload in payloads for frame in frames_of(payload)]
    assert list(iter_frames(join_frames(frames))) == frames


@pytest.mark.parametrize(
    "body", [b"x", b"{}", forged()[:-1], forged() + b"RG", forged() + forged()[:20], forged() + bytes(28)]
)
def test_a_body_that_is_no_row_of_frames_is_malformed(body):
    with pytest.raises(WireError) as caught:
        list(iter_frames(body))
    assert caught.value.reason is Reason.MALFORMED


def test_a_body_holds_no_more_frames_than_a_passage():
    assert len(list(iter_frames(forged() * BODY_LIMIT_COUNT))) == BODY_LIMIT_COUNT == 20
    with pytest.raises(WireError) as caught:
        list(iter_frames(forged() * (BODY_LIMIT_COUNT + 1)))
    assert caught.value.reason is Reason.OVERSIZED


def test_a_huge_body_is_refused_before_it_is_read():
    with pytest.raises(WireError) as caught:
        next(iter_frames(bytes(10_000_000)))
    assert caught.value.reason is Reason.OVERSIZED


@given(st.binary(max_size=3000))
def test_random_bodies_are_rows_of_frames_or_refused(body):
    try:
        frames = list(iter_frames(body))
    except WireError:
        return
    assert join_frames(frames) == body


def test_a_frame_of_another_version_is_found_in_a_body_so_that_it_can_be_answered():
    body = forged(version=2) + forged()
    assert [frame[2] for frame in iter_frames(body)] == [2, 1]

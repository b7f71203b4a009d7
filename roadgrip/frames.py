"""Frames: how messages travel in packets of at most 1,400 bytes.

A frame is a header of 28 bytes and a piece of one message. Numbers are big-endian::

    offset size
         0    2  magic "RG"
         2    1  version of the format, 1
         3    1  kind of message, `roadgrip.protocol.Kind`
         4    4  section key: which section the exchange is about
         8    8  exchange id: the first half of the passage id; random where there is no passage
        16    1  index of this piece
        17    1  count of pieces
        18    2  bytes of this piece
        20    4  CRC-32 of the whole message
        24    4  CRC-32 of this header before this field, followed by the piece

The first twenty bytes keep their place in every later version, so that a unit can refuse a version it does not
speak to the very exchange that used it. Every piece but the last is as long as possible: index and count alone say
where a piece belongs. The message's CRC keeps the pieces of two different messages of one exchange apart.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections import OrderedDict
from collections.abc import Hashable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

from roadgrip.errors import WireError
from roadgrip.protocol import (
    FRAGMENT_BYTES,
    FRAME_LIMIT_BYTES,
    FRAMES_LIMIT_COUNT,
    HEADER_BYTES,
    PROTOCOL_VERSION,
    Kind,
)
from roadgrip.reasons import Reason
from roadgrip.records import PASSAGE_ID_BYTES, RSU_FRAME_BUDGET, VEHICLE_FRAME_BUDGET

MAGIC = b"RG"
EXCHANGE_ID_BYTES = 8
SECTION_KEY_BYTES = 4
BODY_LIMIT_COUNT = VEHICLE_FRAME_BUDGET + RSU_FRAME_BUDGET
"""Frames in one HTTP body: no more than there are in a whole passage."""

_HEADER = struct.Struct(">2sBB4s8sBBHI")
_CRC = struct.Struct(">I")
_WHOLE = struct.Struct(_HEADER.format + "I")
_KINDS = {int(kind): kind for kind in Kind}


class Frame(NamedTuple):
    """One packet, parsed and checked. A named tuple, since a unit makes thousands of them in a second.

    Attributes:
        kind: What message it is a piece of.
        section_key: `section_key_of` the section.
        exchange_id: Ties the frames of one passage together.
        piece_index: Which piece of the message this is.
        pieces_count: Of how many.
        message_crc: CRC-32 of the whole message.
        crc: CRC-32 of this frame; two frames with equal ones are the same.
        fragment: The piece.
    """

    kind: Kind
    section_key: bytes
    exchange_id: bytes
    piece_index: int
    pieces_count: int
    message_crc: int
    crc: int
    fragment: bytes


@lru_cache(maxsize=1024)
def section_key_of(section_id: str) -> bytes:
    """Return the four bytes that stand for a section in a header. Two sections may share them; messages say the id."""
    return hashlib.sha256(section_id.encode()).digest()[:SECTION_KEY_BYTES]


def exchange_id_of(passage_id: bytes) -> bytes:
    """Return the exchange that a passage belongs to: the first half of its id."""
    return passage_id[:EXCHANGE_ID_BYTES]


def unread_passage_id(exchange_id: bytes) -> bytes:
    """Return the passage id for the receipt of a message that could not be read: its exchange id and eight zeros.

    The vehicle knows the receipt by the exchange id in the frame's header.
    """
    return exchange_id.ljust(PASSAGE_ID_BYTES, b"\0")


def split_into_frames(kind: Kind, payload: bytes, *, exchange_id: bytes, section_key: bytes) -> tuple[bytes, ...]:
    """Return the frames that carry a message. The same message gives the same frames again.

    Args:
        kind: What the message is.
        payload: The message, as `roadgrip.wire.encode_message` gave it.
        exchange_id: Eight bytes.
        section_key: Four bytes.

    Raises:
        WireError: OVERSIZED; such a message is longer than its kind may be. MALFORMED; it is empty.
        ValueError: An id has the wrong length.
    """
    if len(exchange_id) != EXCHANGE_ID_BYTES or len(section_key) != SECTION_KEY_BYTES:
        raise ValueError("an exchange id has 8 bytes, a section key 4")
    if not payload:
        raise WireError(Reason.MALFORMED, "an empty message")
    count = -(-len(payload) // FRAGMENT_BYTES)
    if count > FRAMES_LIMIT_COUNT[kind]:
        raise WireError(
            Reason.OVERSIZED, f"{kind.name} of {len(payload)} bytes, {count} of {FRAMES_LIMIT_COUNT[kind]} frames"
        )
    message_crc = zlib.crc32(payload)
    frames = []
    for index in range(count):
        fragment = payload[index * FRAGMENT_BYTES : (index + 1) * FRAGMENT_BYTES]
        head = _HEADER.pack(
            MAGIC, PROTOCOL_VERSION, kind, section_key, exchange_id, index, count, len(fragment), message_crc
        )
        frames.append(head + _CRC.pack(zlib.crc32(fragment, zlib.crc32(head))) + fragment)
    return tuple(frames)


def parse_frame(datagram: bytes) -> Frame:
    """Return the frame that a datagram holds.

    Raises:
        WireError: OVERSIZED, MALFORMED, UNSUPPORTED_VERSION or BAD_CHECKSUM. To whom a refusal may be answered is
            said by `answerable_exchange`.
    """
    size = len(datagram)
    if size > FRAME_LIMIT_BYTES:
        raise WireError(Reason.OVERSIZED, f"a frame of {size} bytes; {FRAME_LIMIT_BYTES} are possible")
    if size < HEADER_BYTES or datagram[:2] != MAGIC:
        raise WireError(Reason.MALFORMED, "not a frame")
    _, version, kind_code, section_key, exchange_id, index, count, length, message_crc, crc = _WHOLE.unpack_from(
        datagram
    )
    if version != PROTOCOL_VERSION:
        raise WireError(Reason.UNSUPPORTED_VERSION, f"version {version}; this software speaks {PROTOCOL_VERSION}")
    fragment = datagram[HEADER_BYTES:]
    if zlib.crc32(fragment, zlib.crc32(datagram[: _HEADER.size])) != crc:
        raise WireError(Reason.BAD_CHECKSUM, "the frame was damaged on its way")
    kind = _KINDS.get(kind_code)
    if kind is None:
        raise WireError(Reason.MALFORMED, f"no message has the kind {kind_code}")
    if count > FRAMES_LIMIT_COUNT[kind]:
        raise WireError(Reason.OVERSIZED, f"{kind.name} in {count} frames; {FRAMES_LIMIT_COUNT[kind]} are possible")
    full = length == FRAGMENT_BYTES if index + 1 < count else 0 < length <= FRAGMENT_BYTES
    if index >= count or length != len(fragment) or not full:
        raise WireError(Reason.MALFORMED, f"piece {index} of {count} with {len(fragment)} bytes cannot be")
    if count == 1 and zlib.crc32(fragment) != message_crc:
        raise WireError(Reason.MALFORMED, "the frame and its message have contradicting checksums")
    return Frame(kind, section_key, exchange_id, index, count, message_crc, crc, fragment)


def answerable_exchange(datagram: bytes, reason: Reason) -> bytes | None:
    """Return the exchange to which the refusal of a datagram may be answered, or None where silence is right.

    A damaged frame counts as lost: its header cannot be believed, and the sender repeats it anyway. What does not
    begin like one of ours is none of our business. The rest deserves a receipt with the reason.
    """
    if reason is Reason.BAD_CHECKSUM or datagram[:2] != MAGIC or len(datagram) < HEADER_BYTES:
        return None
    return datagram[8:16]


def join_frames(frames: Iterable[bytes]) -> bytes:
    """Return the body of an HTTP request or answer that carries frames one after the other."""
    return b"".join(frames)


def iter_frames(body: bytes) -> Iterator[bytes]:
    """Yield the frames of an HTTP body, each ready for `parse_frame`, which also checks it.

    Raises:
        WireError: MALFORMED; the body is not a row of frames. OVERSIZED; there are more than a passage may have.
    """
    if len(body) > BODY_LIMIT_COUNT * FRAME_LIMIT_BYTES:
        raise WireError(Reason.OVERSIZED, f"a body of {len(body)} bytes")
    start = 0
    for _ in range(BODY_LIMIT_COUNT):
        if start == len(body):
            return
        if len(body) - start < HEADER_BYTES or body[start : start + 2] != MAGIC:
            raise WireError(Reason.MALFORMED, f"no frame begins at byte {start} of the body")
        end = start + HEADER_BYTES + int.from_bytes(body[start + 18 : start + 20], "big")
        if end > len(body):
            raise WireError(Reason.MALFORMED, f"the body ends inside the frame that begins at byte {start}")
        yield body[start:end]
        start = end
    if start < len(body):
        raise WireError(Reason.OVERSIZED, f"more than {BODY_LIMIT_COUNT} frames in one body")


class Complete(NamedTuple):
    """A whole message, as its frames delivered it; `roadgrip.exchange.message_of` reads it.

    Attributes:
        kind: What it is.
        section_key: As in the frames.
        exchange_id: As in the frames.
        payload: The bytes for `roadgrip.wire.decode_message`.
    """

    kind: Kind
    section_key: bytes
    exchange_id: bytes
    payload: bytes


@dataclass(slots=True)
class ReassemblyCounters:
    """What a reassembler has seen.

    Attributes:
        completed_count: Messages that became whole.
        duplicates_count: Pieces that were there already, or whose message was.
        expired_count: Messages that stayed incomplete for too long.
        evicted_count: Messages that were given up for newer ones.
        conflicting_count: Pieces or messages that contradict their checksums.
    """

    completed_count: int = 0
    duplicates_count: int = 0
    expired_count: int = 0
    evicted_count: int = 0
    conflicting_count: int = 0


@dataclass(slots=True)
class _Partial:
    started_s: float
    pieces: dict[int, bytes] | None = field(default_factory=dict)
    """None once the message is whole: what comes late is then known to be late."""
    held_bytes: int = 0


ENTRY_BYTES = 700
"""What an incomplete message costs besides its pieces: key, record, dictionaries (measured)."""


class Reassembler:
    """Puts the pieces of messages together, whatever their order, in bounded memory.

    Most messages are one frame and pass straight through; they neither need nor get a place in memory, so a flood
    of pieces cannot hold them up. Pieces belong together when source, exchange, kind, section, count and the
    message's checksum agree. A retransmission has all of them in common with the first transmission, so the pieces
    of both add up; another message of the same exchange has another checksum and is gathered beside it.

    Within one such message, a piece that differs from the one that is there replaces it: the frame's checksum
    excludes damage, so one of the two lies. When the whole then contradicts its checksum all pieces are dropped, and
    a retransmission starts afresh.
    """

    def __init__(self, *, limit_count: int, limit_bytes: int, timeout_s: float) -> None:
        """Start empty.

        Args:
            limit_count: Messages that are gathered at the same time; beyond it the oldest is given up.
            limit_bytes: Memory for all of them, `ENTRY_BYTES` for each included.
            timeout_s: How long after its first piece a message is given up.
        """
        self._limit_count = limit_count
        self._limit_bytes = limit_bytes
        self._timeout_s = timeout_s
        self._partials: OrderedDict[Hashable, _Partial] = OrderedDict()
        self._held_bytes = 0
        self.counters = ReassemblyCounters()

    @property
    def held_count(self) -> int:
        """Messages in memory, whole ones that are remembered for late pieces included."""
        return len(self._partials)

    @property
    def held_bytes(self) -> int:
        """Memory in use, by the measure of `limit_bytes`."""
        return self._held_bytes

    def offer(self, frame: Frame, *, source: Hashable, now_s: float) -> Complete | None:
        """Return the message that a frame completes, or None while pieces are missing.

        A message of several frames is returned once within the time-out, one of a single frame every time it comes.

        Args:
            frame: As `parse_frame` gave it.
            source: From whom, such as an address; pieces of different sources never mix.
            now_s: Any monotonic clock.
        """
        if frame.pieces_count == 1:
            self.counters.completed_count += 1
            return Complete(frame.kind, frame.section_key, frame.exchange_id, frame.fragment)
        self.expire(now_s=now_s)
        key = (source, frame.exchange_id, frame.kind, frame.section_key, frame.pieces_count, frame.message_crc)
        partial = self._partials.get(key)
        if partial is None:
            partial = self._partials[key] = _Partial(started_s=now_s)
            self._hold(partial, ENTRY_BYTES)
        if partial.pieces is None:
            self.counters.duplicates_count += 1
            return None
        known = partial.pieces.get(frame.piece_index)
        if known == frame.fragment:
            self.counters.duplicates_count += 1
            return None
        if known is not None:
            self.counters.conflicting_count += 1
            self._hold(partial, -len(known))
        partial.pieces[frame.piece_index] = frame.fragment
        self._hold(partial, len(frame.fragment))
        if len(partial.pieces) < frame.pieces_count:
            self._evict()
            return None
        payload = b"".join(partial.pieces[index] for index in range(frame.pieces_count))
        if zlib.crc32(payload) != frame.message_crc:
            self.counters.conflicting_count += 1
            self._drop(key)
            return None
        partial.pieces = None
        self._hold(partial, ENTRY_BYTES - partial.held_bytes)
        self.counters.completed_count += 1
        return Complete(frame.kind, frame.section_key, frame.exchange_id, payload)

    def expire(self, *, now_s: float) -> None:
        """Give up every message whose first piece is older than the time-out. `offer` does it as well."""
        while self._partials:
            key, oldest = next(iter(self._partials.items()))
            if now_s - oldest.started_s <= self._timeout_s:
                return
            self.counters.expired_count += oldest.pieces is not None
            self._drop(key)

    def _hold(self, partial: _Partial, size: int) -> None:
        partial.held_bytes += size
        self._held_bytes += size

    def _drop(self, key: Hashable) -> None:
        self._held_bytes -= self._partials.pop(key).held_bytes

    def _evict(self) -> None:
        while len(self._partials) > self._limit_count or self._held_bytes > self._limit_bytes:
            key, oldest = next(iter(self._partials.items()))
            self.counters.evicted_count += oldest.pieces is not None
            self._drop(key)

"""Passages over UDP, as fast as they are answered or at a pace: one thread that does little else than send and receive.

It is written for speed where it counts: no dictionary, no object and no parsing per passage. A passage's place in its
batch stands in its id (`bench.appliance.passages`), which every receipt repeats.
"""

from __future__ import annotations

import gc
import select
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from roadgrip.frames import EXCHANGE_ID_BYTES
from roadgrip.protocol import HEADER_BYTES
from roadgrip.records import PASSAGE_ID_BYTES
from roadgrip.units import FloatArray

SOURCES_COUNT = 16
"""Addresses of this machine that the passages come from, since no vehicle sends a thousand a second."""
BUFFER_BYTES = 4_194_304
BURST_COUNT = 64
"""Frames sent between two looks for receipts."""
SILENCE_S = 10.0
"""Who waits longer than this for an answer takes what is open for lost."""
UNANSWERED, ACCEPTED, REJECTED = 0, 1, 2
ID_AT, NUMBER_BYTES = 8, 4
"""Where in a frame the exchange id begins, the first half of the passage id: the batch, then the place in it."""
_ACCEPTED_KEY = 1
"""Key in a receipt's map that only an accepted passage has; it follows the id."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """What was sent and what came back, in the order of sending; times are of one monotonic clock.

    Attributes:
        due_s: When each passage was to be sent; when it was sent if nothing paced it. (n,)
        sent_s: When it was. (n,)
        answered_s: When its receipt came; NaN without one. (n,)
        verdicts: UNANSWERED, ACCEPTED or REJECTED. (n,)
        ended_s: When nothing was waited for any more.
    """

    due_s: FloatArray
    sent_s: FloatArray
    answered_s: FloatArray
    verdicts: NDArray[np.uint8]
    ended_s: float

    def count(self, verdict: int) -> int:
        """Return how many passages found this end."""
        return int(np.count_nonzero(self.verdicts == verdict))

    @property
    def latency_s(self) -> FloatArray:
        """From the last frame of each accepted passage to its receipt. (accepted,)"""
        accepted = self.verdicts == ACCEPTED
        took_s: FloatArray = self.answered_s[accepted] - self.sent_s[accepted]
        return took_s

    @property
    def accepted_per_s(self) -> float:
        """Accepted passages in a second, from the first frame to the last receipt."""
        took_s = float(np.nanmax(self.answered_s) - self.sent_s[0]) if self.count(UNANSWERED) < len(self.sent_s) else 0
        return self.count(ACCEPTED) / took_s if took_s > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class Line:
    """Sockets of several addresses of this machine, each connected to the one server.

    Attributes:
        sockets: They.
        poll: Tells which of them have something.
    """

    sockets: tuple[socket.socket, ...]
    poll: select.epoll


@contextmanager
def line_to(host: str, port: int, *, sources_count: int = SOURCES_COUNT) -> Iterator[Line]:
    """Give a line to a server on the loopback, whose net has an address for every source.

    Args:
        host: 127.0.0.1.
        port: Where it listens.
        sources_count: From how many addresses passages come, below 200.
    """
    sockets = tuple(socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(sources_count))
    poll = select.epoll()
    try:
        for number, link in enumerate(sockets):
            link.bind((f"127.0.0.{number + 11}", 0))
            link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            link.connect((host, port))
            link.setblocking(False)  # noqa: FBT003 - the standard library's signature
            poll.register(link.fileno(), select.EPOLLIN)
        yield Line(sockets, poll)
    finally:
        poll.close()
        for link in sockets:
            link.close()


def exchange(
    line: Line,
    frames: Sequence[bytes],
    tag: bytes,
    *,
    rate_per_s: float = inf,
    outstanding_count: int | None = None,
    silence_s: float = SILENCE_S,
) -> Exchange:
    """Return what became of passages that were sent one after the other.

    Args:
        line: Where to.
        frames: One for each passage of a batch, in its order.
        tag: What the batch's ids begin with.
        rate_per_s: How fast they are due.
        outstanding_count: How many may be unanswered before the next waits; None for any number.
        silence_s: How long after the last receipt the rest is taken for lost.
    """
    frames_count = len(frames)
    sent_s, heard = np.full(frames_count, np.nan), _Heard(tag, frames_count)
    receivers = {link.fileno(): link.recv for link in line.sockets}
    senders = [link.send for link in line.sockets]
    limit_count = frames_count if outstanding_count is None else outstanding_count
    now_s, ready = time.perf_counter, line.poll.poll
    sent_count = given_up_count = 0
    with without_collection():
        began_s = last_s = now_s()
        while True:
            at_s = now_s()
            due_count = frames_count if rate_per_s == inf else min(frames_count, int((at_s - began_s) * rate_per_s) + 1)
            open_count = sent_count - given_up_count - heard.count
            burst_count = min(due_count - sent_count, limit_count - open_count, BURST_COUNT)
            sent_count = _sent(senders, frames, sent_s, sent_count, burst_count)
            for descriptor, _ in ready(0.0):
                last_s = heard.receive(receivers[descriptor], last_s)
            open_count = sent_count - given_up_count - heard.count
            if sent_count == frames_count and (open_count <= 0 or at_s - last_s > silence_s):
                break
            if open_count <= 0:
                last_s = at_s
            elif open_count >= limit_count and at_s - last_s > silence_s:
                given_up_count, last_s = given_up_count + open_count, at_s
    answered_s, verdicts = heard.answered_s, heard.verdicts
    due_s = sent_s if rate_per_s == inf else began_s + np.arange(frames_count) / rate_per_s
    return Exchange(due_s, sent_s, answered_s, np.frombuffer(verdicts, dtype=np.uint8), now_s())


def _sent(
    senders: Sequence[Callable[[bytes], int]],
    frames: Sequence[bytes],
    sent_s: FloatArray,
    sent_count: int,
    burst_count: int,
) -> int:
    """Send the next few frames, each from the next source, and return how many are sent now."""
    now_s, senders_count = time.perf_counter, len(senders)
    for number in range(sent_count, sent_count + burst_count):
        try:
            senders[number % senders_count](frames[number])
        except (BlockingIOError, ConnectionRefusedError):
            return number
        sent_s[number] = now_s()
    return sent_count + max(0, burst_count)


class _Heard:
    """What came back so far."""

    def __init__(self, tag: bytes, frames_count: int) -> None:
        self._tag, self._tag_at, self._number_at = tag, ID_AT, ID_AT + len(tag)
        self.answered_s = np.full(frames_count, np.nan)
        self.verdicts = bytearray(frames_count)
        self.count = 0

    def receive(self, receive: Callable[[int], bytes], last_s: float) -> float:
        """Take what a socket has, and return when the last new answer came, or what was told before."""
        tag, tag_at, number_at, verdicts = self._tag, self._tag_at, self._number_at, self.verdicts
        try:
            while True:
                answer = receive(2048)
                if answer[tag_at:number_at] != tag:
                    continue  # to a batch before this one
                number = int.from_bytes(answer[number_at : number_at + NUMBER_BYTES], "big")
                if not verdicts[number]:
                    last_s = self.answered_s[number] = time.perf_counter()
                    verdicts[number] = verdict_of(answer)
                    self.count += 1
        except (BlockingIOError, ConnectionRefusedError):
            return last_s


def verdict_of(answer: bytes) -> int:
    """Return what a frame with a receipt says, signed or not; anything else of the same exchange says "accepted"."""
    id_at = answer.find(answer[ID_AT : ID_AT + EXCHANGE_ID_BYTES], HEADER_BYTES)
    key_at = id_at + PASSAGE_ID_BYTES
    return ACCEPTED if id_at < 0 or answer[key_at] == _ACCEPTED_KEY else REJECTED


@contextmanager
def without_collection() -> Iterator[None]:
    """Keep the garbage collector, which would look through a hundred thousand frames, out of the measurement."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()

"""Requests over connections that stay open, each with one request under way: one thread, HTTP/1.1 by hand.

Answers are read only as far as counting needs: status, length, and whether the body says what it should.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.appliance.udp_load import without_collection
from roadgrip.units import FloatArray

CONNECTIONS_COUNT = 64
SILENCE_S = 30.0
_HEAD_END = b"\r\n\r\n"
_LENGTH = b"content-length:"
_CHUNKED = b"transfer-encoding: chunked"
_LAST_CHUNK = b"0\r\n\r\n"


@dataclass(frozen=True, slots=True)
class Answers:
    """What became of requests, in the order of sending; times are of one monotonic clock.

    Attributes:
        took_s: From a request to its whole answer; NaN without one. (n,)
        good: Whether the answer was what it should be. (n,)
        began_s: When the first request left.
        ended_s: When the last answer came.
        first_bad: The first answer that was not, for a message.
    """

    took_s: FloatArray
    good: NDArray[np.bool_]
    began_s: float
    ended_s: float
    first_bad: bytes

    @property
    def good_count(self) -> int:
        """Requests that were answered as they should."""
        return int(np.count_nonzero(self.good))

    @property
    def good_per_s(self) -> float:
        """They in a second."""
        return self.good_count / (self.ended_s - self.began_s)


def post(path: str, body: bytes, *, media_type: str) -> bytes:
    """Return a request with a body."""
    head = f"POST {path} HTTP/1.1\r\nHost: unit\r\nContent-Type: {media_type}\r\nContent-Length: {len(body)}\r\n\r\n"
    return head.encode() + body


def get(path: str) -> bytes:
    """Return a request without one."""
    return f"GET {path} HTTP/1.1\r\nHost: unit\r\n\r\n".encode()


def is_ok(answer: bytes) -> bool:
    """Return whether an answer is a 200."""
    return answer.startswith(b"HTTP/1.1 200")


def ask(
    host: str,
    port: int,
    requests: Sequence[bytes],
    *,
    requests_count: int | None = None,
    connections_count: int = CONNECTIONS_COUNT,
    is_good: Callable[[bytes], bool] = is_ok,
) -> Answers:
    """Return what became of requests.

    Args:
        host: Whom to ask.
        port: Its port.
        requests: What to ask, in this order; from the first again when `requests_count` is more.
        requests_count: How many to ask; None for each once.
        connections_count: How many are under way at one time.
        is_good: Whether a whole answer, head included, is what it should be.
    """
    asking = _Asking(host, port, requests, len(requests) if requests_count is None else requests_count, is_good)
    try:
        with without_collection():
            return asking.run(connections_count)
    finally:
        asking.close()


@dataclass(slots=True)
class _Connection:
    link: socket.socket
    request: int = -1
    sent_s: float = 0.0
    heard: bytes = b""


class _Asking:
    """A run of requests under way."""

    def __init__(
        self, host: str, port: int, requests: Sequence[bytes], wanted_count: int, is_good: Callable[[bytes], bool]
    ) -> None:
        self._place = host, port
        self._requests = requests
        self._wanted_count = wanted_count
        self._is_good = is_good
        self._poll = select.epoll()
        self._connections: dict[int, _Connection] = {}
        self._sent_count = self._answered_count = 0
        self._took_s = np.full(wanted_count, np.nan)
        self._good = np.zeros(wanted_count, dtype=np.bool_)
        self._first_bad = b""

    def run(self, connections_count: int) -> Answers:
        """Return what became of the requests."""
        for _ in range(min(connections_count, self._wanted_count)):
            self._connect()
        began_s = heard_s = time.perf_counter()
        for connection in tuple(self._connections.values()):
            self._send_next(connection)
        while self._answered_count < self._wanted_count and time.perf_counter() - heard_s < SILENCE_S:
            for descriptor, _ in self._poll.poll(1.0):
                if self._receive(self._connections[descriptor]):
                    heard_s = time.perf_counter()
        return Answers(self._took_s, self._good, began_s, heard_s, self._first_bad)

    def close(self) -> None:
        """Release everything."""
        for connection in tuple(self._connections.values()):
            self._disconnect(connection)
        self._poll.close()

    def _connect(self) -> _Connection:
        link = socket.create_connection(self._place, timeout=SILENCE_S)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connections[link.fileno()] = connection = _Connection(link)
        self._poll.register(link.fileno(), select.EPOLLIN)
        return connection

    def _disconnect(self, connection: _Connection) -> None:
        self._poll.unregister(connection.link.fileno())
        del self._connections[connection.link.fileno()]
        connection.link.close()

    def _send_next(self, connection: _Connection) -> None:
        if self._sent_count < self._wanted_count:
            connection.request, connection.heard = self._sent_count, b""
            self._sent_count += 1
            connection.sent_s = time.perf_counter()
            connection.link.sendall(self._requests[connection.request % len(self._requests)])

    def _receive(self, connection: _Connection) -> bool:
        """Take what has come and return whether that ended an answer; the next request then has left."""
        try:
            piece = connection.link.recv(262_144)
        except ConnectionError:
            piece = b""
        connection.heard += piece
        if piece and not is_whole(connection.heard):
            return False
        self._answered_count += 1
        self._took_s[connection.request] = time.perf_counter() - connection.sent_s
        good = self._good[connection.request] = self._is_good(connection.heard)
        if not good and not self._first_bad:
            self._first_bad = connection.heard or b"the connection was closed"
        if not piece:
            self._disconnect(connection)
            connection = self._connect()
        self._send_next(connection)
        return True


def is_whole(heard: bytes) -> bool:
    """Return whether an answer has come to its end."""
    head, end, body = heard.partition(_HEAD_END)
    if not end:
        return False
    head = head.lower()
    at = head.find(_LENGTH)
    if at >= 0:
        return len(body) >= int(head[at + len(_LENGTH) :].partition(b"\r\n")[0])
    return _CHUNKED not in head or body.endswith(_LAST_CHUNK)

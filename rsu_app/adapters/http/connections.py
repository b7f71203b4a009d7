"""One connection of a client, held to time and size, so that nobody holds up others by being slow, silent or endless.

uvicorn waits for ever for a first request, for the rest of a header and for a client that does not read, and takes
headers of any length. Here each of these has its bound; whoever goes beyond is told so where HTTP has words for it, and
let go, and counted.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

from starlette.types import Receive, Scope, Send
from uvicorn.config import Config
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.server import ServerState

from roadgrip.reasons import Reason
from rsu_app.adapters.http.problems import ProblemError, problem_response, refusal
from rsu_app.loopback import is_loopback

SPARE_COUNT = 64
"""Connections beyond a limit that are still told that the unit is busy; those beyond that are cut without a word."""
AHEAD_COUNT = 32
"""Requests that may wait on a connection behind the one that is answered; each takes some kilobytes until its turn, and
one packet can hold a thousand."""


@dataclass(frozen=True, slots=True)
class ConnectionLimits:
    """What a connection may take.

    Attributes:
        connections_count: Connections at one time; more get 503.
        per_source_count: The same for one address; the machine's own have no such limit.
        header_timeout_s: How long a request may take from its first byte to the end of its header, and a connection to
            its first request.
        header_limit_bytes: Longest request line and header together.
        idle_timeout_s: How long a connection may rest between requests.
        write_timeout_s: How long a client may leave answers unread.
    """

    connections_count: int
    per_source_count: int = 64
    header_timeout_s: float = 10.0
    header_limit_bytes: int = 16_384
    idle_timeout_s: int = 5
    write_timeout_s: float = 20.0


class ConnectionDesk:
    """Knows how many connections there are, and from where.

    Args:
        limits: What a connection may take.
        on_refusal: Told the reason of each one that was refused or let go.
    """

    def __init__(self, limits: ConnectionLimits, *, on_refusal: Callable[[str], None]) -> None:
        self.limits = limits
        self.refused = on_refusal
        self._total_count = 0
        self._counts: dict[str, int] = {}

    def enter(self, source: str) -> int:
        """Return by how many the connections, or those of this source, now exceed their limit; 0 or less if not."""
        self._total_count += 1
        excess_count = self._total_count - self.limits.connections_count
        if source and not is_loopback(source):
            self._counts[source] = self._counts.get(source, 0) + 1
            excess_count = max(excess_count, self._counts[source] - self.limits.per_source_count)
        return excess_count

    def leave(self, source: str) -> None:
        """Forget a connection."""
        self._total_count -= 1
        if source in self._counts:
            self._counts[source] -= 1
            if not self._counts[source]:
                del self._counts[source]


class BoundedConnection(HttpToolsProtocol):
    """HTTP on one connection, with its bounds.

    Args:
        desk: Counts connections and knows the limits.
        config: uvicorn's.
        server_state: uvicorn's.
        app_state: uvicorn's.
        _loop: uvicorn's.
    """

    def __init__(
        self,
        desk: ConnectionDesk,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._desk = desk
        self._source = ""
        self._entered = False
        self._header_open = False
        self._header_bytes = 0
        self._header_timer: asyncio.TimerHandle | None = None
        self._write_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override] # as uvicorn has it
        """Take the connection, or say that there are too many, or cut it."""
        super().connection_made(transport)
        self._source = self.client[0] if self.client else ""
        excess_count = self._desk.enter(self._source)
        self._entered = True
        self._watch_header()
        if excess_count > 0:
            self._desk.refused("too_many_connections")
            self.app = _too_many
            if excess_count > SPARE_COUNT:
                transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Free its place."""
        self._unwatch_header()
        self._unwatch_writing()
        if self._entered:
            self._entered = False
            self._desk.leave(self._source)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read on, and see whether a header is under way."""
        super().data_received(data)
        if self.transport.is_closing():
            self._unwatch_header()
        elif self._header_open:
            self._header_bytes += len(data)
            if self._header_bytes > self._desk.limits.header_limit_bytes:
                self._refuse_header()
            else:
                self._watch_header()
        elif self._busy():
            self._unwatch_header()
        else:  # empty lines, which are no request yet
            self._watch_header()

    def on_message_begin(self) -> None:
        """Begin a header."""
        self._header_open = True
        self._header_bytes = 0
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Start the request, unless its header is longer than it may be."""
        self._header_open = False
        size_bytes = len(self.url) + sum(len(name) + len(value) for name, value in self.headers)
        if size_bytes > self._desk.limits.header_limit_bytes:
            self._refuse_header()
            raise ValueError("stop reading")  # the parser goes on to the body otherwise
        if len(self.pipeline) >= AHEAD_COUNT:
            self._refuse(refusal(Reason.BUSY, f"{AHEAD_COUNT} requests wait on this connection already"))
            raise ValueError("stop reading")
        super().on_headers_complete()

    def send_400_response(self, msg: str) -> None:
        """Say that this is no HTTP, unless something was said already."""
        if not self.transport.is_closing():
            self._refuse(ProblemError("bad_request", HTTPStatus.BAD_REQUEST, msg))

    def on_response_complete(self) -> None:
        """Go on to the next request; a client that was told to go has so long to read what it was told."""
        super().on_response_complete()
        if self.transport.is_closing():
            self._watch_writing()

    def timeout_keep_alive_handler(self) -> None:
        """Close a connection that rests, also one that leaves its last answer unread."""
        super().timeout_keep_alive_handler()
        self._watch_writing()

    def pause_writing(self) -> None:
        """Wait for the client to read, but not for ever."""
        super().pause_writing()
        self._watch_writing()

    def resume_writing(self) -> None:
        """Go on writing."""
        self._unwatch_writing()
        super().resume_writing()

    def _busy(self) -> bool:
        # uvicorn's annotation does not say that there is none before the first request.
        return bool(self.cycle) and not self.cycle.response_complete

    def _watch_header(self) -> None:
        if self._header_timer is None:
            self._header_timer = self.loop.call_later(self._desk.limits.header_timeout_s, self._header_too_slow)

    def _unwatch_header(self) -> None:
        if self._header_timer is not None:
            self._header_timer.cancel()
            self._header_timer = None

    def _header_too_slow(self) -> None:
        self._header_timer = None
        if self._busy():  # the next request comes slowly while the one before is answered: its time begins after that
            self._watch_header()
        elif self._header_open:
            self._refuse(ProblemError("header_timeout", HTTPStatus.REQUEST_TIMEOUT, "the header came too slowly"))
        else:
            self._desk.refused("header_timeout")
            self.transport.abort()

    def _watch_writing(self) -> None:
        if self._write_timer is None:
            self._write_timer = self.loop.call_later(self._desk.limits.write_timeout_s, self._unread)

    def _unwatch_writing(self) -> None:
        if self._write_timer is not None:
            self._write_timer.cancel()
            self._write_timer = None

    def _unread(self) -> None:
        self._write_timer = None
        self._desk.refused("unread")
        self.transport.abort()

    def _refuse_header(self) -> None:
        limit_bytes = self._desk.limits.header_limit_bytes
        self._refuse(
            ProblemError(
                "header_too_large",
                HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE,
                f"request line and header have at most {limit_bytes} bytes",
            )
        )

    def _refuse(self, problem: ProblemError) -> None:
        """Say why and close. A request that is being answered comes first: then there is nothing to be said."""
        self._unwatch_header()
        self._desk.refused(problem.reason)
        if self._busy():
            self.transport.abort()
            return
        response = problem_response(problem)
        lines = [f"HTTP/1.1 {problem.status.value} {problem.status.phrase}".encode(), b"connection: close"]
        lines += [name + b": " + value for name, value in response.raw_headers]
        self.transport.write(b"\r\n".join([*lines, b"", bytes(response.body)]))
        self.transport.close()
        self._watch_writing()


async def _too_many(scope: Scope, receive: Receive, send: Send) -> None:
    response = problem_response(refusal(Reason.BUSY, "too many connections; close some, or come back later"))
    response.headers["Connection"] = "close"
    await response(scope, receive, send)

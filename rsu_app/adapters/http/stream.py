"""The event stream of a section: an event whenever the advice changes, and a sign of life in between."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from roadgrip.records import AdvisoryNotice
from rsu_app.observability import Metrics
from rsu_app.usecases import Subscription

HEARTBEAT = b": alive\n\n"
RETRY_MS = 3_000
"""How long a browser waits before it connects again."""


async def event_stream(
    subscription: Subscription, *, encode: Callable[[AdvisoryNotice], str], heartbeat_s: float
) -> AsyncIterator[bytes]:
    """Yield the pieces of a `text/event-stream`: the advice that stands, then each change; ends with the unit.

    A client that reads slowly skips what was overtaken meanwhile; nothing piles up for it.

    Args:
        subscription: The section's notices; closed when the client leaves.
        encode: A notice as JSON.
        heartbeat_s: How long a stream may be silent; writing is how a dead client is noticed.
    """
    async with subscription:
        number = 0
        yield f"retry: {RETRY_MS}\n\n".encode()
        while True:
            try:
                notice = await asyncio.wait_for(anext(subscription), heartbeat_s)
            except TimeoutError:
                yield HEARTBEAT
                continue
            except StopAsyncIteration:
                return
            number += 1
            yield f"id: {number}\nevent: advisory\ndata: {encode(notice)}\n\n".encode()


class StreamDesk:
    """Knows the open streams, so that a unit that stops need not wait for clients that never leave."""

    def __init__(self, metrics: Metrics) -> None:
        """Start without streams."""
        self._metrics = metrics
        self._open: set[Subscription] = set()

    def close(self) -> None:
        """End every stream."""
        for subscription in tuple(self._open):
            subscription.close()

    def response(
        self, subscription: Subscription, *, encode: Callable[[AdvisoryNotice], str], heartbeat_s: float
    ) -> StreamResponse:
        """Return the response that streams a section's notices."""
        return StreamResponse(self, subscription, event_stream(subscription, encode=encode, heartbeat_s=heartbeat_s))

    def opened(self, subscription: Subscription) -> None:
        """Remember a stream."""
        self._open.add(subscription)
        self._metrics.stream_clients.set(len(self._open))

    def closed(self, subscription: Subscription) -> None:
        """Forget a stream and free its place."""
        subscription.close()
        self._open.discard(subscription)
        self._metrics.stream_clients.set(len(self._open))


class StreamResponse(StreamingResponse):
    """A stream that frees its place also when the client left before the first byte."""

    def __init__(self, desk: StreamDesk, subscription: Subscription, content: AsyncIterator[bytes]) -> None:
        """Prepare the response."""
        super().__init__(
            content,
            media_type="text/event-stream",
            # The second header keeps a proxy from holding events back.
            headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
        )
        self._desk = desk
        self._subscription = subscription
        desk.opened(subscription)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Stream until the client leaves or the unit stops."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._desk.closed(self._subscription)

"""What stands before every route: the size and the patience of a request, and its count.

Plain ASGI, since a request that is refused here must not cost more than it has to.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from http import HTTPStatus

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from roadgrip.reasons import Reason
from rsu_app.adapters.http.problems import ProblemError, problem_response, refusal

BODY_TIMEOUT_S = 10.0
"""A sender that dribbles its body slower than this is let go."""


class BodyGuard:
    """Reads each body whole before the route runs, at most so many bytes of it."""

    def __init__(self, app: ASGIApp, *, body_limit_bytes: int, body_timeout_s: float = BODY_TIMEOUT_S) -> None:
        """Wrap an application."""
        self._app = app
        self._limit_bytes = body_limit_bytes
        self._timeout_s = body_timeout_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 413 or 408, or pass the request on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            body = await read_body(scope, receive, limit_bytes=self._limit_bytes, timeout_s=self._timeout_s)
        except ProblemError as error:
            await problem_response(error)(scope, receive, send)
            return
        if body is not None:  # or the client left
            await self._app(scope, read_again(body, receive), send)


async def read_body(
    scope: Scope, receive: Receive, *, limit_bytes: int, timeout_s: float = BODY_TIMEOUT_S
) -> bytes | None:
    """Return the whole body of a request, None if the client left meanwhile.

    Args:
        scope: Of the request.
        receive: Gives its body.
        limit_bytes: More is refused, unread if the request says so beforehand.
        timeout_s: How long all of it may take.

    Raises:
        ProblemError: It is too long, or came too slowly.
    """
    announced = next((v for k, v in scope["headers"] if k == b"content-length"), b"0")
    # By length first: Python refuses to read a number of thousands of digits.
    if announced.isdigit() and (len(announced) > 12 or int(announced) > limit_bytes):
        raise _oversized(limit_bytes)
    parts: list[bytes] = []
    size_bytes = 0
    try:
        async with asyncio.timeout(timeout_s):
            while True:
                message = await receive()
                if message["type"] != "http.request":
                    return None
                parts.append(message.get("body", b""))
                size_bytes += len(parts[-1])
                if size_bytes > limit_bytes:
                    raise _oversized(limit_bytes)
                if not message.get("more_body", False):
                    return b"".join(parts)
    except TimeoutError:
        raise ProblemError(
            "timeout", HTTPStatus.REQUEST_TIMEOUT, f"the body was not there within {timeout_s} s"
        ) from None


def read_again(body: bytes, receive: Receive) -> Receive:
    """Return a way to receive a body that was read already, and then what comes after it."""
    waiting: Message | None = {"type": "http.request", "body": body, "more_body": False}

    async def replay() -> Message:
        nonlocal waiting
        if waiting is not None:
            message, waiting = waiting, None
            return message
        return await receive()

    return replay


def _oversized(limit_bytes: int) -> ProblemError:
    return refusal(Reason.OVERSIZED, f"a body has at most {limit_bytes} bytes")


class RequestCounter:
    """Counts each request by the template of its route, never by its path, which a sender could vary at will."""

    def __init__(self, app: ASGIApp, *, on_request: Callable[[str, int], None]) -> None:
        """Wrap an application."""
        self._app = app
        self._on_request = on_request

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and tell its route and status."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        status = 500

        async def watch(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, watch)
        finally:
            route = getattr(scope.get("route"), "path", "none")
            self._on_request(route, status)

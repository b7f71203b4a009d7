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
            body = await self._body(scope, receive)
        except ProblemError as error:
            await problem_response(error)(scope, receive, send)
            return
        if body is None:  # the client left
            return
        waiting: Message | None = {"type": "http.request", "body": body, "more_body": False}

        async def replay() -> Message:
            nonlocal waiting
            if waiting is not None:
                message, waiting = waiting, None
                return message
            return await receive()

        await self._app(scope, replay, send)

    async def _body(self, scope: Scope, receive: Receive) -> bytes | None:
        announced = next((v for k, v in scope["headers"] if k == b"content-length"), b"0")
        # By length first: Python refuses to read a number of thousands of digits.
        if announced.isdigit() and (len(announced) > 12 or int(announced) > self._limit_bytes):
            raise self._oversized()
        parts: list[bytes] = []
        size_bytes = 0
        try:
            async with asyncio.timeout(self._timeout_s):
                while True:
                    message = await receive()
                    if message["type"] != "http.request":
                        return None
                    parts.append(message.get("body", b""))
                    size_bytes += len(parts[-1])
                    if size_bytes > self._limit_bytes:
                        raise self._oversized()
                    if not message.get("more_body", False):
                        return b"".join(parts)
        except TimeoutError:
            raise ProblemError(
                "timeout", HTTPStatus.REQUEST_TIMEOUT, f"the body was not there within {self._timeout_s} s"
            ) from None

    def _oversized(self) -> ProblemError:
        return refusal(Reason.OVERSIZED, f"a body has at most {self._limit_bytes} bytes")


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

import asyncio
from typing import Any

import pytest
from starlette.types import Message, Receive, Scope, Send

from rsu_app.adapters.http.guards import BodyGuard

SCOPE: dict[str, Any] = {"type": "http", "method": "POST", "path": "/", "headers": []}


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    message = await receive()
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": message["body"]})


def sent_by(pieces: list[Message], *, headers: list[tuple[bytes, bytes]] | None = None, **limits: Any) -> list[Message]:
    """Run the guard before an echo and return what it sends; after the last piece the client waits for ever."""

    async def run() -> list[Message]:
        sent: list[Message] = []
        waiting = list(pieces)

        async def receive() -> Message:
            if not waiting:
                await asyncio.Event().wait()
            return waiting.pop(0)

        async def send(message: Message) -> None:
            sent.append(message)

        guard = BodyGuard(echo, **({"body_limit_bytes": 10, "body_timeout_s": 1.0} | limits))
        await guard(SCOPE | {"headers": headers or []}, receive, send)
        return sent

    return asyncio.run(run())


def piece(body: bytes, *, more: bool = False) -> Message:
    return {"type": "http.request", "body": body, "more_body": more}


def test_a_body_in_pieces_reaches_the_route_whole():
    sent = sent_by([piece(b"ab", more=True), piece(b"cd")])
    assert sent[1]["body"] == b"abcd"


@pytest.mark.parametrize("announced", [b"11", b"9" * 5000])
def test_a_body_that_says_it_is_too_long_is_not_read(announced):
    assert sent_by([], headers=[(b"content-length", announced)])[0]["status"] == 413


def test_a_body_that_becomes_too_long_is_refused():
    assert sent_by([piece(b"123456", more=True), piece(b"78901", more=True)])[0]["status"] == 413


def test_a_body_of_the_limit_passes():
    assert sent_by([piece(b"1234567890")])[0]["status"] == 200


def test_a_sender_that_dribbles_is_let_go():
    assert sent_by([piece(b"1", more=True)], body_timeout_s=0.01)[0]["status"] == 408


def test_a_client_that_leaves_gets_no_answer():
    assert sent_by([piece(b"1", more=True), {"type": "http.disconnect"}]) == []

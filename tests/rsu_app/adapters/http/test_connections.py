"""Slow, silent, endless and greedy clients, on real sockets."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from starlette.types import Receive, Scope, Send

from rsu_app.adapters.http.connections import SPARE_COUNT, ConnectionDesk, ConnectionLimits
from rsu_app.adapters.http.server import HttpServer, listening_socket

GET = b"GET / HTTP/1.1\r\nHost: unit\r\n\r\n"
PATIENT_S = 30.0
SOON_S = 0.05

Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def hello(scope: Scope, receive: Receive, send: Send) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"5")]})
    await send({"type": "http.response.body", "body": b"hello"})


class Server:
    def __init__(self, port: int) -> None:
        self.port = port
        self.refused: list[str] = []
        self.refusal = asyncio.Event()
        self.open: list[asyncio.StreamWriter] = []

    def note(self, reason: str) -> None:
        self.refused.append(reason)
        self.refusal.set()

    async def connect(self) -> Streams:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        self.open.append(writer)
        return reader, writer

    async def say(self, data: bytes) -> bytes:
        """Return everything that is answered until the server closes."""
        reader, writer = await self.connect()
        writer.write(data)
        return await asyncio.wait_for(reader.read(), PATIENT_S)


@asynccontextmanager
async def serving(app: Any = hello, **limits: Any) -> AsyncIterator[Server]:
    listener = listening_socket("127.0.0.1", 0)
    under_test = Server(listener.getsockname()[1])
    started = asyncio.Event()
    server = HttpServer(
        app,
        limits=ConnectionLimits(**({"connections_count": 100} | limits)),
        shutdown_s=1,
        on_start=started.set,
        on_stop=lambda: None,
        on_refusal=under_test.note,
    )
    task = asyncio.create_task(server.serve(sockets=[listener]))
    await started.wait()
    try:
        yield under_test
    finally:
        for writer in under_test.open:
            writer.close()
        server.stop()
        await asyncio.wait_for(task, PATIENT_S)


def told(story: Callable[[Server], Awaitable[Any]], app: Any = hello, **limits: Any) -> Any:
    """Return what comes of a story, after it was seen that the server still answers others."""

    async def run() -> Any:
        async with serving(app, **limits) as server:
            outcome = await story(server)
            if app is hello:
                assert (await server.say(GET.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n"))).endswith(b"hello")
            return outcome, server.refused

    return asyncio.run(run())


def problem(answer: bytes) -> tuple[int, str]:
    head, _, body = answer.partition(b"\r\n\r\n")
    assert b"content-type: application/problem+json" in head
    document = json.loads(body)
    assert head.startswith(b"HTTP/1.1 %d " % document["status"])
    return document["status"], document["reason"]


@pytest.mark.parametrize("sent", [b"", b"\r\n", b"\r\n\r\n\r\n"])
def test_who_never_asks_is_let_go(sent):
    answer, refused = told(lambda server: server.say(sent), header_timeout_s=SOON_S)
    assert (answer, refused) == (b"", ["header_timeout"])


def test_a_header_that_never_ends_is_let_go_by_time():
    answer, refused = told(lambda server: server.say(GET[:-2]), header_timeout_s=SOON_S)
    assert problem(answer) == (408, "header_timeout")
    assert refused == ["header_timeout"]


def test_who_dribbles_his_header_is_let_go_all_the_same():
    async def dribble(server: Server) -> None:
        _, writer = await server.connect()
        writer.write(b"GET / HTTP/1.1\r\n")
        async with asyncio.timeout(PATIENT_S):
            while not server.refusal.is_set():
                writer.write(b"x: y\r\n")
                await asyncio.sleep(SOON_S / 10)

    _, refused = told(dribble, header_timeout_s=SOON_S)
    assert refused == ["header_timeout"]


@pytest.mark.parametrize(
    "sent",
    [
        b"GET / HTTP/1.1\r\nlong: " + b"x" * 5_000 + b"\r\n\r\n",
        b"GET /" + b"x" * 5_000 + b" HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 1_000,
        b"GET /" + b"x" * 5_000,
    ],
    ids=["header", "path", "many", "open"],
)
def test_a_header_that_is_too_long_is_refused(sent):
    answer, refused = told(lambda server: server.say(sent), header_limit_bytes=4_096)
    assert problem(answer) == (431, "header_too_large")
    assert refused == ["header_too_large"]


def test_a_header_of_nearly_the_limit_passes():
    async def ask(server: Server) -> bytes:
        return await server.say(b"GET / HTTP/1.1\r\nConnection: close\r\nlong: " + b"x" * 4_000 + b"\r\n\r\n")

    answer, refused = told(ask, header_limit_bytes=4_096)
    assert (answer[-5:], refused) == (b"hello", [])


@pytest.mark.parametrize("sent", [b"\x16\x03\x01rubbish", b"GET\r\n\r\n", b"GET / HTTP/1.1\r\nbad header\r\n\r\n"])
def test_what_is_no_http_is_told_so(sent):
    answer, refused = told(lambda server: server.say(sent))
    assert problem(answer) == (400, "bad_request")
    assert refused == ["bad_request"]


def test_a_connection_that_rests_is_closed_and_nothing_is_held_against_it():
    async def rest(server: Server) -> bytes:
        return await server.say(GET)

    answer, refused = told(rest, idle_timeout_s=0)
    assert (answer[-5:], refused) == (b"hello", [])


def test_requests_that_come_together_are_answered_in_order():
    async def ask(server: Server) -> bytes:
        return await server.say(GET * 20 + GET.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n"))

    answer, refused = told(ask)
    assert (answer.count(b"hello"), refused) == (21, [])


def test_who_asks_a_thousand_times_at_once_is_cut():
    answer, refused = told(lambda server: server.say(GET * 1_000))
    assert (answer.count(b"hello"), refused) == (0, ["busy"])


def test_the_next_header_has_its_time_after_the_answer_before_it():
    async def slow(scope: Scope, receive: Receive, send: Send) -> None:
        await asyncio.sleep(5 * SOON_S)
        await hello(scope, receive, send)

    async def ask(server: Server) -> bytes:
        return await server.say(GET + GET[:-2])

    answer, refused = told(ask, slow, header_timeout_s=SOON_S, idle_timeout_s=5)
    assert b"hello" in answer
    assert refused == ["header_timeout"]


def test_who_leaves_answers_unread_is_cut():
    async def flood(scope: Scope, receive: Receive, send: Send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        for _ in range(10_000):
            await send({"type": "http.response.body", "body": b"x" * 65_536, "more_body": True})

    async def ask(server: Server) -> None:
        loop = asyncio.get_running_loop()
        with socket.socket() as link:
            link.setblocking(False)
            await loop.sock_connect(link, ("127.0.0.1", server.port))
            await loop.sock_sendall(link, GET)
            await asyncio.wait_for(server.refusal.wait(), PATIENT_S)

    _, refused = told(ask, flood, write_timeout_s=SOON_S)
    assert refused == ["unread"]


def test_connections_beyond_the_limit_are_told_to_come_later():
    async def crowd(server: Server) -> bytes:
        for _ in range(3):
            await server.connect()
        answer = await server.say(GET)
        for writer in server.open:
            writer.close()
            await writer.wait_closed()
        return answer

    answer, refused = told(crowd, connections_count=3)
    assert problem(answer) == (503, "busy")
    assert refused == ["too_many_connections"]


def test_far_beyond_the_limit_they_are_cut_without_a_word():
    async def crowd(server: Server) -> bytes:
        for _ in range(1 + SPARE_COUNT):
            await server.connect()
        try:
            answer = await server.say(GET)
        except ConnectionResetError:
            answer = b""
        for writer in server.open:
            writer.close()
        async with asyncio.timeout(PATIENT_S):
            while b"hello" not in await server.say(GET):
                pass
        return answer

    answer, refused = told(crowd, connections_count=1, idle_timeout_s=0)
    assert answer == b""
    assert set(refused) == {"too_many_connections"}


def desk(**limits: Any) -> ConnectionDesk:
    return ConnectionDesk(ConnectionLimits(**limits), on_refusal=lambda _: None)


def test_one_address_cannot_take_all_connections():
    counts = desk(connections_count=10, per_source_count=2)
    assert [counts.enter("192.0.2.1") for _ in range(3)][-1] == 1
    assert counts.enter("192.0.2.2") <= 0
    counts.leave("192.0.2.1")
    counts.leave("192.0.2.1")
    assert counts.enter("192.0.2.1") <= 0


@pytest.mark.parametrize("source", ["127.0.0.1", "::1", "::ffff:127.0.0.1", ""])
def test_the_machine_itself_may_have_as_many_as_there_are(source):
    counts = desk(connections_count=10, per_source_count=2)
    assert max(counts.enter(source) for _ in range(10)) <= 0
    assert counts.enter(source) == 1

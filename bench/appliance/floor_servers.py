"""Servers that do next to nothing: what the transports cost by themselves, and with the model and the disk behind them.

python -m bench.appliance.floor_servers datagrams            sends every datagram back, over uvloop
python -m bench.appliance.floor_servers http                 answers every request with 200, uvicorn as the unit runs it
python -m bench.appliance.floor_servers passages DATABASE    asks the models and keeps the bytes, and checks nothing

Prints the port as its only line.
"""

from __future__ import annotations

import asyncio
import socket
import sqlite3
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import uvicorn
import uvloop

from bench.appliance.passages import DEFAULT_BUNDLE, default_manifest, golden_drives
from roadgrip.features import NEWEST_TABLE
from roadgrip.protocol import HEADER_BYTES
from rsu_app.adapters.store.connection import apply_writer_pragmas

HOST = "127.0.0.1"
BATCH_COUNT = 128
RECEIPT_BYTES = 64


class Echo(asyncio.DatagramProtocol):
    """Sends what comes back to where it came from."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep where answers go."""
        self._transport: Any = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        """Answer with as many bytes as a receipt has."""
        self._transport.sendto(data[:RECEIPT_BYTES], addr)


class BareUnit(asyncio.DatagramProtocol):
    """Asks the models about whatever a datagram holds where the statistics mostly are, keeps it, and answers.

    What arrives while a group is written is the next group, so models and disk are asked as rarely as by the unit.
    Nothing is parsed, checked, counted, remembered or published: no way to take a passage in this language with these
    libraries costs much less.
    """

    def __init__(self, database_path: Path) -> None:
        """Open the database and the models of the packaged bundle."""
        self._database = sqlite3.connect(database_path, isolation_level=None, check_same_thread=False)
        apply_writer_pragmas(self._database)
        self._database.execute("CREATE TABLE passages (number INTEGER PRIMARY KEY, frame BLOB NOT NULL, mu REAL)")
        self._writer = ThreadPoolExecutor(1)
        (model,) = (model for model in default_manifest().models if model.table_digest == NEWEST_TABLE.digest)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._sessions = [
            onnxruntime.InferenceSession(DEFAULT_BUNDLE / file, options, providers=["CPUExecutionProvider"])
            for file in model.files
        ]
        self._values_at = HEADER_BYTES + golden_drives()[0].values_at
        self._road = np.zeros(len(NEWEST_TABLE) - len(NEWEST_TABLE.kinematic), dtype=np.float32)
        self._waiting: list[tuple[bytes, Any]] = []
        self._working = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep where answers go."""
        self._transport: Any = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        """Let it wait for those that arrive with it."""
        self._waiting.append((data, addr))
        if not self._working:
            self._working = True
            asyncio.get_running_loop().call_soon(self._begin)

    def _begin(self) -> None:
        group, self._waiting = self._waiting[:BATCH_COUNT], self._waiting[BATCH_COUNT:]
        if not group:
            self._working = False
            return
        rows = np.empty((len(group), len(NEWEST_TABLE)), dtype=np.float32)
        rows[:, len(NEWEST_TABLE.kinematic) :] = self._road
        for row, (data, _) in zip(rows, group, strict=True):
            row[: len(NEWEST_TABLE.kinematic)] = np.frombuffer(
                data, dtype="<f4", count=len(NEWEST_TABLE.kinematic), offset=self._values_at
            )
        answers = [session.run(None, {session.get_inputs()[0].name: rows})[0] for session in self._sessions]
        frames = [(data, float(mu)) for (data, _), mu in zip(group, answers[0].reshape(-1), strict=True)]
        loop = asyncio.get_running_loop()
        loop.run_in_executor(self._writer, self._keep, frames).add_done_callback(lambda _: self._answer(group))

    def _keep(self, frames: list[tuple[bytes, float]]) -> None:
        self._database.execute("BEGIN IMMEDIATE")
        places = ", ".join(["(?, ?)"] * len(frames))
        values = [value for frame in frames for value in frame]
        self._database.execute(f"INSERT INTO passages (frame, mu) VALUES {places}", values)  # noqa: S608 - question marks
        self._database.execute("COMMIT")

    def _answer(self, group: list[tuple[bytes, Any]]) -> None:
        for data, addr in group:
            self._transport.sendto(data[:RECEIPT_BYTES], addr)
        asyncio.get_running_loop().call_soon(self._begin)


async def answer_datagrams_for_ever(protocol: asyncio.DatagramProtocol) -> None:
    """Listen until the process ends."""
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: protocol, local_addr=(HOST, 0))
    transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4_194_304)
    print(transport.get_extra_info("sockname")[1], flush=True)
    await asyncio.Event().wait()


async def answer(_scope: Any, receive: Any, send: Any) -> None:
    """Read a request to its end and answer 200 with a short body."""
    while (await receive()).get("more_body"):
        pass
    headers = [(b"content-type", b"application/octet-stream"), (b"content-length", b"64")]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": bytes(64)})


async def answer_for_ever() -> None:
    """Listen until the process ends."""
    link = socket.socket()
    link.bind((HOST, 0))
    print(link.getsockname()[1], flush=True)
    config = uvicorn.Config(answer, lifespan="off", log_config=None, access_log=False, server_header=False)
    await uvicorn.Server(config).serve(sockets=[link])


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["datagrams"]:
            uvloop.run(answer_datagrams_for_ever(Echo()))
        case ["passages", database]:
            uvloop.run(answer_datagrams_for_ever(BareUnit(Path(database))))
        case _:
            uvloop.run(answer_for_ever())

"""Servers that do nothing: what the transports cost by themselves.

python -m bench.appliance.floor_servers datagrams     sends every datagram back, over uvloop
python -m bench.appliance.floor_servers http          answers every request with 200, uvicorn as the unit runs it

Prints the port as its only line.
"""

from __future__ import annotations

import asyncio
import socket
import sys
from typing import Any

import uvicorn
import uvloop

HOST = "127.0.0.1"


class Echo(asyncio.DatagramProtocol):
    """Sends what comes back to where it came from."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep where answers go."""
        self._transport: Any = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        """Answer with as many bytes as a receipt has."""
        self._transport.sendto(data[:64], addr)


async def echo_for_ever() -> None:
    """Listen until the process ends."""
    transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(Echo, local_addr=(HOST, 0))
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
    uvloop.run({"datagrams": echo_for_ever, "http": answer_for_ever}[sys.argv[1]]())

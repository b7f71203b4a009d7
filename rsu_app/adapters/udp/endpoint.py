"""The UDP socket: datagrams to the gateway, its answers back, beacons and broadcasts out."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Iterable
from functools import partial
from typing import Any, TypeAlias, cast

import structlog

from roadgrip.errors import ConfigurationError
from rsu_app.gateway import FrameGateway, OutFrames, Sender
from rsu_app.observability import Metrics

_log = structlog.get_logger("roadgrip")

VIA = "udp"
BUFFER_LIMIT_BYTES = 1_048_576
"""Bytes the socket could not take yet; above it frames are dropped and counted, as the air would."""

_SO_MEMINFO = 55
"""What Linux calls the socket option that tells a socket's memory, which the standard library has no name for."""
_MEMINFO = struct.Struct("=9I")
_MEMINFO_DROPS = 8

PeerAddress: TypeAlias = tuple[str, int] | tuple[str, int, int, int]


class FrameEndpoint(asyncio.DatagramProtocol):
    """One socket. Arrivals are answered at once; a passage is answered after its commit.

    Args:
        gateway: Understands frames.
        metrics: Where dropped frames are counted.
        broadcast_address: Where beacons and detections go; None sends none.
    """

    def __init__(
        self, gateway: FrameGateway, *, metrics: Metrics, broadcast_address: tuple[str, int] | None = None
    ) -> None:
        self._gateway = gateway
        self._metrics = metrics
        self._broadcast_address = broadcast_address
        self._transport: asyncio.DatagramTransport | None = None
        self._in_work_count = 0
        self._kernel_count = 0
        self._idle = asyncio.Event()
        self._closing = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport that answers go through."""
        # Not an instance check: uvloop's transport does not say what it is.
        self._transport = cast("asyncio.DatagramTransport", transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the transport."""
        self._transport = None
        if exc is not None:
            _log.error("udp_socket_lost", error=repr(exc))

    def error_received(self, exc: Exception) -> None:
        """Count what the network says about earlier frames; a vehicle that left is nothing to worry about."""
        self._metrics.frames_dropped.count(VIA, "network_error")
        _log.debug("udp_error", error=repr(exc))

    def datagram_received(self, data: bytes, addr: PeerAddress | tuple[str | Any, int]) -> None:
        """Answer a frame."""
        if self._closing:
            return
        taken = self._gateway.take(data, via=VIA, sender=Sender(addr[0], addr[1], proven=False))
        if taken.replies:
            self.send(taken.replies, addr)
        if taken.passage is not None:
            self._in_work_count += 1
            self._gateway.settle_later(taken.passage, via=VIA, send=partial(self._answer, addr))

    def send(self, replies: Iterable[OutFrames], addr: PeerAddress | tuple[str | Any, int]) -> int:
        """Send frames and return how many bytes left."""
        sent_bytes = 0
        for message in replies:
            for frame in message.frames:
                if self._transport is None or _waiting_bytes(self._transport) > BUFFER_LIMIT_BYTES:
                    self._metrics.frames_dropped.count(VIA, "send_buffer_full")
                    continue
                self._transport.sendto(frame, addr)
                sent_bytes += len(frame)
                self._metrics.frames_sent.count(VIA, message.name)
        return sent_bytes

    def broadcast(self, messages: Iterable[OutFrames]) -> int:
        """Send frames to everybody in reach and return how many bytes left."""
        return 0 if self._broadcast_address is None else self.send(messages, self._broadcast_address)

    async def announce(self, *, period_s: float) -> None:
        """Broadcast a beacon of each section, again and again, until cancelled."""
        while True:
            self.broadcast(self._gateway.beacons())
            await asyncio.sleep(period_s)

    def observe(self) -> None:
        """Count the datagrams that the kernel dropped since the last look, because nobody had read earlier ones."""
        if self._transport is None:
            return
        link = self._transport.get_extra_info("socket")
        try:
            answer = link.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
        except OSError:  # before Linux 4.12, or elsewhere
            return
        total_count = _MEMINFO.unpack(answer)[_MEMINFO_DROPS]
        self._metrics.frames_dropped.count(VIA, "kernel_buffer_full", by=(total_count - self._kernel_count) % 2**32)
        self._kernel_count = total_count

    async def close(self) -> None:
        """Take no more frames, let passages in work be answered, then release the socket."""
        self._closing = True
        if self._in_work_count:
            await self._idle.wait()
        if self._transport is not None:
            self._transport.close()

    def _answer(self, addr: PeerAddress | tuple[str | Any, int], receipt: tuple[OutFrames, ...]) -> None:
        self.send(receipt, addr)
        self._in_work_count -= 1
        if self._closing and not self._in_work_count:
            self._idle.set()


def _waiting_bytes(transport: asyncio.DatagramTransport) -> int:
    """Return the bytes that the socket has not taken yet; both event loops can say, their types cannot."""
    waiting: int = transport.get_write_buffer_size()  # type: ignore[attr-defined]
    return waiting


async def open_endpoint(
    gateway: FrameGateway,
    *,
    metrics: Metrics,
    host: str,
    port: int,
    broadcast_address: tuple[str, int] | None,
    receive_buffer_bytes: int,
) -> tuple[FrameEndpoint, tuple[str, int]]:
    """Return the endpoint and the address it listens on.

    Raises:
        ConfigurationError: The address is not of this machine, or taken.
    """
    loop = asyncio.get_running_loop()
    try:
        transport, endpoint = await loop.create_datagram_endpoint(
            lambda: FrameEndpoint(gateway, metrics=metrics, broadcast_address=broadcast_address),
            local_addr=(host, port),
            allow_broadcast=broadcast_address is not None,
        )
    except OSError as error:
        raise ConfigurationError(
            f"cannot listen on udp {host}:{port}: {error.strerror or error}; see udp.host and udp.port"
        ) from error
    link = transport.get_extra_info("socket")
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer_bytes)
    granted_bytes = link.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
    if granted_bytes < receive_buffer_bytes:
        _log.info("udp_buffer_smaller", asked_bytes=receive_buffer_bytes, granted_bytes=granted_bytes)
    name = transport.get_extra_info("sockname")
    return endpoint, (str(name[0]), int(name[1]))

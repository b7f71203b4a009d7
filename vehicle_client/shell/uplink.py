"""Carriers of frames between a vehicle and a road side unit: UDP as a radio delivers them, HTTP over cellular.

Both stand behind one Protocol. `LossyUplink` wraps either and spoils the air on purpose, for fleets and the demo.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Protocol
from urllib.parse import urlsplit

from roadgrip.errors import ConfigurationError, WireError
from roadgrip.frames import iter_frames

if TYPE_CHECKING:
    import httpx
    import numpy as np

QUEUE_LIMIT_COUNT = 64
"""Frames waiting to be read by one vehicle; an exchange has at most eight, more is somebody's flood."""

HTTP_TIMEOUT_S = 10.0
FRAMES_MEDIA_TYPE = "application/vnd.roadgrip.frames"


class Uplink(Protocol):
    """One vehicle's way to a road side unit."""

    async def send(self, frame: bytes) -> None:
        """Send a frame; whether it arrives is not known."""
        ...

    async def receive(self) -> bytes:
        """Return the next frame for this vehicle, as long as it takes."""
        ...

    async def close(self) -> None:
        """Stop listening."""
        ...


@dataclass(frozen=True, slots=True)
class UnitAddress:
    """Where a road side unit is reached.

    Attributes:
        scheme: "udp", "http" or "https".
        host: Name or address.
        port: UDP or TCP port.
    """

    scheme: str
    host: str
    port: int

    def __str__(self) -> str:
        """Return the address as it is written on a command line."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def parse_unit_address(text: str) -> UnitAddress:
    """Return the address that a text such as `udp://127.0.0.1:4740` or `http://unit.example:8080` holds.

    Raises:
        ConfigurationError: It is not such a text; the message shows how one looks.
    """
    parts = urlsplit(text)
    ports = {"udp": 4740, "http": 80, "https": 443}
    try:
        port = parts.port
    except ValueError:
        port = 0
    if parts.scheme not in ports or not parts.hostname or port == 0 or parts.path not in {"", "/"}:
        raise ConfigurationError(
            f"{text!r} is not the address of a road side unit; write udp://HOST:PORT or http://HOST:PORT"
        )
    return UnitAddress(parts.scheme, parts.hostname, port if port is not None else ports[parts.scheme])


class UdpUplink:
    """Frames as datagrams; one socket, so one source address, per vehicle."""

    def __init__(self, address: UnitAddress) -> None:
        """Remember where the unit is; nothing is opened before `open`."""
        self._address = address
        self._inbox: asyncio.Queue[bytes] = asyncio.Queue(QUEUE_LIMIT_COUNT)
        self._transport: asyncio.DatagramTransport | None = None

    async def open(self) -> UdpUplink:
        """Bind a port of the machine's choice and return self.

        Raises:
            ConfigurationError: The host has no address, or the machine has no socket left.
        """
        loop = asyncio.get_running_loop()
        try:
            self._transport, _ = await loop.create_datagram_endpoint(
                lambda: _Inbox(self._inbox), remote_addr=(self._address.host, self._address.port)
            )
        except OSError as error:
            raise ConfigurationError(f"cannot send to {self._address}: {error}") from error
        return self

    async def send(self, frame: bytes) -> None:
        """Send a datagram."""
        if self._transport is not None and not self._transport.is_closing():
            self._transport.sendto(frame)

    async def receive(self) -> bytes:
        """Return the next datagram."""
        return await self._inbox.get()

    async def close(self) -> None:
        """Release the port."""
        if self._transport is not None:
            self._transport.close()


class _Inbox(asyncio.DatagramProtocol):
    def __init__(self, inbox: asyncio.Queue[bytes]) -> None:
        self._inbox = inbox

    def datagram_received(self, data: bytes, addr: object) -> None:  # noqa: ARG002 - the socket is connected
        if not self._inbox.full():
            self._inbox.put_nowait(data)

    def error_received(self, exc: Exception) -> None:
        """Do nothing: a unit that is not there is a frame that is lost, and the exchange tries again."""


class HttpUplink:
    """Frames as request bodies; the unit's frames come back in the answer."""

    def __init__(self, address: UnitAddress, client: httpx.AsyncClient) -> None:
        """Use a client that may serve many vehicles; whoever made it closes it."""
        self._url = f"{address}/v1/frames"
        self._client = client
        self._inbox: asyncio.Queue[bytes] = asyncio.Queue(QUEUE_LIMIT_COUNT)

    async def send(self, frame: bytes) -> None:
        """Post a frame and keep what the answer holds."""
        import httpx

        try:
            answer = await self._client.post(self._url, content=frame, headers={"content-type": FRAMES_MEDIA_TYPE})
            if answer.headers.get("content-type", "").startswith(FRAMES_MEDIA_TYPE):
                for reply in iter_frames(answer.content):
                    if not self._inbox.full():
                        self._inbox.put_nowait(reply)
        except (httpx.HTTPError, WireError):
            # No connection, a time-out, a proxy's page: for the exchange it is a frame that was lost.
            return

    async def receive(self) -> bytes:
        """Return the next frame of an answer."""
        return await self._inbox.get()

    async def close(self) -> None:
        """Do nothing: the client belongs to whoever made it."""


@dataclass(frozen=True, slots=True)
class AirFaults:
    """How bad the air is; probabilities per frame and direction.

    Attributes:
        lost_frac: The frame never arrives.
        doubled_frac: It arrives twice.
        delayed_frac: It arrives after `delay_s`, behind frames that were sent later.
        spoiled_frac: One of its bytes arrives changed.
        delay_s: How long a delayed frame takes, on the wall clock.
    """

    lost_frac: float = 0.0
    doubled_frac: float = 0.0
    delayed_frac: float = 0.0
    spoiled_frac: float = 0.0
    delay_s: float = 0.02

    def __post_init__(self) -> None:
        """Refuse what is no probability."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value <= 1.0:
                raise ConfigurationError(f"{field.name} is {value}, which is not between 0 and 1")


CLEAN_AIR = AirFaults()


@dataclass(slots=True)
class AirCounts:
    """What the air did so far, both directions.

    Attributes:
        offered_count: Frames that were sent into the air.
        lost_count: Frames that never arrived.
        doubled_count: Frames that arrived twice.
        delayed_count: Frames that came late.
        spoiled_count: Frames that arrived changed, so that their checksum tells.
    """

    offered_count: int = 0
    lost_count: int = 0
    doubled_count: int = 0
    delayed_count: int = 0
    spoiled_count: int = 0

    def add(self, other: AirCounts) -> None:
        """Add what the air did elsewhere."""
        for field in fields(self):
            setattr(self, field.name, getattr(self, field.name) + getattr(other, field.name))

    @property
    def missing_count(self) -> int:
        """Frames of no use to their receiver: lost or spoiled."""
        return self.lost_count + self.spoiled_count


class LossyUplink:
    """Another uplink seen through bad air, in both directions."""

    def __init__(self, inner: Uplink, faults: AirFaults, rng: np.random.Generator) -> None:
        """Wrap an open uplink; needs a running event loop.

        Args:
            inner: The uplink that carries what is left.
            faults: How bad the air is.
            rng: Chance.
        """
        self._inner = inner
        self._faults = faults
        self._rng = rng
        self._inbox: asyncio.Queue[bytes] = asyncio.Queue(QUEUE_LIMIT_COUNT)
        self._late: set[asyncio.Task[None]] = set()
        self._pump = asyncio.get_running_loop().create_task(self._carry_down())
        self.counts = AirCounts()

    async def send(self, frame: bytes) -> None:
        """Send a frame, if the air lets it through."""
        await self._through(frame, self._inner.send)

    async def receive(self) -> bytes:
        """Return the next frame that the air let through."""
        return await self._inbox.get()

    async def close(self) -> None:
        """Stop listening; frames still on their way are lost."""
        tasks = [self._pump, *self._late]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self._inner.close()

    async def _carry_down(self) -> None:
        while True:
            await self._through(await self._inner.receive(), self._deliver)

    async def _deliver(self, frame: bytes) -> None:
        if not self._inbox.full():
            self._inbox.put_nowait(frame)

    async def _through(self, frame: bytes, onward: _Onward) -> None:
        faults, counts = self._faults, self.counts
        counts.offered_count += 1
        lost, doubled, delayed, spoiled = self._rng.random(4) < (
            faults.lost_frac,
            faults.doubled_frac,
            faults.delayed_frac,
            faults.spoiled_frac,
        )
        if lost:
            counts.lost_count += 1
            return
        if spoiled:
            counts.spoiled_count += 1
            frame = _spoiled(frame, self._rng)
        if doubled:
            counts.doubled_count += 1
            await onward(frame)
        if delayed:
            counts.delayed_count += 1
            task = asyncio.get_running_loop().create_task(self._later(frame, onward))
            self._late.add(task)
            task.add_done_callback(self._late.discard)
        else:
            await onward(frame)

    async def _later(self, frame: bytes, onward: _Onward) -> None:
        await asyncio.sleep(self._faults.delay_s)
        await onward(frame)


class _Onward(Protocol):
    async def __call__(self, frame: bytes, /) -> None: ...


def _spoiled(frame: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(frame)
    changed[int(rng.integers(len(changed)))] ^= int(rng.integers(1, 256))
    return bytes(changed)


@contextlib.asynccontextmanager
async def uplinks_to(address: UnitAddress) -> AsyncIterator[Callable[[], Awaitable[Uplink]]]:
    """Yield a function that opens one vehicle's uplink; connections that vehicles share are closed in the end."""
    if address.scheme == "udp":

        async def open_udp() -> Uplink:
            return await UdpUplink(address).open()

        yield open_udp
        return
    import httpx

    async with httpx.AsyncClient(timeout=HTTP_TIMEOUT_S) as client:

        async def open_http() -> Uplink:
            return HttpUplink(address, client)

        yield open_http


@contextlib.asynccontextmanager
async def uplink_to(address: UnitAddress) -> AsyncIterator[Uplink]:
    """Yield the uplink of the only vehicle there is; it is closed in the end."""
    async with uplinks_to(address) as open_uplink:
        uplink = await open_uplink()
        try:
            yield uplink
        finally:
            await uplink.close()

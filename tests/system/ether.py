"""A stretch of bad air between vehicles and a unit that writes down every datagram it is given.

It knows nothing of the code under test but the place of two fields in a frame's header: the kind of message (byte 3)
and the exchange it belongs to (bytes 8 to 15).
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, cast

from roadgrip.protocol import Kind


@dataclass
class Ether:
    """What was sent into the air, before anything happened to it, and what happens to it.

    Attributes:
        lost_frac: Share of datagrams that vanish.
        doubled_frac: Share that arrives twice.
        late_frac: Share that arrives behind later ones.
        chance: Decides.
        open: False lets nothing through.
        up: Datagrams that vehicles sent, by exchange.
        down: Datagrams that the unit sent, by exchange.
        delivered: Datagrams that reached a vehicle, by exchange and kind.
        on_delivery: Told after each of them.
    """

    lost_frac: float = 0.0
    doubled_frac: float = 0.0
    late_frac: float = 0.0
    chance: random.Random = field(default_factory=lambda: random.Random(1))
    open: bool = True
    up: Counter[bytes] = field(default_factory=Counter)
    down: Counter[bytes] = field(default_factory=Counter)
    delivered: Counter[tuple[bytes, int]] = field(default_factory=Counter)
    on_delivery: Callable[[], None] = lambda: None

    def exchanges_with(self, kind: Kind) -> int:
        """Return how many exchanges a message of this kind has reached the vehicle in."""
        return len({exchange for exchange, got in self.delivered if got == kind})

    def carry(self, datagram: bytes, onward: Callable[[bytes], None], *, up: bool) -> None:
        exchange = datagram[8:16]
        (self.up if up else self.down)[exchange] += 1
        if not self.open or self.chance.random() < self.lost_frac:
            return
        for _ in range(2 if self.chance.random() < self.doubled_frac else 1):
            if self.chance.random() < self.late_frac:
                asyncio.get_running_loop().call_later(0.02, onward, datagram)
            else:
                onward(datagram)
            if not up:
                self.delivered[exchange, datagram[3]] += 1
                self.on_delivery()


class _Vehicles(asyncio.DatagramProtocol):
    """The side that vehicles send to; opens one socket towards the unit for each of them."""

    def __init__(self, ether: Ether, unit_port: int) -> None:
        self._ether = ether
        self._unit_port = unit_port
        self._links: dict[Any, asyncio.Future[asyncio.DatagramTransport]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # The class that the loop uses does not say that it is a DatagramTransport.
        self._transport = cast("asyncio.DatagramTransport", transport)

    def datagram_received(self, data: bytes, addr: Any) -> None:
        task = asyncio.get_running_loop().create_task(self._carry_up(data, addr))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _carry_up(self, data: bytes, addr: Any) -> None:
        if addr not in self._links:
            self._links[addr] = asyncio.get_running_loop().create_future()
            transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
                lambda: _Unit(self._ether, lambda frame: self._transport.sendto(frame, addr)),
                remote_addr=("127.0.0.1", self._unit_port),
            )
            self._links[addr].set_result(transport)
        link = await self._links[addr]
        self._ether.carry(data, link.sendto, up=True)

    async def close(self) -> None:
        await asyncio.gather(*self._tasks)
        for link in self._links.values():
            (await link).close()
        self._transport.close()


class _Unit(asyncio.DatagramProtocol):
    def __init__(self, ether: Ether, onward: Callable[[bytes], None]) -> None:
        self._ether = ether
        self._onward = onward

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._ether.carry(data, self._onward, up=False)

    def error_received(self, exc: Exception) -> None:
        """Do nothing: the unit is not there."""


@asynccontextmanager
async def air_to(unit_port: int, ether: Ether) -> AsyncIterator[str]:
    """Yield the address at which vehicles find the unit behind this air."""
    transport, vehicles = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: _Vehicles(ether, unit_port), local_addr=("127.0.0.1", 0)
    )
    try:
        yield f"udp://127.0.0.1:{transport.get_extra_info('sockname')[1]}"
    finally:
        await vehicles.close()

"""The air between a car and a road side unit: bad, and at times none."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from math import inf

import numpy as np

from roadgrip.errors import RoadgripError
from roadgrip.frames import parse_frame
from vehicle_client.shell.live.units import heard_in
from vehicle_client.shell.uplink import AirCounts, AirFaults

Place = tuple[str, int]


class Air:
    """Looks like the unit to the car, and like cars to the unit."""

    def __init__(
        self,
        faults: AirFaults,
        *,
        unit: Place,
        beacons_to: Place,
        in_reach: Callable[[str], bool],
        rng: np.random.Generator,
    ) -> None:
        """Prepare.

        Args:
            faults: How bad it is, in both directions; beacons get through whole or not at all.
            unit: Where the unit listens.
            beacons_to: Where the car hears beacons.
            in_reach: Whether the unit of a section is in the car's reach now; with the empty string, any unit's.
            rng: Chance.
        """
        self._faults = faults
        self._unit = unit
        self._beacons_to = beacons_to
        self._in_reach = in_reach
        self._rng = rng
        self._front: asyncio.DatagramTransport | None = None
        self._ways: dict[Place, asyncio.DatagramTransport] = {}
        self._transports: list[asyncio.DatagramTransport] = []
        self._pending: set[asyncio.Task[None]] = set()
        self.counts = AirCounts()
        self.sent = Counter[bytes]()

    async def open(self) -> int:
        """Return the port to which the unit must send its beacons."""
        self._front = await self._socket(self._from_car)
        beacons = await self._socket(self._from_unit)
        return int(beacons.get_extra_info("sockname")[1])

    def close(self) -> None:
        """Be no more."""
        for task in self._pending:
            task.cancel()
        for transport in self._transports:
            transport.close()

    def at_unit(self, place: Place) -> None:
        """Take where the unit listens, once that is known."""
        self._unit = place

    async def _socket(self, take: Callable[[bytes, Place], None]) -> asyncio.DatagramTransport:
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(lambda: _Taker(take), local_addr=("127.0.0.1", 0))
        self._transports.append(transport)
        return transport

    def _from_unit(self, data: bytes, _: Place) -> None:
        try:
            heard = heard_in(data, ("", 0), verifier=None, wall_clock_s=0.0, age_limit_s=inf)
        except RoadgripError:
            return
        lost = self._rng.random() < self._faults.lost_frac
        if heard is not None and self._front is not None and self._in_reach(heard.section_id) and not lost:
            self._front.sendto(data, self._beacons_to)

    def _from_car(self, data: bytes, car: Place) -> None:
        self.sent[parse_frame(data).exchange_id] += 1
        self._begin(self._carry_up(data, car))

    async def _carry_up(self, data: bytes, car: Place) -> None:
        if car not in self._ways:
            self._ways[car] = await self._socket(lambda answer, _: self._begin(self._carry_down(answer, car)))
        await self._through(data, lambda frame: self._ways[car].sendto(frame, self._unit))

    async def _carry_down(self, data: bytes, car: Place) -> None:
        front = self._front
        if front is not None:
            await self._through(data, lambda frame: front.sendto(frame, car))

    async def _through(self, frame: bytes, onward: Callable[[bytes], None]) -> None:
        faults, counts = self._faults, self.counts
        counts.offered_count += 1
        lost, doubled, delayed, spoiled = self._rng.random(4) < (
            faults.lost_frac,
            faults.doubled_frac,
            faults.delayed_frac,
            faults.spoiled_frac,
        )
        if lost or not self._in_reach(""):
            counts.lost_count += 1
            return
        if spoiled:
            counts.spoiled_count += 1
            changed = bytearray(frame)
            changed[int(self._rng.integers(len(changed)))] ^= int(self._rng.integers(1, 256))
            frame = bytes(changed)
        counts.doubled_count += int(doubled)
        counts.delayed_count += int(delayed)
        if delayed:
            await asyncio.sleep(faults.delay_s)
        for _ in range(1 + int(doubled)):
            onward(frame)

    def _begin(self, work: asyncio._CoroutineLike[None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._pending.add(task)
        task.add_done_callback(self._pending.discard)


class _Taker(asyncio.DatagramProtocol):
    def __init__(self, take: Callable[[bytes, Place], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: Place) -> None:
        self._take(data, addr)

"""Road side units that a car hears, and what it makes of their broadcasts.

A unit sends its broadcasts from the socket on which it listens, so the address a datagram comes from is the unit's own:
an ARRIVAL goes back to it. What a broadcast says is believed as far as its signature: where an authority is
trusted, an unsigned one is refused, and so is a signed one that does not say until when it holds. One that was recorded
and is played again tells by its time of issue, if the unit knows the time (it says 0 when it does not) and the car
does. A broadcast played again can make a car announce itself to the wrong address and nothing more: the answer must be
signed for the exchange that the car has just drawn.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import time
from collections import Counter, OrderedDict
from dataclasses import dataclass
from ipaddress import ip_address
from math import isfinite
from typing import TYPE_CHECKING

from roadgrip.belief import check_broadcast
from roadgrip.errors import ConfigurationError, RoadgripError, WireError
from roadgrip.exchange import message_of
from roadgrip.frames import Complete, parse_frame
from roadgrip.protocol import Kind
from roadgrip.records import AdvisoryNotice, Beacon
from vehicle_client.shell.keys import CLOCK_SET_UNIX_S, Keys
from vehicle_client.shell.uplink import UnitAddress

if TYPE_CHECKING:
    from collections.abc import Callable

    from roadgrip.signing import Verifier

SECTIONS_LIMIT_COUNT = 32
"""Sections whose unit's address is remembered; the one heard longest ago makes room."""
IN_REACH_S = 30.0
"""A unit that was heard so lately is answered; beacons come every 10 s, and one may be lost."""
BEACON_AGE_LIMIT_S = 60.0
BROADCASTS_PER_S = 100.0
"""More than any place has units; what comes above it is dropped unread. Checking a signature takes 0.1 ms."""


@dataclass(frozen=True, slots=True)
class Heard:
    """A broadcast that is believed.

    Attributes:
        section_id: The section it is about.
        map_version: Of the unit's map.
        address: Where the unit is reached.
    """

    section_id: str
    map_version: str
    address: UnitAddress


class OldBroadcastError(RoadgripError):
    """A broadcast was played again, or one of the two clocks is wrong."""


def heard_in(
    datagram: bytes,
    source: tuple[str, int],
    *,
    verifier: Verifier | None,
    wall_clock_s: float,
    age_limit_s: float = BEACON_AGE_LIMIT_S,
) -> Heard | None:
    """Return what a broadcast tells, or None if it is none that a car acts on (a map, somebody's answer).

    Args:
        datagram: Any bytes.
        source: Host and port it came from.
        verifier: The units that are believed.
        wall_clock_s: Now, in seconds since 1970, by the car's own clock.
        age_limit_s: An issue farther from now, either way, is an old one; infinite judges no date, for a car without a
            clock.

    Raises:
        WireError: It cannot be read or is not believed.
        OldBroadcastError: It was issued too long ago, or is yet to be.
    """
    frame = parse_frame(datagram)
    if frame.kind not in {Kind.BEACON, Kind.ADVISORY} or frame.pieces_count != 1:
        return None
    whole = Complete(frame.kind, frame.section_key, frame.exchange_id, frame.fragment)
    judged = wall_clock_s >= CLOCK_SET_UNIX_S and isfinite(age_limit_s)
    message, signed = message_of(
        whole,
        expected=frozenset({Kind.BEACON, Kind.ADVISORY}),
        verifier=verifier,
        required=verifier is not None,
        now_unix_s=wall_clock_s if judged else None,
    )
    if not isinstance(message, Beacon | AdvisoryNotice):
        return None
    if signed is not None:
        check_broadcast(signed)
    known = message.issued_unix_s > 0 and wall_clock_s >= CLOCK_SET_UNIX_S
    if known and abs(wall_clock_s - message.issued_unix_s) > age_limit_s:
        raise OldBroadcastError(f"issued {wall_clock_s - message.issued_unix_s:.0f} s ago")
    return Heard(message.section_id, message.map_version, UnitAddress("udp", source[0], source[1]))


class UnitsInReach:
    """Which unit serves which section, as heard lately; bounded."""

    def __init__(self) -> None:
        """Know none."""
        self._heard: OrderedDict[str, tuple[UnitAddress, float]] = OrderedDict()

    def __len__(self) -> int:
        """Return how many sections' units are remembered."""
        return len(self._heard)

    def note(self, heard: Heard, *, now_s: float) -> None:
        """Remember where a section's unit is."""
        self._heard.pop(heard.section_id, None)
        self._heard[heard.section_id] = (heard.address, now_s)
        while len(self._heard) > SECTIONS_LIMIT_COUNT:
            self._heard.popitem(last=False)

    def address_of(self, section_id: str, *, now_s: float) -> UnitAddress | None:
        """Return where the section's unit is, if it was heard lately."""
        address, heard_s = self._heard.get(section_id, (None, 0.0))
        return address if now_s - heard_s <= IN_REACH_S else None


class BroadcastListener(asyncio.DatagramProtocol):
    """The socket on which broadcasts arrive."""

    def __init__(
        self,
        on_heard: Callable[[Heard], None],
        *,
        keys: Keys,
        age_limit_s: float = BEACON_AGE_LIMIT_S,
        counts: Counter[str],
    ) -> None:
        """Prepare.

        Args:
            on_heard: Called on the event loop with every broadcast that is believed.
            keys: The units that are believed.
            age_limit_s: See `heard_in`.
            counts: Where broadcasts are counted, by what became of them.
        """
        self._on_heard = on_heard
        self._keys = keys
        self._age_limit_s = age_limit_s
        self._counts = counts
        self._allowance_count = BROADCASTS_PER_S
        self._allowed_at_s = time.monotonic()

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Read a broadcast."""
        if not self._allowed():
            self._counts["beacons_dropped_flood"] += 1
            return
        try:
            heard = heard_in(
                data, addr[:2], verifier=self._keys.verifier, wall_clock_s=time.time(), age_limit_s=self._age_limit_s
            )
        except OldBroadcastError:
            self._counts["beacons_refused_old"] += 1
            return
        except WireError as error:
            self._counts[f"beacons_refused_{error.reason.value}"] += 1
            return
        if heard is not None:
            self._counts["beacons_heard"] += 1
            self._on_heard(heard)

    def _allowed(self) -> bool:
        now_s = time.monotonic()
        self._allowance_count = min(
            BROADCASTS_PER_S, self._allowance_count + (now_s - self._allowed_at_s) * BROADCASTS_PER_S
        )
        self._allowed_at_s = now_s
        if self._allowance_count < 1.0:
            return False
        self._allowance_count -= 1.0
        return True


async def listen_for_broadcasts(listener: BroadcastListener, *, host: str, port: int) -> asyncio.DatagramTransport:
    """Return the open socket; a multicast group is joined, any other address is bound.

    Raises:
        ConfigurationError: The address is not of this machine, or taken.
    """
    loop = asyncio.get_running_loop()
    link = None
    try:
        address = ip_address(host)
        link = socket.socket(socket.AF_INET6 if address.version == 6 else socket.AF_INET, socket.SOCK_DGRAM)
        link.settimeout(0.0)
        if address.is_multicast:
            # Other programs of the car may listen to the same group.
            link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            link.bind((host, port))
            if address.version == 6:
                link.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, address.packed + struct.pack("@I", 0))
            else:
                everywhere = socket.inet_aton("0.0.0.0")  # noqa: S104 - whichever interface the group comes on
                link.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, address.packed + everywhere)
        else:
            link.bind((host, port))
        transport, _ = await loop.create_datagram_endpoint(lambda: listener, sock=link)
    except (OSError, ValueError) as error:
        if link is not None:
            with contextlib.suppress(OSError):
                link.close()
        raise ConfigurationError(f"cannot listen for beacons on {host}:{port}: {error}") from error
    return transport

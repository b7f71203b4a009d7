"""What the car is told: JSON lines on a local socket, to as many readers as a dashboard has.

docs/live-client.md holds the schema. A reader gets a line with the present state when it connects, and one on every
change. Each line stands for itself, so a reader needs to keep only the last one. A reader that does not read is cut
off: nothing is kept for anybody beyond `WAITING_LIMIT_BYTES`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import stat
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from roadgrip.errors import ConfigurationError
from roadgrip.records import Advisory

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Callable

SCHEMA_VERSION = 1
READERS_LIMIT_COUNT = 8
WAITING_LIMIT_BYTES = 65_536
"""A map of 10 km as JSON is some 40 kB; a reader farther behind is not reading."""
REQUEST_LIMIT_BYTES = 64
HEARTBEAT_S = 5.0
GOODBYE_LIMIT_S = 0.2
COUNTERS_REQUEST = b"counters"


@dataclass(frozen=True, slots=True)
class ShownAdvice:
    """Advice that the driver may be shown.

    Attributes:
        section_id: The section it is about.
        advisory: As the unit sent it.
        expires_s: When it must be taken away, on the client's clock.
    """

    section_id: str
    advisory: Advisory
    expires_s: float


@dataclass(frozen=True, slots=True)
class SectionAhead:
    """A section that the car nears, drives or has just left.

    Attributes:
        section_id: The section.
        whereabouts: As in `vehicle_client.mapmatch.approach.Whereabouts`.
        map_version: Of the map that is known, or the empty string.
    """

    section_id: str
    whereabouts: str
    map_version: str


def advice_to_json(shown: ShownAdvice, *, now_s: float) -> dict[str, Any]:
    """Return advice as readers get it, with the seconds that are left of it."""
    advisory = shown.advisory
    interval = advisory.interval
    return {
        "section_id": shown.section_id,
        "speed_mps": round(advisory.speed_mps, 4),
        "reason": advisory.reason.value,
        "confidence": advisory.confidence.value,
        "friction": None if interval is None else {"mu_low": interval.mu_low, "mu_new": interval.mu_new},
        "valid_for_s": round(max(0.0, shown.expires_s - now_s), 2),
    }


def state_line(
    sections: tuple[SectionAhead, ...],
    advice: tuple[ShownAdvice, ...],
    *,
    source: str,
    now_s: float,
    sequence_number: int,
) -> dict[str, Any]:
    """Return the line that says everything a driver may be told now."""
    return {
        "v": SCHEMA_VERSION,
        "type": "state",
        "sequence": sequence_number,
        "source": source,
        "sections": [
            {"section_id": s.section_id, "whereabouts": s.whereabouts, "map_version": s.map_version} for s in sections
        ],
        "advice": [advice_to_json(shown, now_s=now_s) for shown in advice],
    }


def parse_dashboard_address(text: str) -> Path | tuple[str, int]:
    """Return the path of a Unix socket, or host and port of `tcp://127.0.0.1:PORT`.

    Raises:
        ConfigurationError: The address is not of this machine alone: whoever reached it could read along.
    """
    if not text.startswith("tcp://"):
        return Path(text)
    host, _, port = text.removeprefix("tcp://").rpartition(":")
    if host not in {"127.0.0.1", "localhost", "[::1]"} or not port.isdecimal() or int(port) > 65_535:
        raise ConfigurationError(f"{text!r} is no local address; write a path, or tcp://127.0.0.1:PORT")
    return host.strip("[]"), int(port)


class Dashboard:
    """The socket and its readers."""

    def __init__(
        self,
        *,
        present: Callable[[], list[dict[str, Any]]],
        counters: Callable[[], dict[str, Any]],
        counts: Counter[str],
    ) -> None:
        """Prepare.

        Args:
            present: Gives the lines that a new reader gets.
            counters: Gives the line that a reader gets who asks for `counters`.
            counts: Where readers that were cut off or turned away are counted.
        """
        self._present = present
        self._counters = counters
        self._counts = counts
        self._readers: dict[asyncio.StreamWriter, None] = {}
        self._serving: set[asyncio.Task[Any]] = set()
        self._server: asyncio.Server | None = None
        self._path: Path | None = None

    @property
    def readers_count(self) -> int:
        """Readers that are connected."""
        return len(self._readers)

    async def open(self, address: Path | tuple[str, int]) -> tuple[str, int] | Path:
        """Listen, and return where; a socket file that an earlier process left behind is replaced.

        Raises:
            ConfigurationError: The place cannot be listened on.
        """
        limit = REQUEST_LIMIT_BYTES
        try:
            if isinstance(address, Path):
                _remove_socket(address)
                self._server = await asyncio.start_unix_server(self._serve, address, limit=limit)
                self._path = address
                return address
            self._server = await asyncio.start_server(self._serve, *address, limit=limit)
        except OSError as error:
            raise ConfigurationError(
                f"cannot open the dashboard socket {address}: {error.strerror or error}"
            ) from error
        name = self._server.sockets[0].getsockname()
        return str(name[0]), int(name[1])

    async def close(self) -> None:
        """Send everybody away and take the socket file with us."""
        for writer in list(self._readers):
            writer.transport.abort()
        if self._server is not None:
            self._server.close()
        if self._serving:
            # Streams complain of a conversation that is cancelled; one whose other end is gone ends by itself.
            await asyncio.wait(self._serving, timeout=GOODBYE_LIMIT_S)
        if self._path is not None:
            with contextlib.suppress(OSError):
                self._path.unlink(missing_ok=True)

    def tell(self, line: dict[str, Any]) -> None:
        """Send a line to every reader; who lags behind is cut off. Never waits."""
        data = _encoded(line)
        for writer in list(self._readers):
            self._send(writer, data)

    def _send(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        transport = writer.transport
        if transport.is_closing():
            self._readers.pop(writer, None)
            return
        transport.write(data)
        if transport.get_write_buffer_size() > WAITING_LIMIT_BYTES:
            self._counts["dashboard_readers_cut_off"] += 1
            self._readers.pop(writer, None)
            transport.abort()

    def _cut_off_who_does_not_read(self) -> None:
        """Make room for a newcomer: whoever only holds a seat must not keep a display out."""
        # In the order of arrival: who has just come had no time yet to read.
        idle = next((writer for writer in self._readers if _unread_bytes(writer.transport) > 0), None)
        if idle is not None:
            self._counts["dashboard_readers_cut_off"] += 1
            self._readers.pop(idle)
            idle.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._readers) >= READERS_LIMIT_COUNT:
            self._cut_off_who_does_not_read()
        if len(self._readers) >= READERS_LIMIT_COUNT:
            self._counts["dashboard_readers_turned_away"] += 1
            writer.transport.abort()
            return
        self._readers[writer] = None
        task = asyncio.current_task()
        if task is not None:
            self._serving.add(task)
            task.add_done_callback(self._serving.discard)
        try:
            for line in self._present():
                self._send(writer, _encoded(line))
            while request := await reader.readline():
                if request.strip() == COUNTERS_REQUEST:
                    self._send(writer, _encoded(self._counters()))
        except (ConnectionError, ValueError):
            # ValueError: a request longer than any of ours.
            pass
        finally:
            self._readers.pop(writer, None)
            writer.transport.abort()


def _encoded(line: dict[str, Any]) -> bytes:
    return json.dumps(line, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _unread_bytes(transport: asyncio.WriteTransport) -> int:
    """Return what a reader has left unread, as far as it can be known; over TCP the other end's kernel hides it."""
    waiting_bytes = transport.get_write_buffer_size()
    link = transport.get_extra_info("socket")
    if sys.platform != "linux" or link is None or waiting_bytes > 0:
        return waiting_bytes
    import fcntl
    import termios

    try:
        queued = fcntl.ioctl(link.fileno(), termios.TIOCOUTQ, bytes(4))
    except OSError:
        return 0
    return int.from_bytes(queued, sys.byteorder)


def _remove_socket(path: Path) -> None:
    """Remove what an earlier process left, but never a file that is no socket."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise ConfigurationError(f"{path} exists and is no socket")
    path.unlink()

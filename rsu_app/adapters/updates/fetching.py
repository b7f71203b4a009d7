"""How the bytes of a repository come here: from a folder or over HTTP, always within a bounded time.

python-tuf asks for names relative to the repository, such as "metadata/timestamp.json", and bounds their size.
Its own fetcher is not used: it bounds each wait but not their sum, so that a server which sends a byte now and then
would keep it for ever; and it takes proxies from the environment, which nobody looks into on a roadside unit.
"""

from __future__ import annotations

import io
import json
import re
import socket
import time
from abc import abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from pathlib import Path
from typing import cast
from urllib.parse import SplitResult, urlsplit
from urllib.request import url2pathname

from tuf.api.exceptions import DownloadError, DownloadHTTPError, SlowRetrievalError
from tuf.ngclient.fetcher import FetcherInterface

from roadgrip.errors import RoadgripError

CHUNK_BYTES = 64 * 1024
OK_STATUS = 200
MISSING_STATUS = 404
_VERSIONED = re.compile(r"(?:.*/)?([0-9]+)\.[^/]+\.json")


class AddressError(RoadgripError):
    """An address that no repository can have; the message says what one looks like."""


class BoundedFetcher(FetcherInterface):
    """What folders and servers have in common: a deadline for everything, and errors python-tuf knows.

    Args:
        total_s: The visit ends so long after this was made.
    """

    def __init__(self, *, total_s: float) -> None:
        self._total_s = total_s
        self._until_s = time.monotonic() + total_s
        self._newest_metadata = ("", b"")

    @abstractmethod
    def _chunks(self, name: str) -> Iterator[bytes]:
        """Yield the content of a file of the repository."""

    def _fetch(self, url: str) -> Iterator[bytes]:
        try:
            yield from self._chunks(url)
        # python-tuf would let them through, and the caller would take them for its own disk's.
        except (OSError, HTTPException) as error:
            raise DownloadError(f"{url}: {str(error) or type(error).__name__}") from error

    def download_bytes(self, url: str, max_length: int) -> bytes:
        """Return the content of metadata, and remember it for `holds_another_version`."""
        content = super().download_bytes(url, max_length)
        self._newest_metadata = (url, content)
        return content

    def holds_another_version(self) -> bool:
        """Return whether the newest metadata is of another version than its name says: a file in another's place."""
        name, content = self._newest_metadata
        named = _VERSIONED.fullmatch(name)
        return named is not None and json.loads(content)["signed"]["version"] != int(named[1])

    def _remaining_s(self) -> float:
        """Return how long the visit may still take.

        Raises:
            SlowRetrievalError: It should have ended.
        """
        remaining_s = self._until_s - time.monotonic()
        if remaining_s <= 0.0:
            raise SlowRetrievalError(f"the repository took longer than {self._total_s:g} s")
        return remaining_s


class FolderFetcher(BoundedFetcher):
    """Reads a repository that lies in a folder, such as one on a stick.

    Args:
        folder: Holds the metadata and targets folders.
        total_s: Longest visit; folders of other machines can be slow.
    """

    def __init__(self, folder: Path, *, total_s: float) -> None:
        super().__init__(total_s=total_s)
        self._folder = folder

    def _chunks(self, name: str) -> Iterator[bytes]:
        path = self._folder / name
        # Opening a pipe would wait for a writer.
        if not path.is_file():
            raise DownloadHTTPError(f"there is no file {path}", MISSING_STATUS)
        with path.open("rb") as file:
            while chunk := file.read(CHUNK_BYTES):
                self._remaining_s()
                yield chunk


class HttpFetcher(BoundedFetcher):
    """Asks a web server. Follows no redirection, asks no proxy, speaks for nobody.

    Args:
        address: Of the repository, http or https; certificates are held against the machine's own list.
        silence_s: Longest wait for the next byte, and for a connection.
        total_s: Longest visit.
    """

    def __init__(self, address: SplitResult, *, silence_s: float, total_s: float) -> None:
        super().__init__(total_s=total_s)
        self._address = address
        self._silence_s = silence_s

    def _chunks(self, name: str) -> Iterator[bytes]:
        with self._connection() as connection:
            connection.request("GET", f"{self._address.path.rstrip('/')}/{name}", headers={"User-Agent": "roadgrip"})
            with connection.getresponse() as response:
                if response.status != OK_STATUS:
                    raise DownloadHTTPError(
                        f"{name}: the server answers with status {response.status}", response.status
                    )
                while chunk := response.read(CHUNK_BYTES):
                    yield chunk
                if response.length:
                    raise DownloadError(f"{name}: the connection ended {response.length} bytes too early")

    @contextmanager
    def _connection(self) -> Iterator[HTTPConnection]:
        make = HTTPSConnection if self._address.scheme == "https" else HTTPConnection
        connection = make(str(self._address.hostname), self._address.port, timeout=self._patience_s())
        connection.connect()
        with connection.sock as connected:
            # What http.client asks of a socket once it is connected is little, and all of it is there.
            connection.sock = cast("socket.socket", _PatientSocket(connected, self._patience_s))
            yield connection

    def _patience_s(self) -> float:
        return min(self._silence_s, self._remaining_s())


class _PatientSocket:
    """A connected socket that is read with a new timeout each time, so that bytes that trickle in end, too."""

    def __init__(self, connected: socket.socket, patience_s: Callable[[], float]) -> None:
        self._connected = connected
        self._patience_s = patience_s

    def sendall(self, content: bytes) -> None:
        self._connected.settimeout(self._patience_s())
        self._connected.sendall(content)

    def makefile(self, _mode: str) -> io.BufferedReader:
        return io.BufferedReader(_PatientReader(self._connected, self._patience_s))

    def close(self) -> None:
        """Do nothing: http.client closes before it has read an answer without a length, `_connection` afterwards."""


class _PatientReader(io.RawIOBase):
    def __init__(self, connected: socket.socket, patience_s: Callable[[], float]) -> None:
        super().__init__()
        self._connected = connected
        self._patience_s = patience_s

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]  # BufferedReader passes nothing else
        self._connected.settimeout(self._patience_s())
        return self._connected.recv_into(buffer)


def fetcher_for(address: str, *, silence_s: float, total_s: float) -> BoundedFetcher:
    """Return what brings the files of the repository at an address.

    Raises:
        AddressError: It is none.
    """
    try:
        parts = urlsplit(address)
        valid = parts.port is None or parts.hostname is not None
    except ValueError:
        valid = False
    # Not repeated in the message: it may hold a password.
    wanted = "the repository's address is neither a folder nor http(s)://host[:port]/path without a user"
    if not valid or not address.strip():
        raise AddressError(wanted)
    if parts.scheme in {"http", "https"} and parts.hostname and parts.username is None and not parts.query:
        return HttpFetcher(parts, silence_s=silence_s, total_s=total_s)
    if parts.scheme == "file" and parts.netloc in {"", "localhost"}:
        return FolderFetcher(Path(url2pathname(parts.path)), total_s=total_s)
    if "://" in address or parts.scheme in {"http", "https", "file"}:
        raise AddressError(wanted)
    return FolderFetcher(Path(address), total_s=total_s)

"""The other end of the control socket: how a command speaks to the unit that runs."""

from __future__ import annotations

import http.client
import json
import socket
from pathlib import Path
from typing import Any

from roadgrip.errors import RoadgripError
from rsu_app.unix_socket import socket_name

TIMEOUT_S = 300.0
"""A release over a slow line takes its time; the unit has limits of its own."""


class ControlError(RoadgripError):
    """The running unit cannot be spoken to."""


class _UnixConnection(http.client.HTTPConnection):
    def __init__(self, path: Path, *, timeout_s: float) -> None:
        super().__init__("unit", timeout=timeout_s)
        self._path = path
        self._timeout_s = timeout_s

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self._timeout_s)
        with socket_name(self._path) as name:
            self.sock.connect(name)


def ask(
    socket_path: Path, path: str, order: dict[str, Any] | None = None, *, timeout_s: float = TIMEOUT_S
) -> dict[str, Any] | None:
    """Return what the running unit answers, None if no unit runs.

    Args:
        socket_path: Its control socket.
        path: What is asked, such as "/status".
        order: What is to be done; None only asks.
        timeout_s: How long the unit may be silent.

    Raises:
        ControlError: It runs, and does not answer as it should, or this account may not ask.
    """
    connection = _UnixConnection(socket_path, timeout_s=timeout_s)
    try:
        body = None if order is None else json.dumps(order)
        headers = {} if body is None else {"Content-Type": "application/json"}
        connection.request("GET" if body is None else "POST", path, body=body, headers=headers)
        answer = connection.getresponse().read()
    except (FileNotFoundError, ConnectionRefusedError):
        return None
    except (OSError, http.client.HTTPException) as error:
        raise ControlError(f"the unit at {socket_path} does not answer: {error}") from error
    finally:
        connection.close()
    try:
        said: dict[str, Any] = json.loads(answer)
    except ValueError as error:
        raise ControlError(f"the unit at {socket_path} answers nonsense") from error
    return said

"""uvicorn, with one worker, our signals, and an end."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator

import uvicorn
from starlette.types import ASGIApp

from roadgrip.errors import ConfigurationError


class HttpServer(uvicorn.Server):
    """Serves one application in this process: several workers would each keep a window, and show their own metrics.

    Args:
        app: What is served.
        connections_limit_count: Connections at one time; more get 503.
        shutdown_s: How long open requests may take to finish.
        on_start: Called when requests are taken.
        on_stop: Called before open requests are waited for.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        connections_limit_count: int,
        shutdown_s: int,
        on_start: Callable[[], None],
        on_stop: Callable[[], None],
    ) -> None:
        super().__init__(
            uvicorn.Config(
                app,
                lifespan="off",
                log_config=None,
                access_log=False,
                server_header=False,
                limit_concurrency=connections_limit_count,
                timeout_graceful_shutdown=shutdown_s,
            )
        )
        self._on_start = on_start
        self._on_stop = on_stop
        self.failed = False

    def stop(self) -> None:
        """Stop serving; asked a second time, without waiting for open requests."""
        self.force_exit = self.should_exit
        self.should_exit = True

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave signals alone: uvicorn would raise them again before the database is closed."""
        yield

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Take requests, and say so."""
        await super().startup(sockets)
        self._on_start()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End what would outlast every patience, then the connections."""
        self._on_stop()
        await super().shutdown(sockets)


def listening_socket(host: str, port: int) -> socket.socket:
    """Return a bound socket. Bound here, so that a taken port is one line and not a log of uvicorn.

    Raises:
        ConfigurationError: The address is not of this machine, or taken.
    """
    link = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        link.bind((host, port))
    except OSError as error:
        link.close()
        raise ConfigurationError(
            f"cannot listen on http {host}:{port}: {error.strerror}; see http.host and http.port"
        ) from error
    link.setblocking(False)  # noqa: FBT003 - the standard library's signature
    return link

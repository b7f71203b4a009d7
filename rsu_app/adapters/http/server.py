"""uvicorn, with one worker, our signals, and an end."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
from collections.abc import Callable, Iterator
from functools import partial
from typing import cast

import uvicorn
from starlette.types import ASGIApp

from roadgrip.errors import ConfigurationError
from rsu_app.adapters.http.connections import BoundedConnection, ConnectionDesk, ConnectionLimits

HANDSHAKE_TIMEOUT_S = 10.0
"""Until TLS is agreed on; a connection is not counted before."""
BACKLOG_COUNT = 512


class HttpServer(uvicorn.Server):
    """Serves one application in this process: several workers would each keep a window, and show their own metrics.

    Args:
        app: What is served.
        limits: What a connection may take.
        shutdown_s: How long open requests may take to finish.
        on_start: Called when requests are taken.
        on_stop: Called before open requests are waited for.
        on_refusal: Told the reason of each connection that is refused or let go.
        tls: Makes it HTTPS.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        limits: ConnectionLimits,
        shutdown_s: int,
        on_start: Callable[[], None],
        on_stop: Callable[[], None],
        on_refusal: Callable[[str], None] = lambda _: None,
        tls: ssl.SSLContext | None = None,
    ) -> None:
        desk = ConnectionDesk(limits, on_refusal=on_refusal)
        super().__init__(
            uvicorn.Config(
                app,
                http=cast("type[asyncio.Protocol]", partial(BoundedConnection, desk)),
                ws="none",
                lifespan="off",
                log_config=None,
                access_log=False,
                server_header=False,
                # Whoever stands between would say whose request it is; nothing here trusts such words.
                proxy_headers=False,
                timeout_keep_alive=limits.idle_timeout_s,
                timeout_graceful_shutdown=shutdown_s,
            )
        )
        # A warning for every request that is none would let any sender fill the log; the metric counts them.
        logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
        self._tls = tls
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
        loop = asyncio.get_running_loop()

        def connection() -> asyncio.Protocol:
            make = cast("Callable[..., asyncio.Protocol]", self.config.http_protocol_class)
            return make(config=self.config, server_state=self.server_state, app_state={}, _loop=loop)

        self.servers = [
            await loop.create_server(
                connection,
                sock=link,
                ssl=self._tls,
                ssl_handshake_timeout=HANDSHAKE_TIMEOUT_S if self._tls else None,
                backlog=BACKLOG_COUNT,
            )
            for link in sockets or ()
        ]
        self.started = True
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

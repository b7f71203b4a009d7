"""The running process: what starts in which order, what repeats, and how it ends."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import AsyncExitStack, asynccontextmanager

import structlog

from roadgrip.errors import RoadgripError, StoreError
from rsu_app.adapters.http.app import create_app
from rsu_app.adapters.http.connections import ConnectionLimits
from rsu_app.adapters.http.control import control_socket, create_control_app
from rsu_app.adapters.http.door import Door
from rsu_app.adapters.http.server import HttpServer, listening_socket
from rsu_app.adapters.udp.endpoint import FrameEndpoint, open_endpoint
from rsu_app.bootstrap import Parts, build, load_sections, open_door, renew_trust, site_of_parts, software_version
from rsu_app.heap import give_back_freed_memory, spare_what_stays
from rsu_app.observability import Metrics, configure_logging
from rsu_app.operation import control_desk, one_line
from rsu_app.rollout_wiring import socket_path
from rsu_app.settings import Settings
from rsu_app.vital_signs import LOOK_PERIOD_S
from rsu_app.watchdog import ServiceManager, tell, tell_how_it_is, this_manager

_log = structlog.get_logger("roadgrip")

SWITCH_INTERVAL_S = 0.001
"""How long a thread of Python waits for another before it asks for its turn. One answers vehicles, another writes; with
Python's own 5 ms a commit waited most of its time for the event loop."""
REFRESH_PERIOD_S = 2.0
"""How often the unit looks whether time alone has changed its advice."""
DRIFT_PERIOD_S = 60.0
"""How often the unit looks at sections with new traffic; 20 ms of a thread each."""
CONTROL_CONNECTIONS_COUNT = 16
WATCH_PERIOD_S = 1.0
"""How often the unit looks at what a new bundle does; a misleading one stays for no longer than that."""
CATCH_UP_PERIOD_S = 10.0
"""How often the unit tries what a missing date or a full disk kept it from at the start."""
RESTORE_BEFORE_SERVING_S = 2.0
"""How long a start restores windows before it answers anybody, the newest vehicles first: some thousands, which is all
of them on most roads. The rest follows while vehicles are answered."""


def run(settings: Settings) -> None:
    """Run the unit until it is told to stop.

    Raises:
        RoadgripError: It cannot start; the message says why.
    """
    try:
        import uvloop
    except ImportError:
        asyncio.run(_run(settings))
    else:
        uvloop.run(_run(settings))


async def _run(settings: Settings) -> None:
    sections = load_sections(settings)
    metrics = Metrics(version=software_version(), section_ids=(s.section_id for s in sections))
    configure_logging(
        level=settings.log.level,
        style=settings.log.style,
        lines_limit_per_s=settings.log.lines_limit_per_s,
        on_drop=metrics.log_lines_dropped.inc,
    )
    door = open_door(settings)
    listener = listening_socket(settings.http.host, settings.http.port)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    async with AsyncExitStack() as stack:
        stack.callback(listener.close)
        parts = build(settings, metrics=metrics, sections=sections)
        stack.push_async_callback(parts.unit.close)
        for note in parts.store.notes:
            _log.info("store_note", note=note)
        restored_count = await _restored(parts)
        endpoint, udp_address = await _endpoint(parts)
        if endpoint is not None:
            stack.push_async_callback(endpoint.close)
        await parts.rollout.resume()
        control = _control_listener(settings)
        if control is not None:
            stack.callback(socket_path(settings).unlink, missing_ok=True)
            stack.callback(control.close)
        manager = this_manager()
        app = create_app(site_of_parts(parts, endpoint=endpoint, door=door))
        host, port = listener.getsockname()[:2]

        def say_serving() -> None:
            _log.info(
                "serving",
                version=software_version(),
                http=f"{door.url_scheme}://{_address(host, port)}",
                udp=udp_address,
                sections=list(parts.unit.section_ids),
                restored_count=restored_count,
            )
            tell(manager, "READY=1", f"STATUS={one_line(parts)}")

        def say_stopping() -> None:
            tell(manager, "STOPPING=1", "STATUS=stopping")
            parts.streams.close()

        server = HttpServer(
            app,
            limits=ConnectionLimits(
                connections_count=settings.http.connections_limit_count,
                per_source_count=settings.http.connections_per_source_count,
            ),
            shutdown_s=settings.http.shutdown_s,
            on_start=say_serving,
            on_stop=say_stopping,
            on_refusal=metrics.http_refusals.count,
            tls=None if door.tls is None else door.tls.context,
        )
        spare_what_stays()
        await stack.enter_async_context(_chores(parts, endpoint, server, manager, door))
        if control is not None:
            await stack.enter_async_context(_control(parts, control, door))
        _stop_on_signals(server)
        await server.serve(sockets=[listener])
        _log.info("stopping")
    _log.info("stopped")
    if server.failed:
        raise RoadgripError("a task of the unit failed; the log says which")


async def _restored(parts: Parts) -> int:
    try:
        restored_count = await parts.unit.catch_up(within_s=RESTORE_BEFORE_SERVING_S)
    except StoreError as error:
        _log.error("window_not_restored", error=str(error))
        return 0
    give_back_freed_memory()
    return restored_count


async def _endpoint(parts: Parts) -> tuple[FrameEndpoint | None, str]:
    udp = parts.settings.udp
    if not udp.enabled:
        return None, ""
    endpoint, (host, port) = await open_endpoint(
        parts.gateway,
        metrics=parts.metrics,
        host=udp.host,
        port=udp.port,
        broadcast_address=(udp.broadcast_host, udp.broadcast_port) if udp.broadcast_host else None,
        receive_buffer_bytes=udp.receive_buffer_bytes,
    )
    return endpoint, _address(host, port)


def _chores_of(
    parts: Parts, endpoint: FrameEndpoint | None, manager: ServiceManager, door: Door
) -> list[Coroutine[None, None, None]]:
    """Return what repeats while the unit runs."""

    async def refresh() -> None:
        parts.unit.refresh()

    async def catch_up() -> None:
        restored_count = await parts.unit.catch_up()
        if restored_count:
            give_back_freed_memory()
            _log.info("window_restored", restored_count=restored_count)

    async def prune() -> None:
        deleted_count = await parts.unit.prune()
        if deleted_count:
            _log.info("pruned", passages_count=deleted_count)

    async def look() -> None:
        parts.signs.look()
        door.refresh()
        renew_trust(parts)

    async def give_sign_of_life() -> None:
        if not tell_how_it_is(manager, parts.store.pulse, status=one_line(parts)):
            _log.critical("writer_stuck", busy_s=parts.store.pulse.busy_s)

    chores = [
        _repeat("vital_signs", look, period_s=LOOK_PERIOD_S),
        _repeat("refresh", refresh, period_s=REFRESH_PERIOD_S),
        # At once: a large window is restored while the unit answers.
        _repeat("catch_up", catch_up, period_s=CATCH_UP_PERIOD_S, first_after_s=0.0),
        _repeat("prune", prune, period_s=parts.settings.database.prune_period_s),
        _repeat("rollout", parts.rollout.watch, period_s=WATCH_PERIOD_S),
        _repeat("drift", parts.unit.watch_drift, period_s=DRIFT_PERIOD_S),
    ]
    if manager.address:
        chores.append(_repeat("watchdog", give_sign_of_life, period_s=manager.period_s))
    if parts.settings.updates.source:
        chores.append(_repeat("updates", parts.rollout.look, period_s=parts.settings.updates.poll_period_s))
    udp = parts.settings.udp
    if endpoint is not None and udp.broadcast_host and udp.beacon_period_s > 0.0:
        chores.append(endpoint.announce(period_s=udp.beacon_period_s))
    return chores


@asynccontextmanager
async def _chores(
    parts: Parts, endpoint: FrameEndpoint | None, server: HttpServer, manager: ServiceManager, door: Door
) -> AsyncIterator[None]:
    """Do what repeats while the unit runs; a chore that dies of a bug takes the unit down, loudly."""

    def on_end(task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.critical("chore_failed", error=repr(error))
            server.failed = True
            server.stop()

    tasks = [asyncio.create_task(chore) for chore in _chores_of(parts, endpoint, manager, door)]
    for task in tasks:
        task.add_done_callback(on_end)
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def _control_listener(settings: Settings) -> socket.socket | None:
    """Return where operators speak to the unit; None where the disk has no place for that, which stops no unit.

    Raises:
        ConfigurationError: Another unit uses the same shelf.
    """
    try:
        return control_socket(socket_path(settings))
    except OSError as error:
        _log.error("control_unavailable", path=str(socket_path(settings)), error=str(error))
        return None


@asynccontextmanager
async def _control(parts: Parts, listener: socket.socket, door: Door) -> AsyncIterator[None]:
    """Take orders of operators on this machine while the unit runs."""
    server = HttpServer(
        create_control_app(
            control_desk(parts, door_checks=lambda: door.checks(now_unix_s=parts.clock.unix_s())),
        ),
        limits=ConnectionLimits(connections_count=CONTROL_CONNECTIONS_COUNT),
        shutdown_s=parts.settings.http.shutdown_s,
        on_start=lambda: None,
        on_stop=lambda: None,
    )
    task = asyncio.create_task(server.serve(sockets=[listener]))
    try:
        yield
    finally:
        server.stop()
        await task


async def _repeat(
    name: str, chore: Callable[[], Awaitable[object]], *, period_s: float, first_after_s: float | None = None
) -> None:
    await asyncio.sleep(period_s if first_after_s is None else first_after_s)
    while True:
        try:
            await chore()
        except StoreError as error:
            _log.warning("chore_postponed", chore=name, error=str(error))
        await asyncio.sleep(period_s)


def _stop_on_signals(server: HttpServer) -> None:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, server.stop)


def _address(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

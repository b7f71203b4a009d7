"""The command `roadgrip-vehicle live`: the process that runs in a car."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import signal
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from roadgrip.errors import ConfigurationError
from vehicle_client.cli_options import Authorities, Credentials, Memory, Revocations

if TYPE_CHECKING:
    from collections.abc import Callable

    from vehicle_client.shell.live.settings import LiveSettings
    from vehicle_client.shell.live.source import Source
    from vehicle_client.vehicle_profile import VehicleProfile

AUTO = "auto"
NOBODY = "none"
DEFAULT_BEACONS = "0.0.0.0:4741"
DEFAULT_DASHBOARD = "roadgrip-dashboard.sock"


def live(  # noqa: PLR0917 - typer reads options by name
    can: Annotated[
        str | None, typer.Option("--can", metavar="INTERFACE:CHANNEL", help="The car's bus, such as socketcan:can0.")
    ] = None,
    signals: Annotated[
        str | None,
        typer.Option(help="Which signal of the bus, or of a played log, is which channel: signals.toml, or `example`."),
    ] = None,
    play: Annotated[
        Path | None,
        typer.Option(help="Play this recording instead of reading a bus: our CSV, or a log with --signals."),
    ] = None,
    speedup: Annotated[
        float, typer.Option(min=0.1, max=1000.0, help="How fast the recording is played; everything else is real time.")
    ] = 1.0,
    once: Annotated[
        bool, typer.Option("--once", help="End with the recording, when its passages are settled.")
    ] = False,
    vehicle: Annotated[
        Path | None, typer.Option(help="The car's file; left out, what signals.toml names, or the car of the paper.")
    ] = None,
    section: Annotated[
        list[str] | None,
        typer.Option("--section", "-s", help="A map known from the start: packaged name or section file. Repeat it."),
    ] = None,
    rsu: Annotated[
        str,
        typer.Option(
            help="`auto`: units are found by their beacons. Besides, http(s)://HOST:PORT asks a server over cellular "
            "for sections around the car, and udp://HOST:PORT is a unit that is always in reach."
        ),
    ] = AUTO,
    beacons: Annotated[
        str,
        typer.Option(metavar="HOST:PORT", help="Where beacons arrive: address, or multicast group; `none`: nowhere."),
    ] = DEFAULT_BEACONS,
    beacon_age: Annotated[
        float,
        typer.Option(
            min=0.0, help="Seconds; a beacon issued longer ago is refused. 0: no wall clock here, no date is judged."
        ),
    ] = 60.0,
    spool: Annotated[Path, typer.Option(help="Folder for summaries that wait for a unit.")] = Path("roadgrip-spool"),
    spool_capacity: Annotated[int, typer.Option(min=1, max=10_000, help="Summaries that wait at most.")] = 100,
    memory: Memory = None,
    dashboard: Annotated[
        str, typer.Option(help="Where advice is told: path of a Unix socket, tcp://127.0.0.1:PORT, or `none`.")
    ] = DEFAULT_DASHBOARD,
    advisory_can: Annotated[
        str | None,
        typer.Option(
            "--advisory-can", metavar="INTERFACE:CHANNEL", help="Send advice as a CAN frame on this bus, too."
        ),
    ] = None,
    advisory_id: Annotated[
        int | None, typer.Option(min=0, max=0x7FF, help="Identifier of that frame; left out, that of advisory.dbc.")
    ] = None,
    counters_every: Annotated[
        float, typer.Option(min=1.0, help="Seconds between two lines with counters in the log.")
    ] = 600.0,
    credential: Credentials = None,
    authority: Authorities = None,
    revocations: Revocations = None,
) -> None:
    """Run in a car: follow the sensors, tell the driver what units advise, report every passage.

    The log goes to standard output, one JSON object a line; docs/live-client.md describes it. SIGTERM and Ctrl-C end
    the client within a second, SIGUSR1 writes the counters.
    """
    from roadgrip.sections import read_section
    from vehicle_client.shell.keys import no_clock, read_keys, wall_clock_unix_s
    from vehicle_client.shell.live.dashboard import parse_dashboard_address
    from vehicle_client.shell.live.settings import LiveSettings
    from vehicle_client.shell.uplink import parse_unit_address

    if (can is None) == (play is None):
        raise ConfigurationError("say where sensor values come from: --can INTERFACE:CHANNEL, or --play FILE")
    if once and play is None:
        raise ConfigurationError("--once ends with a recording; a bus has no end")
    with contextlib.ExitStack() as stack:
        source, car, missing = (
            _bus(stack, str(can), signals) if play is None else _recording(play, signals, speedup_ratio=speedup)
        )
        settings = LiveSettings(
            spool_folder=spool,
            vehicle=car if vehicle is None else _vehicle(vehicle),
            keys=read_keys(
                credential or (), authority or (), revocations, unix_s=wall_clock_unix_s if beacon_age else no_clock
            ),
            unit=None if rsu in {AUTO, NOBODY} else parse_unit_address(rsu),
            beacons=None if beacons == NOBODY else _host_and_port(beacons),
            beacon_age_limit_s=beacon_age or inf,
            dashboard=None if dashboard == NOBODY else parse_dashboard_address(dashboard),
            sections=tuple(read_section(name) for name in section or ()),
            missing=missing,
            spool_capacity_count=spool_capacity,
            counters_period_s=counters_every,
            once=once,
            memory_file=memory,
        )
        send_advice = None if advisory_can is None else _sender(stack, advisory_can, advisory_id)
        asyncio.run(_run(settings, source, send_advice))


async def _run(settings: LiveSettings, source: Source, send_advice: Callable[..., bool] | None) -> None:
    from vehicle_client.shell.live.client import LiveClient

    client = LiveClient(settings, source, write=lambda line: print(line, flush=True), send_advice=send_advice)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, client.stop)
    loop.add_signal_handler(signal.SIGUSR1, client.log_counters)
    # What is here stays; the collector need not look through all modules again and again.
    gc.freeze()
    await client.run()


def _bus(stack: contextlib.ExitStack, text: str, signals: str | None) -> tuple[Source, VehicleProfile, tuple[str, ...]]:
    from vehicle_client.shell.can.buses import open_bus
    from vehicle_client.shell.can.description import can_mapping_at, path_of_signals, read_signals
    from vehicle_client.shell.can.live import CanSource
    from vehicle_client.shell.live.source import LiveBus
    from vehicle_client.vehicle_profile import PAPER_VEHICLE

    if signals is None:
        raise ConfigurationError("--can needs --signals: which signal is which channel")
    place = path_of_signals(signals)
    mapping = read_signals(place)
    if not mapping.dbc:
        raise ConfigurationError(f"{signals} names no dbc, which a bus needs")
    described = can_mapping_at(mapping, place)
    interface, channel = _interface_and_channel(text)
    reopen = partial(open_bus, interface, channel, frame_ids=described.frame_ids)
    source = stack.enter_context(CanSource(stack.enter_context(reopen()), described, reopen=reopen))
    car = _vehicle(place.parent / mapping.vehicle) if mapping.vehicle else PAPER_VEHICLE
    return LiveBus(source), car, mapping.missing


def _recording(
    path: Path, signals: str | None, *, speedup_ratio: float
) -> tuple[Source, VehicleProfile, tuple[str, ...]]:
    from vehicle_client.shell.live.source import PlayedTrace
    from vehicle_client.shell.recorded import RecordedAs, read_drive
    from vehicle_client.shell.sources import read_mapped

    if signals is not None:
        recording = read_mapped(path, signals)
        source = PlayedTrace(recording.aligned.trace, speedup_ratio=speedup_ratio)
        return source, recording.vehicle, recording.mapping.missing
    drive = read_drive(path, RecordedAs())
    return PlayedTrace(drive.recording.trace, speedup_ratio=speedup_ratio), drive.vehicle, ()


def _vehicle(path: Path) -> VehicleProfile:
    from vehicle_client.shell.sources import read_vehicle

    return read_vehicle(path)


def _sender(stack: contextlib.ExitStack, text: str, frame_id: int | None) -> Callable[..., bool]:
    from vehicle_client.shell.can.buses import open_bus
    from vehicle_client.shell.live.advisory_frame import AdvisoryFrames, AdvisorySender

    interface, channel = _interface_and_channel(text)
    bus = stack.enter_context(open_bus(interface, channel))
    return AdvisorySender(bus, AdvisoryFrames(frame_id=frame_id))


def _interface_and_channel(text: str) -> tuple[str, str]:
    interface, colon, channel = text.partition(":")
    if not colon or not interface or not channel:
        raise ConfigurationError(f"{text!r} is no bus; write INTERFACE:CHANNEL, such as socketcan:can0")
    return interface, channel


def _host_and_port(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 <= int(port) <= 65_535:
        raise ConfigurationError(f"{text!r} is no address to listen on; write HOST:PORT, or none")
    return host.strip("[]"), int(port)

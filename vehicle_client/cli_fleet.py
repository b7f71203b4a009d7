"""The command `roadgrip-vehicle fleet`: simulated vehicles report to a road side unit."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vehicle_client.cli_options import (
    DEFAULT_UNIT,
    AsJson,
    Authorities,
    BaseFriction,
    Credentials,
    Revocations,
    Section,
    Sensors,
    Unit,
    road_of,
)
from vehicle_client.simulator.plan import DECLARED_NOISE, SensorGrade

if TYPE_CHECKING:
    from vehicle_client.shell.fleet import FleetPlan
    from vehicle_client.shell.fleet_events import FleetReport
    from vehicle_client.shell.keys import Keys
    from vehicle_client.shell.uplink import UnitAddress


def fleet(  # noqa: PLR0917 - typer reads options by name
    section: Section = "long-turn",
    rsu: Unit = DEFAULT_UNIT,
    vehicles: Annotated[int, typer.Option(min=1, max=100_000, help="How many vehicles come.")] = 60,
    base_friction: BaseFriction = 0.35,
    friction_change: Annotated[
        list[str] | None,
        typer.Option(help="`0.25@0.5`: from half of the fleet on the road offers 0.25. May be repeated."),
    ] = None,
    arrivals_per_hour: Annotated[float, typer.Option(min=0.1, max=100_000.0, help="Vehicles per hour.")] = 100.0,
    regular: Annotated[bool, typer.Option(help="Let them come at equal distances instead of at random.")] = False,
    speedup: Annotated[
        float,
        typer.Option(min=1.0, max=1000.0, help="Hours per hour. Give the unit the same `clock.speedup_ratio`."),
    ] = 60.0,
    loss: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of frames that the air loses.")] = 0.05,
    doubled: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of frames that arrive twice.")] = 0.0,
    delayed: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of frames that arrive late.")] = 0.0,
    spoiled: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of frames with a changed byte.")] = 0.0,
    sensors: Sensors = SensorGrade.AUTOMOTIVE,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0, help="The same seed brings the same vehicles, drives and losses; left out, every fleet is new."
        ),
    ] = None,
    spool: Annotated[
        Path | None, typer.Option(help="Folder for summaries without a receipt; a temporary one if left out.")
    ] = None,
    credential: Credentials = None,
    authority: Authorities = None,
    revocations: Revocations = None,
    as_json: AsJson = False,
) -> None:
    """Let simulated vehicles drive a section and report to a road side unit.

    Each vehicle asks for map and advice, drives in the simulator, summarises what its sensors saw with the code that
    runs in cars, sends the summary and waits for its receipt; what the air loses is sent again within the budget of
    twelve frames. A unit that gets the same seed a second time refuses the passages as replayed, and rightly so.
    Exit code 1 if a summary was refused or never answered.
    """
    from rich.console import Console

    from vehicle_client.shell.fleet import FleetPlan, parse_friction_change
    from vehicle_client.shell.keys import read_keys
    from vehicle_client.shell.uplink import AirFaults, parse_unit_address
    from vehicle_client.shell.views import fleet_report_table, fleet_report_to_json

    keys = read_keys(credential or (), authority or (), revocations)
    address = parse_unit_address(rsu)
    plan = FleetPlan(
        section=asyncio.run(road_of(section, address, keys)),
        vehicles_count=vehicles,
        base_friction_mu=base_friction,
        changes=tuple(parse_friction_change(text) for text in friction_change or ()),
        arrivals_per_hour=arrivals_per_hour,
        regular=regular,
        speedup_ratio=speedup,
        grade=sensors,
        faults=AirFaults(lost_frac=loss, doubled_frac=doubled, delayed_frac=delayed, spoiled_frac=spoiled),
        seed=seed if seed is not None else secrets.randbits(32),
    )
    report = asyncio.run(_run_fleet(plan, address, keys, spool))
    if as_json:
        print(json.dumps(fleet_report_to_json(report), indent=1))
    else:
        Console().print(fleet_report_table(report))
    unheard = report.no_map_count + report.waiting_count + report.frames_spent_count + report.spool_dropped_count
    raise typer.Exit(1 if unheard or report.rejected else 0)


async def _run_fleet(plan: FleetPlan, address: UnitAddress, keys: Keys, spool: Path | None) -> FleetReport:
    from rich.console import Console

    from vehicle_client.pipeline import summarise_passage
    from vehicle_client.shell.fleet import FleetTools, run_fleet, simulator
    from vehicle_client.shell.uplink import uplinks_to
    from vehicle_client.shell.views import FleetProgress

    with contextlib.ExitStack() as stack:
        folder = spool if spool is not None else Path(stack.enter_context(tempfile.TemporaryDirectory()))
        progress = stack.enter_context(FleetProgress(Console(stderr=True), vehicles_count=plan.vehicles_count))
        async with uplinks_to(address) as open_uplink:
            return await run_fleet(
                plan,
                FleetTools(
                    open_uplink=open_uplink,
                    open_codec=keys.codecs_for(plan.section.section_id, speedup_ratio=plan.speedup_ratio),
                    simulate=simulator(),
                    summarise=partial(summarise_passage, noise=DECLARED_NOISE[plan.grade]),
                ),
                spool_folder=folder,
                watch=progress.watch,
            )

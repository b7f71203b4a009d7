"""The command `roadgrip-vehicle drive`: one simulated drive, looked at closely."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Annotated

import typer

from roadgrip.units import PASCAL_PER_BAR
from vehicle_client.cli_options import DEFAULT_UNIT, AsJson, BaseFriction, Section, Seed, Sensors, Unit, road_of
from vehicle_client.shell.single_drive import Evenness, StabilitySystem
from vehicle_client.simulator.plan import REFERENCE_PRESSURE_PA, DriverKind, SensorGrade


def drive(  # noqa: PLR0917 - typer reads options by name
    section: Section = "long-turn",
    rsu: Unit = DEFAULT_UNIT,
    base_friction: BaseFriction = 0.35,
    second_friction: Annotated[
        float | None,
        typer.Option(min=0.05, max=1.2, help="What the road offers from the middle of the section on, if it changes."),
    ] = None,
    driver: Annotated[
        DriverKind, typer.Option(help="`prudent` judges the surface by its looks, too; `reacting` by feeling alone.")
    ] = DriverKind.PRUDENT,
    speed_kmh: Annotated[
        float | None,
        typer.Option(
            "--speed", metavar="KMH", min=10.0, max=200.0, help="What the driver likes where nothing holds him back."
        ),
    ] = None,
    wear: Annotated[
        float | None,
        typer.Option(min=0.5, max=1.0, help="Share of the friction that worn tyres keep: 1 is new, 0.8 worn down."),
    ] = None,
    pressure_bar: Annotated[
        float, typer.Option("--pressure", metavar="BAR", min=1.5, max=3.5, help="Of the tyres; less grips more.")
    ] = REFERENCE_PRESSURE_PA / PASCAL_PER_BAR,
    roughness: Annotated[
        Evenness, typer.Option(help="Class of the surface by ISO 8608, from very good (`a`) to bad (`e`).")
    ] = Evenness.A,
    without: Annotated[
        list[StabilitySystem] | None, typer.Option(help="Switch this stability system off. May be repeated.")
    ] = None,
    sensors: Sensors = SensorGrade.AUTOMOTIVE,
    seed: Seed = 1,
    plot: Annotated[Path | None, typer.Option(help="Draw the drive into this file: .png, .svg or .pdf.")] = None,
    trace: Annotated[
        Path | None,
        typer.Option(
            help="Write what the sensors saw, for `replay`: .csv, .csv.gz, .parquet, or a CAN log of a made-up car "
            "(.blf, .asc, .log, .mf4; `--signals example` reads it)."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Simulate one drive and show what the car felt, what its sensors made of it, and what was true.

    What is left open (wear, speed, the driver's habits) is drawn by the seed. Needs no road side unit, unless the
    section is `rsu:ID`. A car that leaves the road or spins is shown as well, with exit code 0: it was simulated.
    """
    from rich.console import Console

    from roadgrip.units import kph_to_mps
    from vehicle_client.shell.drive_picture import draw_drive
    from vehicle_client.shell.keys import Keys
    from vehicle_client.shell.single_drive import (
        DriveOrder,
        drive_once,
        keep_trace,
        single_drive_table,
        single_drive_to_json,
    )
    from vehicle_client.shell.uplink import parse_unit_address

    order = DriveOrder(
        base_friction_mu=base_friction,
        second_friction_mu=second_friction,
        kind=driver,
        speed_mps=None if speed_kmh is None else kph_to_mps(speed_kmh),
        wear_factor=wear,
        pressure_pa=pressure_bar * PASCAL_PER_BAR,
        evenness=roughness,
        without=frozenset(without or ()),
        grade=sensors,
        seed=seed,
    )
    road = asyncio.run(road_of(section, parse_unit_address(rsu), Keys()))
    with Console(stderr=True).status("driving (the first time the simulator compiles, which takes a minute)"):
        driven = drive_once(road, order)
    if plot is not None:
        draw_drive(driven, road, plot)
    if trace is not None:
        keep_trace(driven, trace)
    if as_json:
        print(json.dumps(single_drive_to_json(driven), indent=1))
    else:
        Console().print(single_drive_table(driven, road))
        for name, path in (("picture", plot), ("trace", trace)):
            if path is not None:
                print(f"{name}: {path}")

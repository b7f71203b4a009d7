"""The command `roadgrip-vehicle`: send a fleet, replay a recording, look at one drive."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import sys
import tempfile
from importlib.metadata import version as distribution_version
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from roadgrip.errors import ConfigurationError, RoadgripError
from roadgrip.units import PASCAL_PER_BAR
from vehicle_client.shell.replay import RecordingFormat
from vehicle_client.shell.single_drive import Evenness, StabilitySystem
from vehicle_client.simulator.plan import REFERENCE_PRESSURE_PA, DriverKind, SensorGrade

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from vehicle_client.shell.fleet import FleetPlan
    from vehicle_client.shell.fleet_events import FleetReport
    from vehicle_client.shell.keys import Keys
    from vehicle_client.shell.uplink import UnitAddress

USAGE_ERROR = 2
DEFAULT_UNIT = "udp://127.0.0.1:4740"

app = typer.Typer(
    name="roadgrip-vehicle",
    help="The vehicle's side: turns a drive through a curve into 55 numbers and sends them to a road side unit.\n\n"
    "Start a unit with `roadgrip-rsu serve`, then try `roadgrip-vehicle drive` (no unit needed) and "
    "`roadgrip-vehicle fleet`.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)

Section = Annotated[
    str,
    typer.Option(
        "--section",
        "-s",
        help="The road: the name of a packaged section (long-turn, s-turn, sharp-turn), the path of a section file, or "
        "`rsu:ID` to ask the unit for its map.",
    ),
]
Unit = Annotated[
    str,
    typer.Option(
        "--rsu",
        help="The road side unit: `udp://HOST:PORT` as a radio would reach it, or `http://HOST:PORT` over cellular.",
    ),
]
RecordedAs = Annotated[
    RecordingFormat, typer.Option("--format", help="Whose columns they are; `roadgrip` is our own CSV.")
]
BaseFriction = Annotated[
    float,
    typer.Option(
        min=0.05, max=1.2, help="Friction the road offers a new tyre: 0.1 is wet ice, 0.3 packed snow, 0.8 dry asphalt."
    ),
]
Sensors = Annotated[SensorGrade, typer.Option(help="`ideal` sensors, or what a production car carries.")]
Seed = Annotated[int, typer.Option(min=0, help="The same seed brings the same vehicles, drives and losses.")]
AsJson = Annotated[bool, typer.Option("--json", help="Write JSON for a machine; progress goes to standard error.")]
SigningKey = Annotated[
    Path | None, typer.Option("--signing-key", help="Ed25519 private key (PEM) that signs what the vehicle sends.")
]
TrustedKeys = Annotated[
    list[Path] | None,
    typer.Option("--trusted-key", help="Ed25519 public key (PEM) of a unit; repeat it. Answers must then be signed."),
]


def _version(wanted: bool) -> None:
    if wanted:
        print(f"roadgrip {distribution_version('roadgrip')}")
        raise typer.Exit


@app.callback()
def _root(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version and leave.")
    ] = False,
) -> None:
    """Hold the options that come before a command."""


@app.command()
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
    signing_key: SigningKey = None,
    trusted_key: TrustedKeys = None,
    as_json: AsJson = False,
) -> None:
    """Let simulated vehicles drive a section and report to a road side unit.

    Each vehicle asks for map and advice, drives in the simulator, summarises what its sensors saw with the code that
    runs in cars, sends the summary and waits for its receipt; what the air loses is sent again within the budget of
    twelve frames. A unit that gets the same seed a second time refuses the passages as replayed, and rightly so.
    Exit code 1 if a summary was refused or never answered.
    """
    from vehicle_client.shell.fleet import FleetPlan, parse_friction_change
    from vehicle_client.shell.keys import read_keys
    from vehicle_client.shell.uplink import AirFaults, parse_unit_address
    from vehicle_client.shell.views import fleet_report_table, fleet_report_to_json

    keys = read_keys(signing_key, trusted_key or [])
    address = parse_unit_address(rsu)
    plan = FleetPlan(
        section=asyncio.run(_section(section, address, keys)),
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


@app.command()
def replay(  # noqa: PLR0917 - typer reads options by name
    recording: Annotated[Path, typer.Argument(help="A recording, such as `roadgrip-vehicle drive --trace` writes.")],
    section: Section = "long-turn",
    rsu: Unit = DEFAULT_UNIT,
    recording_format: RecordedAs = RecordingFormat.ROADGRIP,
    from_s: Annotated[float, typer.Option("--from", min=0.0, help="Seconds of the recording to leave out.")] = 0.0,
    to_s: Annotated[float, typer.Option("--to", min=0.0, help="Second at which to stop.")] = inf,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Summarise only; send nothing.")] = False,
    signing_key: SigningKey = None,
    trusted_key: TrustedKeys = None,
    as_json: AsJson = False,
) -> None:
    """Send a recorded drive as if it had just ended.

    Reads the recording, finds the section in it, shows the match and the summary, and sends it to a unit. Exit code 1
    if there is no passage in the recording, or the unit does not acknowledge it.
    """
    from vehicle_client.estimation.trace import part_of
    from vehicle_client.shell.keys import read_keys
    from vehicle_client.shell.replay import (
        read_trace,
        replay_table,
        replay_to_json,
        send_recorded,
        summarise_recording,
        vehicle_of,
    )
    from vehicle_client.shell.uplink import parse_unit_address

    keys = read_keys(signing_key, trusted_key or [])
    address = parse_unit_address(rsu)
    trace = part_of(read_trace(recording, recording_format), from_s=from_s, to_s=to_s)
    road = asyncio.run(_section(section, address, keys))
    replayed = summarise_recording(trace, road, vehicle=vehicle_of(recording_format))
    if not dry_run:
        replayed = asyncio.run(send_recorded(replayed, road, address, keys))
    if as_json:
        print(json.dumps(replay_to_json(replayed), indent=1))
    else:
        Console().print(replay_table(replayed))
    raise typer.Exit(0 if replayed.went_well else 1)


@app.command()
def survey(  # noqa: PLR0917 - typer reads options by name
    recording: Annotated[Path, typer.Argument(help="A recorded drive over the road.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The section file to write.")],
    section_id: Annotated[str, typer.Option("--id", help="Lower-case letters, digits, hyphens.")],
    speed_limit_kmh: Annotated[float, typer.Option("--speed-limit", metavar="KMH", help="Of the road.")],
    from_m: Annotated[float, typer.Option("--from-m", min=0.0, help="Where the section begins, in metres driven.")],
    to_m: Annotated[float, typer.Option("--to-m", min=0.0, help="Where it ends.")],
    recording_format: RecordedAs = RecordingFormat.ROADGRIP,
    as_json: AsJson = False,
) -> None:
    """Make a map from a recorded drive, where nobody has surveyed the road.

    The section is the line that was driven: flat, with an unknown bank, in coordinates of its own. Good enough to try
    a unit on one's own test track; a road register's line (`roadgrip-rsu section import`) is better.
    """
    from roadgrip.section_file import section_to_json
    from roadgrip.units import kph_to_mps
    from vehicle_client.mapmatch.survey import section_of_line
    from vehicle_client.shell.replay import recorded_line

    road = section_of_line(
        recorded_line(recording, recording_format),
        start_m=from_m,
        end_m=to_m,
        section_id=section_id,
        name=section_id,
        speed_limit_mps=kph_to_mps(speed_limit_kmh),
    )
    try:
        output.write_text(section_to_json(road), encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"cannot write {output}: {error.strerror or error}") from error
    figures = {
        "file": str(output),
        "length_m": road.length_m,
        "tightest_radius_m": road.tightest_radius_m,
        "version": road.version,
    }
    if as_json:
        print(json.dumps(figures, indent=1))
    else:
        print(
            f"{output}: {road.length_m:.1f} m, tightest radius {road.tightest_radius_m:.1f} m, version {road.version}; "
            f"look at it with `roadgrip-rsu section show {output}`"
        )


@app.command()
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
        Path | None, typer.Option(help="Write what the sensors saw into this CSV file, for `replay`.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Simulate one drive and show what the car felt, what its sensors made of it, and what was true.

    What is left open (wear, speed, the driver's habits) is drawn by the seed. Needs no road side unit, unless the
    section is `rsu:ID`. A car that leaves the road or spins is shown as well, with exit code 0: it was simulated.
    """
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
    road = asyncio.run(_section(section, parse_unit_address(rsu), Keys()))
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


async def _section(text: str, address: UnitAddress, keys: Keys) -> RoadSection:
    """Return the road that an option names."""
    from roadgrip.sections import read_section
    from vehicle_client.shell.roads import FROM_UNIT_PREFIX, ask_for_section
    from vehicle_client.shell.uplink import uplink_to

    if not text.startswith(FROM_UNIT_PREFIX):
        return read_section(text)
    section_id = text.removeprefix(FROM_UNIT_PREFIX)
    async with uplink_to(address) as uplink:
        return await ask_for_section(section_id, uplink=uplink, open_codec=keys.codecs_for(section_id))


async def _run_fleet(plan: FleetPlan, address: UnitAddress, keys: Keys, spool: Path | None) -> FleetReport:
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
                    summarise=summarise_passage,
                ),
                spool_folder=folder,
                watch=progress.watch,
            )


def main() -> None:
    """Run the command; a promise broken by the input is one line and exit code 2, never a traceback."""
    try:
        app()
    except RoadgripError as error:
        print(f"roadgrip-vehicle: {error}", file=sys.stderr)
        sys.exit(USAGE_ERROR)


if __name__ == "__main__":
    main()

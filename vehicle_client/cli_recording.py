"""The commands of `roadgrip-vehicle` about recorded drives: replay, survey, inspect, signals."""

from __future__ import annotations

import asyncio
import json
from contextlib import contextmanager
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from roadgrip.errors import ConfigurationError
from vehicle_client.cli_options import (
    DEFAULT_UNIT,
    AsJson,
    Authorities,
    Credentials,
    Format,
    Memory,
    Revocations,
    Section,
    Signals,
    Unit,
    Vehicle,
    road_of,
)
from vehicle_client.shell.recorded import RecordedAs, RecordingFormat

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from roadgrip.section import RoadSection
    from vehicle_client.estimation.grip.memory import CarMemory
    from vehicle_client.shell.keys import Keys
    from vehicle_client.shell.recorded import RecordedDrive
    from vehicle_client.shell.replay import Replay
    from vehicle_client.shell.uplink import UnitAddress
    from vehicle_client.vehicle_profile import VehicleProfile

FromS = Annotated[float, typer.Option("--from", min=0.0, help="Seconds of the recording to leave out.")]
ToS = Annotated[float, typer.Option("--to", min=0.0, help="Second at which to stop.")]
Recorded = Annotated[
    Path, typer.Argument(help="A CAN log, a CSV or Parquet file, such as `roadgrip-vehicle drive --trace` writes.")
]


def replay(  # noqa: PLR0917 - typer reads options by name
    recordings: Annotated[
        list[Path], typer.Argument(help="CAN logs, CSV or Parquet files of one car, in the order they were driven.")
    ],
    section: Section = "long-turn",
    rsu: Unit = DEFAULT_UNIT,
    mapping: Signals = "",
    vehicle: Vehicle = None,
    recording_format: Format = RecordingFormat.ROADGRIP,
    from_s: FromS = 0.0,
    to_s: ToS = inf,
    memory: Memory = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Summarise only; send nothing.")] = False,
    credential: Credentials = None,
    authority: Authorities = None,
    revocations: Revocations = None,
    as_json: AsJson = False,
) -> None:
    """Send recorded drives as if each had just ended.

    Reads a recording, finds the section in it, shows the match and the summary, and sends it to a unit. If the unit
    has a newer map, that one is fetched and the recording summarised again. With `--memory` the car learns from drive
    to drive, sent or not. Exit code 1 if a recording holds no passage, or the unit does not acknowledge it.
    """
    from rich.console import Console

    from vehicle_client.estimation.trace import part_of
    from vehicle_client.shell.car_memory import memory_of
    from vehicle_client.shell.keys import read_keys
    from vehicle_client.shell.replay import replay_table, replay_to_json, summarise_recording
    from vehicle_client.shell.uplink import parse_unit_address

    keys = read_keys(credential or (), authority or (), revocations)
    address = parse_unit_address(rsu)
    road: RoadSection | None = None
    shown, went_well = [], True
    for recording in recordings:
        drive = _read(recording, RecordedAs(recording_format, mapping, vehicle))
        trace = part_of(drive.recording.trace, from_s=from_s, to_s=to_s)
        before = None if memory is None else memory_of(memory, drive.vehicle)
        if road is None:
            road = asyncio.run(road_of(section, address, keys))
        summarise = partial(summarise_recording, trace, vehicle=drive.vehicle, memory=before)
        replayed = summarise(road)
        if not dry_run:
            replayed = asyncio.run(_sent(replayed, address, keys, summarise))
        road, went_well = replayed.section, went_well and replayed.went_well
        after = None if memory is None or before is None else _remembered(memory, replayed, drive.vehicle, before)
        if as_json:
            shown.append(replay_to_json(replayed, memory=after))
        else:
            Console().print(replay_table(replayed, memory=after))
    if as_json:
        print(json.dumps(shown[0] if len(shown) == 1 else shown, indent=1))
    raise typer.Exit(0 if went_well else 1)


def survey(  # noqa: PLR0917 - typer reads options by name
    recording: Recorded,
    output: Annotated[Path, typer.Option("--output", "-o", help="The section file to write.")],
    section_id: Annotated[str, typer.Option("--id", help="Lower-case letters, digits, hyphens.")],
    speed_limit_kmh: Annotated[float, typer.Option("--speed-limit", metavar="KMH", help="Of the road.")],
    from_m: Annotated[float, typer.Option("--from-m", min=0.0, help="Where the section begins, in metres driven.")],
    to_m: Annotated[float, typer.Option("--to-m", min=0.0, help="Where it ends.")],
    mapping: Signals = "",
    recording_format: Format = RecordingFormat.ROADGRIP,
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
    as_json: AsJson = False,
) -> None:
    """Make a map from a recorded drive, where nobody has surveyed the road.

    The section is the line that was driven: flat, with an unknown bank, in coordinates of its own. Good enough to try
    a unit on one's own test track; a road register's line (`roadgrip-rsu section import`) is better.
    """
    from roadgrip.section_file import section_to_json
    from roadgrip.units import kph_to_mps
    from vehicle_client.mapmatch.survey import section_of_line

    if output.exists() and not force:
        raise ConfigurationError(f"{output} is there already; --force writes over it")
    road = section_of_line(
        _read(recording, RecordedAs(recording_format, mapping)).line,
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


def inspect(
    recording: Recorded,
    mapping: Signals = "",
    vehicle: Vehicle = None,
    recording_format: Format = RecordingFormat.ROADGRIP,
    as_json: AsJson = False,
) -> None:
    """Say what each channel of a recording holds, and whether its sign, axis and unit look right.

    Compares the channels with each other: yaw rate with the wheels, lateral acceleration with yaw rate and speed,
    steering with the curve, forward acceleration with the change of speed, all of them with positions. A few minutes
    with some curves are best. Exit code 1 if something is off; the hint says what to write into the mapping.
    """
    from rich.console import Console

    from vehicle_client.recording.inspection import inspect_trace
    from vehicle_client.shell.inspected import findings_table, findings_to_json, hints_of, something_is_off

    drive = _read(recording, RecordedAs(recording_format, mapping, vehicle))
    findings = inspect_trace(drive.recording.trace, drive.vehicle.geometry, counts=drive.counts)
    if as_json:
        print(json.dumps(findings_to_json(findings, drive), indent=1))
    else:
        Console().print(findings_table(findings, drive))
        for hint in hints_of(findings):
            print(hint)
    raise typer.Exit(1 if something_is_off(findings) else 0)


def signals(
    folder: Annotated[Path, typer.Argument(help="Where the three files go; made if it is not there.")],
    dbc: Annotated[
        Path | None,
        typer.Option("--dbc", metavar="FILE", help="Your car's DBC: draft signals.toml by its names and units."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over files that are there.")] = False,
) -> None:
    """Write signals.toml, vehicle.toml and a DBC: a made-up car's as a pattern, or a draft for your own DBC.

    With `--dbc` the likeliest signal of each channel is filled in and the next ones are comments, all of them guesses.
    Without it the files are what `--signals example` reads. Then make vehicle.toml your car, and change signals.toml
    until `inspect` has nothing to say against it.
    """
    from vehicle_client.recording.mapping_draft import mapping_draft
    from vehicle_client.shell.can.description import EXAMPLE, path_of_signals, signals_of_dbc

    pattern = path_of_signals(EXAMPLE).parent
    contents = {
        name: (pattern / name).read_bytes() for name in ("signals.toml", "vehicle.toml", "roadgrip-example.dbc")
    }
    missing: tuple[str, ...] = ()
    if dbc is not None:
        text, missing = mapping_draft(signals_of_dbc(dbc), dbc=dbc.name)
        del contents["roadgrip-example.dbc"]
        contents["signals.toml"] = text.encode()
        if not (folder / dbc.name).exists() or not (folder / dbc.name).samefile(dbc):
            contents[dbc.name] = dbc.read_bytes()
    there = [str(folder / name) for name in contents if (folder / name).exists()]
    if there and not force:
        raise ConfigurationError(f"{', '.join(there)} is there already; --force writes over it")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            (folder / name).write_bytes(content)
    except OSError as error:
        raise ConfigurationError(f"cannot write into {folder}: {error.strerror or error}") from error
    print(f"{folder}: {', '.join(contents)}")
    if missing:
        print(f"nothing in {dbc} looks like {', '.join(missing)}; say in {folder / 'signals.toml'} where they are")


def _read(path: Path, recorded: RecordedAs) -> RecordedDrive:
    from vehicle_client.shell.recorded import read_drive

    with _progress(path) as watch:
        return read_drive(path, recorded, watch=watch)


@contextmanager
def _progress(path: Path) -> Iterator[Callable[[int, float], None]]:
    """Show on standard error how far the reading of a long log is; nothing where no one looks."""
    from rich.console import Console

    with Console(stderr=True).status(f"reading {path.name}") as status:
        yield lambda frames_count, _: status.update(f"reading {path.name}: {frames_count} frames")


def _remembered(path: Path, replayed: Replay, vehicle: VehicleProfile, before: CarMemory) -> CarMemory:
    """Return what the car knows of itself after a drive, which is in its file then."""
    from vehicle_client.pipeline import Summarised
    from vehicle_client.shell.car_memory import keep_memory, learned

    if not isinstance(replayed.made, Summarised):
        return before
    after = learned(replayed.made, vehicle, memory=before, seen_with=before)
    if after is not before:
        try:
            keep_memory(path, after, vehicle)
        except OSError as error:
            raise ConfigurationError(f"cannot write {path}: {error.strerror or error}") from error
    return after


async def _sent(
    replayed: Replay, address: UnitAddress, keys: Keys, summarise: Callable[[RoadSection], Replay]
) -> Replay:
    from vehicle_client.shell.replay import send_recorded
    from vehicle_client.shell.uplink import uplink_to

    async with uplink_to(address) as uplink:
        open_codec = keys.codecs_for(replayed.section.section_id)
        return await send_recorded(replayed, uplink, open_codec, summarise=summarise)

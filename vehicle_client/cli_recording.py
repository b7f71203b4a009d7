"""The commands of `roadgrip-vehicle` that read recorded drives: replay, survey."""

from __future__ import annotations

import asyncio
import json
from math import inf
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from roadgrip.errors import ConfigurationError
from vehicle_client.cli_options import (
    DEFAULT_UNIT,
    AsJson,
    RecordedAs,
    Section,
    SigningKey,
    TrustedKeys,
    Unit,
    road_of,
)
from vehicle_client.shell.replay import RecordingFormat


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
    road = asyncio.run(road_of(section, address, keys))
    replayed = summarise_recording(trace, road, vehicle=vehicle_of(recording_format))
    if not dry_run:
        replayed = asyncio.run(send_recorded(replayed, road, address, keys))
    if as_json:
        print(json.dumps(replay_to_json(replayed), indent=1))
    else:
        Console().print(replay_table(replayed))
    raise typer.Exit(0 if replayed.went_well else 1)


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

"""Options that several commands of `roadgrip-vehicle` share, and the road that one of them names."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vehicle_client.shell.recorded import RecordingFormat
from vehicle_client.simulator.plan import SensorGrade

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from vehicle_client.shell.keys import Keys
    from vehicle_client.shell.uplink import UnitAddress

DEFAULT_UNIT = "udp://127.0.0.1:4740"

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
Format = Annotated[
    RecordingFormat,
    typer.Option("--format", help="Whose columns a table has, without --signals; `roadgrip` is our own."),
]
Signals = Annotated[
    str,
    typer.Option(
        "--signals",
        metavar="FILE",
        help="What the frames of a CAN log (.blf, .asc, .log, .mf4), or the columns of a table, mean: a file such as "
        "docs/vehicle.md explains. `example` is the made-up car that `drive --trace drive.blf` writes.",
    ),
]
Vehicle = Annotated[
    Path | None,
    typer.Option(
        "--vehicle", metavar="FILE", help="The car that was driven; left out, what --signals or --format say of it."
    ),
]
Memory = Annotated[
    Path | None,
    typer.Option(
        "--memory",
        metavar="FILE",
        help="The car remembers here what its sensors and tyres are like, and goes by it; left out, it learns nothing.",
    ),
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
Credentials = Annotated[
    list[Path] | None,
    typer.Option(
        "--credential",
        metavar="PATH",
        help="A pseudonym to sign with (private key and certificate, PEM), or a folder of them; a passage takes one.",
    ),
]
Authorities = Annotated[
    list[Path] | None,
    typer.Option(
        "--authority",
        metavar="PATH",
        help="Public key (PEM) of an authority that certifies units, or a folder of them. Answers must then be signed.",
    ),
]
Revocations = Annotated[
    Path | None,
    typer.Option("--revocations", metavar="FILE", help="The authority's signed list of revoked certificates."),
]


async def road_of(text: str, address: UnitAddress, keys: Keys) -> RoadSection:
    """Return the road that an option names."""
    from roadgrip.sections import read_section
    from vehicle_client.shell.roads import FROM_UNIT_PREFIX, ask_for_section
    from vehicle_client.shell.uplink import uplink_to

    if not text.startswith(FROM_UNIT_PREFIX):
        return read_section(text)
    section_id = text.removeprefix(FROM_UNIT_PREFIX)
    async with uplink_to(address) as uplink:
        return await ask_for_section(section_id, uplink=uplink, open_codec=keys.codecs_for(section_id))

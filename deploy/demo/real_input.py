"""Real roads and a real drive through the whole system: `make real-input`.

Imports a surveyed mountain road as a section, makes a second section from one lap of a recorded race car, serves both
from one road side unit, fetches the first one's map over HTTP, and sends the car's next lap through the onboard
pipeline to the unit. Every step is one of the commands a user has, printed as it is run.

What comes out is what it is: a 1965 racing car is far outside of what the default model has seen, so the honest
answer is "accepted, stored, not counted: out of envelope".
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import httpx
import typer
from rich.console import Console

from deploy.demo.unit import DemoError, UnitFiles, UnitProcess, free_port

DEFAULT_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
ROAD_CSV = Path("roads") / "section_long_turn_ringebu.csv"
FERRARI_CSV = Path("vehicle") / "revs_ferrari250lm_20140222_01_01_03.csv.gz"
ROAD_ID = "ringebu-long-turn"
CURVE_ID = "ferrari-hairpin"
CURVE_FROM_M, CURVE_TO_M = 2030, 2330
"""A right-hander of 40 m radius and 190 degrees, in metres since the recording began."""
LAP_FROM_S, LAP_TO_S = 161.0, 180.5
"""The same place one lap later, with 130 m of approach and 90 m of exit."""


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with `roads/` and `vehicle/`.")] = DEFAULT_DATA,
    as_json: Annotated[bool, typer.Option("--json", help="Write JSON for a machine.")] = False,
) -> None:
    """Run real roads and a real drive through the whole system."""
    console = Console(stderr=as_json)
    missing = [str(data / name) for name in (ROAD_CSV, FERRARI_CSV) if not (data / name).is_file()]
    if missing:
        console.print(f"not there: {', '.join(missing)}; give the folder with --data", style="red")
        raise SystemExit(2)
    try:
        with tempfile.TemporaryDirectory(prefix="roadgrip-real-") as folder:
            found = run(data, Path(folder), console)
    except DemoError as error:
        console.print(f"error: {error}", style="red", highlight=False)
        raise SystemExit(1) from error
    if as_json:
        print(json.dumps(found, indent=1))
    else:
        _tell(found, console)


def run(data: Path, folder: Path, console: Console) -> dict[str, Any]:
    """Return what each step gave.

    Args:
        data: Where the real data lie.
        folder: For everything that is made.
        console: Where the commands are shown.

    Raises:
        DemoError: A step failed.
    """
    road_file, curve_file = folder / f"{ROAD_ID}.json", folder / f"{CURVE_ID}.json"
    recording = data / FERRARI_CSV
    road = _command(
        console,
        "rsu_app",
        *("section", "import", data / ROAD_CSV, "--id", ROAD_ID, "--speed-limit", 80, "-o", road_file),
    )
    curve = _command(
        console,
        "vehicle_client",
        *("survey", recording, "--format", "ferrari-250lm", "--id", CURVE_ID, "--speed-limit", 90),
        *("--from-m", CURVE_FROM_M, "--to-m", CURVE_TO_M, "-o", curve_file),
    )
    http_port, udp_port = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
    files = UnitFiles(folder / "rsu.toml", folder / "rsu.sqlite3", folder / "rsu.log")
    files.config.write_text(
        f'[[sections]]\nfile = "{road_file.name}"\n[[sections]]\nfile = "{curve_file.name}"\n'
        f'[database]\npath = "{files.database.name}"\n[http]\nport = {http_port}\n[udp]\nport = {udp_port}\n',
        encoding="utf-8",
    )
    console.print("$ roadgrip-rsu serve --config rsu.toml", style="bold", highlight=False)
    unit = UnitProcess(files, section_id=CURVE_ID, http_port=http_port)
    try:
        unit.wait_until_ready()
        served = httpx.get(f"{unit.url}/v1/sections/{ROAD_ID}/map", timeout=10.0).raise_for_status().json()
        advice = httpx.get(f"{unit.url}/v1/sections/{ROAD_ID}/advisory", timeout=10.0).raise_for_status().json()
        replayed = _command(
            console,
            "vehicle_client",
            *("replay", recording, "--format", "ferrari-250lm", "--from", LAP_FROM_S, "--to", LAP_TO_S),
            *("--section", curve_file, "--rsu", f"udp://127.0.0.1:{udp_port}"),
        )
        stored = unit.new_estimates()
    finally:
        unit.stop()
    return {
        "road": {"file": road, "served_version": served["version"], "advice": advice},
        "drive": {
            "section": curve,
            "replay": replayed,
            "stored": [{"mu": estimate.mu, "counted": estimate.counted} for estimate in stored],
        },
    }


def _command(console: Console, program: str, *arguments: object) -> dict[str, Any]:
    """Return the JSON that one of our commands answers."""
    name = {"rsu_app": "roadgrip-rsu", "vehicle_client": "roadgrip-vehicle"}[program]
    words = [Path(a).name if isinstance(a, Path) else str(a) for a in arguments]
    console.print(f"$ {name} {' '.join(words)}", style="bold", highlight=False, soft_wrap=True)
    done = subprocess.run(
        [sys.executable, "-m", program, *map(str, arguments), "--json"], capture_output=True, text=True, check=False
    )
    try:
        answer: dict[str, Any] = json.loads(done.stdout)
    except ValueError as error:
        raise DemoError(f"{name} {words[0]} failed: {done.stderr.strip() or done.stdout.strip()}") from error
    return answer


def _tell(found: dict[str, Any], console: Console) -> None:
    road, drive = found["road"], found["drive"]
    passage, exchange = drive["replay"]["passage"], drive["replay"]["exchange"]
    values = passage["values"]
    console.print(
        f"\nThe mountain road is served as map {road['served_version']}; advice without any vehicle: "
        f"{3.6 * road['advice']['speed_mps']:.0f} km/h ({road['advice']['reason'].replace('_', ' ')})."
    )
    console.print(
        f"The race car's lap was found in the map by {passage['match']['method'].replace('_', ' ')}, entry at "
        f"{passage['match']['entry_s']:.1f} s: {3.6 * values['speed_mean_mps']:.0f} km/h on average, sideslip "
        f"{values['sideslip_min_rad']:.3f} to {values['sideslip_max_rad']:.3f} rad ({', '.join(passage['quality'])})."
    )
    verdict = "counted" if exchange["counted"] else f"not counted: {', '.join(exchange['not_counted'])}"
    console.print(
        f"The unit answered: {exchange['ending']}, {verdict}. {exchange['frames_sent_count']} frames sent, "
        f"{exchange['frames_received_count']} received."
    )


if __name__ == "__main__":
    typer.run(main)

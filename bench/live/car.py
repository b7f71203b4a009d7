"""A live client that drives a journey, in a process of its own: python -m bench.live.car JOURNEY SPEEDUP ..."""

from __future__ import annotations

import argparse
import asyncio
import gc
import signal
from pathlib import Path

from bench.live.journey import JourneySource, read_journey
from vehicle_client.shell.live.client import LiveClient
from vehicle_client.shell.live.settings import LiveSettings


async def drive(settings: LiveSettings, source: JourneySource) -> None:
    """Run the client as `roadgrip-vehicle live` does."""
    client = LiveClient(settings, source, write=lambda line: print(line, flush=True))
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, client.stop)
    gc.freeze()
    await client.run()


def main() -> None:
    """Read the arguments and drive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("journey", type=Path)
    parser.add_argument("--speedup", type=float, required=True)
    parser.add_argument("--beacon-port", type=int, required=True)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--spool-capacity", type=int, required=True)
    chosen = parser.parse_args()
    settings = LiveSettings(
        spool_folder=chosen.folder / "spool",
        beacons=("127.0.0.1", chosen.beacon_port),
        dashboard=chosen.folder / "dash.sock",
        spool_capacity_count=chosen.spool_capacity,
        once=True,
    )
    source = JourneySource(read_journey(chosen.journey), chosen.journey.parent, speedup_ratio=chosen.speedup)
    asyncio.run(drive(settings, source))


if __name__ == "__main__":
    main()

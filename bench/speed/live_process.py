"""What the live client takes in memory: plays a recording to nobody and prints as the last line how many MB it had.

python bench/speed/live_process.py DRIVE.csv SECTION SPOOL [LIBRARY ...]    with any Python that has the vehicle role

Libraries are loaded first: what a car uses besides, such as those of its bus, although a file is played.

Started by `bench.speed.footprint` as a file, so that it runs where neither the benchmarks nor their libraries are.
"""

import importlib
import json
import sys
from pathlib import Path

PLAYED_TIMES = 20
"""How much faster than it was driven."""
NOBODY_HERE = "udp://127.0.0.1:9"


def memory_mb() -> float:
    """Return the most memory this process ever had; Linux only."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024 / 1e6
    raise RuntimeError("the system does not tell the memory of a process")


def play(drive: str, section: str, spool: Path) -> None:
    """Run `roadgrip-vehicle live` to the end of a recording, in this process."""
    from vehicle_client.__main__ import main

    sys.argv = ["roadgrip-vehicle", "live", "--play", drive, "--once", "--speedup", str(PLAYED_TIMES)]
    sys.argv += ["--section", section, "--rsu", NOBODY_HERE, "--beacons", "none", "--dashboard", "none"]
    sys.argv += ["--spool", str(spool)]
    try:
        main()
    except SystemExit as leaving:
        if leaving.code:
            raise
    if not any(spool.glob("*.json")):
        raise RuntimeError("the live client summarised no passage")


drive, section, spool, *libraries = sys.argv[1:]
for library in libraries:
    importlib.import_module(library)
play(drive, section, Path(spool))
print(json.dumps(memory_mb()))

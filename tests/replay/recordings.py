"""Where the public recordings lie; tests that need one skip where they do not."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from roadgrip.units import FloatArray
from vehicle_client.recording.foreign import Recording
from vehicle_client.recording.public import COMMA2K19_RAV4, FERRARI_250LM, IAC_AV21
from vehicle_client.shell.sources import read_recording

FOLDER = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "vehicle"


FERRARI = "revs_ferrari250lm_20140222_01_01_03.csv.gz"
INDY = "iac_av21_putnam_2023_run4_2.csv.gz"
MOTORWAY = "comma2k19_rav4_example1_seg40.csv.gz"
MAPPINGS = {FERRARI: FERRARI_250LM, INDY: IAC_AV21, MOTORWAY: COMMA2K19_RAV4}


def recording(name: str) -> Recording:
    """Return a public recording, or skip the test."""
    path = FOLDER / name
    if not path.is_file():
        pytest.skip(f"the recording {name} is not beside the project (../shared/data/vehicle)")
    return _read(path)


@cache
def _read(path: Path) -> Recording:
    # Large, and several tests share them.
    return read_recording(path, MAPPINGS[path.name])


def rms(values: FloatArray) -> float:
    return float((values**2).mean() ** 0.5)

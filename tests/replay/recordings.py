"""Where the public recordings lie; tests that need one skip where they do not."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from roadgrip.units import FloatArray
from vehicle_client.estimation.trace import Trace
from vehicle_client.shell.sources import COMMA2K19_RAV4, FERRARI_250LM, IAC_AV21, Recording, read_recording

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


def cut(trace: Trace, start: int, end: int) -> Trace:
    """Return the samples of a recording from `start` up to `end`."""
    part = slice(start, end)
    return Trace(
        time_s=trace.time_s[part],
        accel_x_mps2=trace.accel_x_mps2[part],
        accel_y_mps2=trace.accel_y_mps2[part],
        roll_rate_radps=trace.roll_rate_radps[part],
        yaw_rate_radps=trace.yaw_rate_radps[part],
        steer_rad=trace.steer_rad[part],
        wheel_speed_mps=trace.wheel_speed_mps[part],
        valid=trace.valid[part],
        quality=trace.quality,
    )


def rms(values: FloatArray) -> float:
    return float((values**2).mean() ** 0.5)

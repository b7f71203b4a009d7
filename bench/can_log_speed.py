"""How long the reading of a CAN log takes, and what memory it asks for: a made-up car, half of whose bus is mapped.

    python -m bench.can_log_speed --minutes 10

Times are CPU time of one core; memory is the growth of the process's peak over reading and alignment.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import can
import numpy as np
from rich.console import Console
from rich.table import Table

from roadgrip.units import SAMPLE_RATE_HZ, SAMPLE_S
from vehicle_client.estimation.trace import Trace
from vehicle_client.recording.frames import Frames
from vehicle_client.recording.series import trace_of_series
from vehicle_client.shell.can.description import path_of_signals, read_can_mapping
from vehicle_client.shell.can.log_names import LOG_SUFFIXES
from vehicle_client.shell.can.logs import read_log
from vehicle_client.shell.can.mf4 import write_mf4
from vehicle_client.shell.can.written import frames_of_trace, message_of

STRANGER_ID = 0x7
"""Of the frames that nobody asked for, one for each that is mapped."""


def made_up_trace(*, minutes: float) -> Trace:
    """Return a drive of sines: what the numbers are does not matter here."""
    time_s = SAMPLE_S * np.arange(int(60.0 * minutes * SAMPLE_RATE_HZ), dtype=np.float64)
    wave = np.sin(time_s)
    return Trace(
        time_s=time_s,
        accel_x_mps2=wave,
        accel_y_mps2=3.0 * wave,
        roll_rate_radps=0.1 * wave,
        yaw_rate_radps=0.2 * wave,
        steer_rad=0.05 * wave,
        wheel_speed_mps=20.0 + np.column_stack([wave] * 4),
        valid=np.ones(len(time_s), dtype=bool),
        stability_active=wave > 0.9,
    )


def write(path: Path, frames: Frames) -> None:
    """Write frames, each with a stranger behind it."""
    twice = np.repeat(np.arange(len(frames.time_s)), 2)
    ids = frames.frame_id[twice]
    ids[1::2] = STRANGER_ID
    both = Frames(frames.time_s[twice], ids, frames.extended[twice], frames.length_bytes[twice], frames.payloads[twice])
    if path.suffix == ".mf4":
        write_mf4(path, both)
        return
    with can.Logger(path) as log:
        for i, time_s in enumerate(both.time_s.tolist()):
            log.on_message_received(message_of(both, i, time_s=time_s))


def peak_memory_kb() -> int:
    """Return the most memory this process has held so far; the one of `getrusage` is inherited from its parent."""
    found = re.search(r"^VmHWM:\s+(\d+)", Path("/proc/self/status").read_text(encoding="ascii"), re.MULTILINE)
    return 0 if found is None else int(found[1])


def read(path: Path) -> str:
    """Return what reading and aligning a log costs: frames, seconds, megabytes."""
    mapping = read_can_mapping(path_of_signals("example"))
    counts = [0]

    def watch(frames_count: int, _: float) -> None:
        counts.append(frames_count)

    before_kb = peak_memory_kb()
    start_s = time.process_time()
    series = read_log(path, mapping, watch=watch)
    read_s = time.process_time() - start_s
    trace_of_series(series)
    align_s = time.process_time() - start_s - read_s
    return f"{counts[-1]} {read_s} {align_s} {(peak_memory_kb() - before_kb) / 1e3}"


def main() -> None:
    """Write a log of each kind, read each in a process of its own, and print a table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--minutes", type=float, default=10.0)
    arguments.add_argument("--read", type=Path, help=argparse.SUPPRESS)
    asked = arguments.parse_args()
    if asked.read is not None:
        print(read(asked.read))
        return
    frames = frames_of_trace(made_up_trace(minutes=asked.minutes), read_can_mapping(path_of_signals("example")))
    table = Table(
        "log", "MB", "frames", "µs per frame", "aligning", "s per hour", "memory", title=f"{asked.minutes:g} min"
    )
    with tempfile.TemporaryDirectory() as folder:
        for suffix in LOG_SUFFIXES:
            path = Path(folder) / f"drive{suffix}"
            write(path, frames)
            command = [sys.executable, "-m", "bench.can_log_speed", "--read", str(path)]
            told = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
            count, read_s, align_s, memory_mb = (float(word) for word in told)
            table.add_row(
                suffix,
                f"{path.stat().st_size / 1e6:.1f}",
                f"{count:.0f}",
                f"{1e6 * read_s / count:.1f}",
                f"{align_s:.2f} s",
                f"{(read_s + align_s) * 60.0 / asked.minutes:.1f}",
                f"{memory_mb:.0f} MB",
            )
    Console().print(table)


if __name__ == "__main__":
    main()

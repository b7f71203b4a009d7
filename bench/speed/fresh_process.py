"""What a car's first passage costs in a process that just started; prints one line of JSON and leaves.

python bench/speed/fresh_process.py DRIVE.npz SECTION     with any Python that has roadgrip's vehicle role installed

Started by `bench.speed.footprint` as a file, so that it runs where neither the benchmarks nor their libraries are.
"""

# ruff: noqa: E402 - what is imported when is what is measured
import json
import sys
import time
from pathlib import Path

CPU_S = time.process_time


def resident_mb(field: str = "VmRSS") -> float:
    """Return the memory of this process now, or with `VmHWM` the most there ever was; Linux only."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(field):
            return int(line.split()[1]) * 1024 / 1e6
    raise RuntimeError(f"the system does not tell {field}")


import numpy as np

figures = {"interpreter_numpy_ms": 1e3 * CPU_S(), "interpreter_numpy_mb": resident_mb()}

from roadgrip.records import Passage
from roadgrip.sections import read_section
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.recording.own_columns import trace_of_columns
from vehicle_client.shell.codec import WireCodec

figures["import_ms"] = 1e3 * CPU_S() - figures["interpreter_numpy_ms"]
figures["imported_mb"] = resident_mb()

began_s = CPU_S()
section = read_section(sys.argv[2])
trace = trace_of_columns(dict(np.load(sys.argv[1])), place="drive")
figures["read_ms"] = 1e3 * (CPU_S() - began_s)


def frames_of_passage() -> tuple[bytes, ...]:
    """Return the frames that a car sends after its drive."""
    outcome = summarise_passage(trace, section)
    if not isinstance(outcome, Summarised):
        raise RuntimeError(f"the drive was refused: {outcome}")  # noqa: TRY004 - a refusal is a value
    passage = Passage(bytes(range(16)), section.section_id, section.version, outcome.summary, 1.0)
    codec = WireCodec(passage.passage_id, section_id=section.section_id, timeout_s=5.0)
    return codec.frames_of(passage)


began_s = CPU_S()
frames_of_passage()
figures["first_passage_ms"] = 1e3 * (CPU_S() - began_s)
figures["from_start_ms"] = 1e3 * CPU_S()
again_ms = []
for _ in range(20):
    began_s = CPU_S()
    frames_of_passage()
    again_ms.append(1e3 * (CPU_S() - began_s))
figures["next_passage_ms"] = min(again_ms)
figures["peak_mb"] = resident_mb("VmHWM")
print(json.dumps(figures))

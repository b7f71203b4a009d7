"""What the unit needs: memory, time to start, processor time while nothing happens, disk where it is installed.

And whether a passage costs the same however many vehicles are in the window.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from bench.appliance.load import OUTSTANDING_COUNT
from bench.appliance.passages import draw_batch
from bench.appliance.processes import measured_core
from bench.appliance.rsu import Unit, serving
from bench.appliance.udp_load import ACCEPTED, exchange, line_to
from bench.speed.footprint import installed

SETTLE_S = 75.0
"""After the last passage, before the unit counts as idle: once a minute it looks at what came, for drift."""
RESTORE_LIMIT_S = 300.0
_BYTES_PER_MB = 1e6
_IMPORT_ALL = """
import contextlib, importlib, sys
for name in sys.stdin.read().split():
    with contextlib.suppress(ImportError):
        importlib.import_module(name)
"""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is measured.

    Attributes:
        passages_count: In the window at last.
        blocks_count: Points of the plot.
        idle_s: Doing nothing.
        starts_count: Starts of each kind; the median counts.
    """

    passages_count: int = 100_000
    blocks_count: int = 20
    idle_s: float = 60.0
    starts_count: int = 3


def window_and_memory(folder: Path, effort: Effort, *, rng: np.random.Generator) -> dict[str, Any]:
    """Return what passages cost while the window fills, and what the unit holds and does when it is full."""
    block_count = effort.passages_count // effort.blocks_count
    with serving(folder) as unit, line_to(unit.host, unit.udp_port) as line:
        at_start_mb = unit.resident_mb
        points = []
        for _ in range(effort.blocks_count):
            batch = draw_batch(block_count, rng=rng)
            frames, began_cpu_s = batch.frames(), unit.cpu_s
            done = exchange(line, frames, batch.tag, outstanding_count=OUTSTANDING_COUNT)
            points.append(
                {
                    "window_count": unit.metric("roadgrip_window_passages"),
                    "cpu_us_per_passage": 1e6 * (unit.cpu_s - began_cpu_s) / max(1, done.count(ACCEPTED)),
                    "resident_mb": unit.resident_mb,
                }
            )
        time.sleep(min(SETTLE_S, effort.idle_s))
        idle = _idle_frac(unit, effort.idle_s)
        full_mb, database_bytes = unit.resident_mb, unit.metric("roadgrip_store_bytes")
    with serving(folder) as unit:
        began_s, at_ready_count = time.perf_counter(), unit.metric("roadgrip_window_passages")
        while unit.metric("roadgrip_window_passages") < points[-1]["window_count"]:
            if time.perf_counter() - began_s > RESTORE_LIMIT_S:
                raise TimeoutError(f"the window is not restored after {RESTORE_LIMIT_S:.0f} s")
            time.sleep(0.5)
        restart = {
            "ready_s": unit.ready_s,
            "window_at_ready_count": at_ready_count,
            "whole_s": unit.ready_s + time.perf_counter() - began_s,
        }
    costs = np.array([point["cpu_us_per_passage"] for point in points])
    quarter = max(1, len(costs) // 4)
    return {
        "passages_count": block_count * effort.blocks_count,
        "points": points,
        "cost_last_to_first_quarter_ratio": float(np.median(costs[-quarter:]) / np.median(costs[:quarter])),
        "rss_at_start_mb": at_start_mb,
        "rss_mb": full_mb,
        "idle_cpu_frac": idle,
        "idle_s": effort.idle_s,
        "database_mb": database_bytes / _BYTES_PER_MB,
        "restart_with_full_window": restart,
    }


def starts(folder: Path, effort: Effort) -> dict[str, Any]:
    """Return how long the unit takes to be ready, and how long its imports take, and how much memory.

    Python imports by itself what the daemon has imported when it is ready, in the same order.
    """
    with serving(folder) as unit:
        first_s = unit.ready_s  # makes its database
    modules = _imported_by_daemon(folder)
    ready_s, import_s = [], []
    for _ in range(effort.starts_count):
        with serving(folder) as unit:
            ready_s.append(unit.ready_s)
        began_s = time.perf_counter()
        subprocess.run(
            [sys.executable, "-c", _IMPORT_ALL],
            input="\n".join(modules),
            text=True,
            check=True,
            preexec_fn=_on_measured_core,
        )
        import_s.append(time.perf_counter() - began_s)
    weighed = subprocess.run(
        [sys.executable, "-m", "bench.appliance.memory_bill"],
        input="\n".join(modules),
        text=True,
        check=True,
        stdout=subprocess.PIPE,
    )
    return {
        "ready_s": median(ready_s),
        "import_s": median(import_s),
        "first_start_ready_s": first_s,
        "modules_count": len(modules),
        "memory_mb": json.loads(weighed.stdout),
    }


def install(folder: Path) -> dict[str, Any]:
    """Return what a new environment with the unit in it takes on the disk, package by package.

    Needs a package index for what is not in the cache.
    """
    python = installed(folder, role="rsu")
    (packages,) = (python.parents[1] / "lib").glob("python*/site-packages")
    bill = {
        f"{distribution.metadata['Name']} {distribution.version}": sum(
            Path(str(file.locate())).stat().st_size
            for file in {*(distribution.files or ())}
            if Path(str(file.locate())).is_file()
        )
        / _BYTES_PER_MB
        for distribution in distributions(path=[str(packages)])
    }
    everything = sum(path.stat().st_size for path in python.parents[1].rglob("*") if path.is_file())
    bytecode = sum(path.stat().st_size for path in packages.rglob("*.pyc"))
    return {
        "install_mb": everything / _BYTES_PER_MB,
        "bytecode_mb": bytecode / _BYTES_PER_MB,
        "packages_mb": dict(sorted(bill.items(), key=lambda entry: -entry[1])),
    }


def _idle_frac(unit: Unit, duration_s: float) -> float:
    began_cpu_s, began_s = unit.cpu_s, time.perf_counter()
    time.sleep(duration_s)
    return (unit.cpu_s - began_cpu_s) / (time.perf_counter() - began_s)


def _imported_by_daemon(folder: Path) -> list[str]:
    """Return the modules that a daemon has imported when it is ready, in that order."""
    with serving(folder, tell_imports=True) as unit:
        told = (unit.folder / "log").read_text(encoding="utf-8", errors="replace")
    names = [line.rpartition("|")[2].strip() for line in told.splitlines() if line.startswith("import time:")]
    return [name for name in names if _can_be_imported(name)]


def _can_be_imported(name: str) -> bool:
    return bool(name) and all(part.isidentifier() for part in name.split(".")) and "__main__" not in name


def _on_measured_core() -> None:
    os.sched_setaffinity(0, measured_core())

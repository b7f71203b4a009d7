"""Under which conditions something was measured: machine, software, disk, and what else was going on."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from bench.appliance.processes import loading_core, measured_core
from bench.measurement import processor

LIBRARIES = (
    *("roadgrip", "numpy", "onnxruntime", "uvloop", "uvicorn", "httptools", "fastapi", "starlette", "sqlalchemy"),
    *("cbor2", "cryptography"),
)
FSYNCS_COUNT = 200
PAGE_BYTES = 4_096


def conditions(folder: Path) -> dict[str, Any]:
    """Return what a reader must know about a measurement that begins now.

    Args:
        folder: On the disk that the databases lie on.
    """
    fsync_ms = 1e3 * fsync_s(folder)
    return {
        "at": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": commit(),
        "processor": processor(),
        "cores_count": os.cpu_count() or 1,
        "measured_core": min(measured_core()),
        "loading_core": min(loading_core()),
        "load_average": round(os.getloadavg()[0], 2),
        "busy_frac": round(busy_frac(), 3),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "libraries": {name: found for name in LIBRARIES if (found := installed_version(name))},
        "fsync_q50_ms": round(float(np.quantile(fsync_ms, 0.5)), 3),
        "fsync_q99_ms": round(float(np.quantile(fsync_ms, 0.99)), 3),
    }


def fsync_s(folder: Path) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return how long each of some appends took to reach the disk. (FSYNCS_COUNT,)"""
    path, took_s = folder / "fsync", []
    with path.open("wb", buffering=0) as file:
        for _ in range(FSYNCS_COUNT):
            file.write(bytes(PAGE_BYTES))
            began_s = time.perf_counter()
            os.fsync(file.fileno())
            took_s.append(time.perf_counter() - began_s)
    path.unlink()
    return np.array(took_s)


def busy_frac(interval_s: float = 0.5) -> float:
    """Return the share of all cores that others use, while this process does nothing for a moment. Linux only."""
    before = _jiffies()
    time.sleep(interval_s)
    after = _jiffies()
    total, idle = after[0] - before[0], after[1] - before[1]
    return 1.0 - idle / total if total else 0.0


def commit() -> str:
    """Return the commit of the working tree, with a plus sign if something in it was changed."""
    root = Path(__file__).resolve().parents[2]

    def told(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=False)  # noqa: S607 - git
        return done.stdout.strip()

    changed = told("status", "--porcelain", "--untracked-files=no", "--", "roadgrip", "rsu_app", "bench", "migrations")
    return f"{told('rev-parse', '--short', 'HEAD') or 'unknown'}{'+' if changed else ''}"


def installed_version(name: str) -> str:
    """Return the version of a distribution in this environment; nothing if it is not there."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _jiffies() -> tuple[int, int]:
    fields = [int(word) for word in Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()[1:9]]
    return sum(fields), fields[3] + fields[4]


if sys.platform != "linux":
    raise RuntimeError("the bench of the appliance reads /proc: it runs on Linux only")

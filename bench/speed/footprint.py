"""What the client takes on a car's computer: disk where it is installed, memory and time in fresh processes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from vehicle_client.estimation.trace import Trace
from vehicle_client.recording.own_columns import columns_of_trace
from vehicle_client.shell.sources import write_trace_csv

ROOT = Path(__file__).resolve().parents[2]
FRESH_PROCESS = Path(__file__).with_name("fresh_process.py")
LIVE_PROCESS = Path(__file__).with_name("live_process.py")
PROCESSES_COUNT = 7
_BUS = ("can", "cantools")
LIVE_LIBRARIES = {
    "alone_peak_mb": (),
    "with_bus_peak_mb": _BUS,
    "with_bus_and_keys_peak_mb": (*_BUS, "cryptography.hazmat.primitives.serialization"),
}
_BYTES_PER_MB = 1e6


def installed(folder: Path, *, role: str = "vehicle") -> Path:
    """Return the Python of a new environment that holds a locked role and roadgrip's wheel, nothing else.

    Needs a package index for what is not in the cache.

    Args:
        folder: An empty folder that becomes the environment.
        role: Which of `requirements/ROLE.txt`.
    """
    uv, python = Path(sys.executable).with_name("uv"), folder / "venv" / "bin" / "python"
    _run(sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", folder, ROOT)
    _run(uv, "venv", "--quiet", "--python", sys.executable, folder / "venv")
    install = (uv, "pip", "install", "--quiet", "--compile-bytecode", "--python", python)
    _run(*install, "--require-hashes", "-r", ROOT / "requirements" / f"{role}.txt")
    _run(*install, "--no-deps", *folder.glob("*.whl"))
    return python


def installed_mb(python: Path) -> dict[str, float]:
    """Return what an environment holds: everything, the compiled bytecode in it, and its largest parts."""
    (packages,) = (python.parents[1] / "lib").glob("python*/site-packages")
    sizes = {
        path.relative_to(packages): path.stat().st_size / _BYTES_PER_MB
        for path in packages.rglob("*")
        if path.is_file()
    }
    parts: dict[str, float] = {}
    for path, size_mb in sizes.items():
        parts[path.parts[0]] = parts.get(path.parts[0], 0.0) + size_mb
    largest = sorted(parts, key=parts.__getitem__, reverse=True)[:5]
    return {
        "all_mb": sum(sizes.values()),
        "bytecode_mb": sum(size_mb for path, size_mb in sizes.items() if path.suffix == ".pyc"),
        **{f"{name}_mb": parts[name] for name in largest},
    }


def fresh_figures(python: Path, trace: Trace, section_name: str, folder: Path) -> dict[str, float]:
    """Return what a first passage costs: times the least of some processes, memory the most.

    Args:
        python: Which Python runs them.
        trace: The drive.
        section_name: A packaged section.
        folder: Where the drive is laid down for them.
    """
    drive = folder / "drive.npz"
    np.savez(drive, **columns_of_trace(trace))  # type: ignore[arg-type]
    told = [json.loads(_run(python, FRESH_PROCESS, drive, section_name)) for _ in range(PROCESSES_COUNT)]
    return {name: (max if name.endswith("_mb") else min)(figures[name] for figures in told) for name in told[0]}


def live_figures(python: Path, trace: Trace, section_name: str, folder: Path) -> dict[str, float]:
    """Return the memory of the live client that plays a drive, by itself and with the libraries of bus and keys.

    Args:
        python: Which Python runs it.
        trace: The drive.
        section_name: A packaged section.
        folder: Where the drive and the spools lie.
    """
    drive = folder / "drive.csv"
    write_trace_csv(drive, trace)
    figures: dict[str, float] = {}
    for name, libraries in LIVE_LIBRARIES.items():
        lines = _run(python, LIVE_PROCESS, drive, section_name, folder / name, *libraries).splitlines()
        figures[name] = json.loads(lines[-1])
    return figures


def _run(*command: str | Path) -> str:
    # Outside the working tree, so that an environment shows what is installed in it and not what lies here.
    done = subprocess.run([str(word) for word in command], cwd="/", capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(map(str, command))}\n{done.stderr}")
    return done.stdout

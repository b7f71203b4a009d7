"""The machine and the tools that results are made with, as far as a reader of them wants to know it."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path

_DRIVING_TOOLS = ("roadgrip", "numpy", "numba")
_CPU_INFO = Path("/proc/cpuinfo")


def processor_model() -> str:
    """Return the processor's name; drives are the same to the last bit on one model, and to 1e-9 on others."""
    if _CPU_INFO.exists():
        for line in _CPU_INFO.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def origin_of_drives(command: str) -> dict[str, str]:
    """Return what a data set of drives says of how and with what it was driven.

    Args:
        command: That drives it again.
    """
    return {
        "command": command,
        "processor": processor_model(),
        "python": platform.python_version(),
        **{f"version.{tool}": version(tool) for tool in _DRIVING_TOOLS},
    }

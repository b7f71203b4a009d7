"""What the parts of a unit take of its memory before the first passage.

python -m bench.appliance.memory_bill < MODULES

Imports the named modules, which stand in the order in which a daemon has imported them, so that each answers for itself
alone; then loads the packaged bundle. Prints the megabytes by top-level package as JSON.
"""

from __future__ import annotations

import collections
import contextlib
import importlib
import json
import os
import sys
from importlib.resources import files
from pathlib import Path

PYTHON, MODELS = "Python itself", "the packaged models"


def _resident_mb() -> float:
    pages_count = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages_count * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Weigh what the standard input names."""
    bill: collections.defaultdict[str, float] = collections.defaultdict(float, {PYTHON: _resident_mb()})
    for name in sys.stdin.read().split():
        before_mb = _resident_mb()
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
        bill[name.partition(".")[0]] += _resident_mb() - before_mb
    before_mb = _resident_mb()
    from rsu_app.adapters.inference.onnx_model import load_bundle

    _kept = load_bundle(Path(str(files("rsu_app") / "default_bundle")))
    bill[MODELS] += _resident_mb() - before_mb
    print(json.dumps(dict(sorted(bill.items(), key=lambda entry: -entry[1]))))


if __name__ == "__main__":
    main()

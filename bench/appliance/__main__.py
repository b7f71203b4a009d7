"""Measure the road side unit: speed, latency, overload, memory, start, size, floors, and others with the same model.

python -m bench.appliance                     everything, some ten minutes (`make appliance-bench`)
python -m bench.appliance udp http            some parts; the others stay in the results as they were
python -m bench.appliance --quick             a look in two minutes; written to build/bench-quick
python -m bench.appliance --page              only the page, from the figures that are there

Writes docs/results/bench.json, bench.md and pictures. Needs Linux, two cores with nothing else to do, and for the parts
`peers` and `install` a package index.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from bench.appliance import beside_peers, floors, load, size
from bench.appliance.conditions import conditions
from bench.appliance.page import write_page
from bench.appliance.processes import loading_core
from bench.appliance.targets import TARGETS, headline
from bench.measurement import keep_figures

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "docs" / "results"
QUICK_RESULTS = ROOT / "build" / "bench-quick"
SCRATCH = ROOT / "build"
"""Databases under load lie here and not in /tmp, which on many machines is memory."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How much each part measures.

    Attributes:
        loaded: Passages and reads.
        compared: The unit beside its peers.
        bare: What parts cost by themselves.
        needed: Memory, starts, idling.
    """

    loaded: load.Effort
    compared: beside_peers.Effort
    bare: floors.Effort
    needed: size.Effort


FULL = Effort(load.Effort(), beside_peers.Effort(), floors.Effort(), size.Effort())
QUICK = Effort(
    load.Effort(warm_count=400, measured_s=2.0, paced_s=2.0, overload_s=1.0, after_s=3.0),
    beside_peers.Effort(turn_s=0.3, turns_count=2),
    floors.Effort(
        echoes_count=20_000,
        requests_count=3_000,
        commits_count=40,
        model_s=0.2,
        turn_count=1_000,
        turns_count=3,
        paced_turns_count=2,
        paced_s=1.0,
    ),
    size.Effort(passages_count=4_000, blocks_count=4, idle_s=5.0, starts_count=1),
)
Measure = Callable[[Path, Effort, np.random.Generator], dict[str, Any]]


PARTS: dict[str, tuple[str, Measure]] = {
    "udp": ("passages over UDP, latency, overload", lambda f, e, rng: load.over_udp(f, e.loaded, rng=rng)),
    "signed": ("signed passages over UDP", lambda f, e, rng: load.over_udp_signed(f, e.loaded, rng=rng)),
    "http": ("passages and reads over HTTP", lambda f, e, rng: load.over_http(f, e.loaded, rng=rng)),
    "floors": ("what the parts cost by themselves", lambda f, e, rng: floors.floors(f, e.bare, rng=rng)),
    "bare": ("beside the barest server, in turns", lambda f, e, rng: floors.beside_bare(f, e.bare, rng=rng)),
    "peers": ("others that serve the same model", lambda f, e, rng: beside_peers.beside_peers(f, e.compared, rng=rng)),
    "window": ("a full window: cost, memory, idling", lambda f, e, rng: size.window_and_memory(f, e.needed, rng=rng)),
    "start": ("start to ready", lambda f, e, _: size.starts(f, e.needed)),
    "install": ("installed size", lambda f, _, __: size.install(f)),
}


def measure(name: str, effort: Effort, *, rng: np.random.Generator) -> dict[str, Any]:
    """Return the figures of a part and the conditions they were measured under.

    Args:
        name: One of `PARTS`.
        effort: How much is measured.
        rng: Draws passages; no unit has seen them before.
    """
    SCRATCH.mkdir(exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f"bench-{name}-", dir=SCRATCH))
    try:
        here, began_s = conditions(folder), time.perf_counter()
        figures = PARTS[name][1](folder, effort, rng)
        return {**figures, "conditions": {**here, "took_s": round(time.perf_counter() - began_s, 1)}}
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def results_with(path: Path, part: str, figures: dict[str, Any], *, run_id: str) -> dict[str, Any]:
    """Return the results so far with the figures of a part, new or in place of older ones.

    Args:
        path: Where they are kept; missing before the first part.
        part: Its name.
        figures: What it measured.
        run_id: Which run this was; figures of one run may be compared.
    """
    before = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    parts = {**before.get("parts", {}), part: {**figures, "run": run_id}}
    return {
        **headline(parts),
        "targets": {target.key: target.limit for target in TARGETS},
        "conditions": figures["conditions"],
        "runs": sorted({known["run"] for known in parts.values()}),
        "parts": {name: parts[name] for name in PARTS if name in parts},
    }


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").partition("\n")[0],
        epilog="parts: " + "; ".join(f"{name}: {what}" for name, (what, _) in PARTS.items()),
    )
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], metavar="PART", help="what to measure; all if none")
    parser.add_argument("--quick", action="store_true", help=f"short measurements, into {QUICK_RESULTS.name}")
    parser.add_argument("--page", action="store_true", help="only write the page again")
    parser.add_argument("--out", type=Path, help="folder for figures, page and pictures")
    parser.add_argument("--json", action="store_true", help="print the figures that targets are held against as JSON")
    return parser


def main() -> None:
    """Measure, and write down each part as soon as it is measured."""
    arguments = _parser().parse_args()
    out = arguments.out or (QUICK_RESULTS if arguments.quick else RESULTS)
    out.mkdir(parents=True, exist_ok=True)
    effort, path, console = QUICK if arguments.quick else FULL, out / "bench.json", Console(stderr=True)
    os.sched_setaffinity(0, loading_core())
    rng, run_id = np.random.default_rng(), time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    names = [] if arguments.page else arguments.parts or list(PARTS)
    for number, name in enumerate(names):
        what = f"[{number + 1}/{len(names)}] {name}: {PARTS[name][0]}"
        with console.status(what):
            began_s = time.perf_counter()
            keep_figures(path, results_with(path, name, measure(name, effort, rng=rng), run_id=run_id))
        console.print(f"{what}, {time.perf_counter() - began_s:.0f} s")
    if not path.exists():
        sys.exit(f"{path} does not exist: measure something first")
    results = json.loads(path.read_text(encoding="utf-8"))
    table = write_page(results, out)
    told = {name: results[name] for name in headline(results["parts"])}
    print(json.dumps(told, indent=1) if arguments.json else table)


if __name__ == "__main__":
    main()

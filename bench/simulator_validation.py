"""Remake the validation of the simulator: pictures, figures, and the tables of its page.

python -m bench.simulator_validation               everything, some minutes (`make simulator-validation`)
python -m bench.simulator_validation tyre limits   some chapters only; the figures of the others stay

Writes docs/results/simulator/*.svg and validation.json, and the tables in docs/simulator-validation.md between their
marks. Everything is drawn from fixed seeds: the same code gives the same figures.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench.validation import body, limits, oracle, roughness, time_step, tyre, whole_drive
from bench.validation.tables import page_with_tables
from training.marked_tables import in_four_digits
from vehicle_client.simulator.run import compiled_cache_key, warm_up

ROOT = Path(__file__).resolve().parents[1]
RESULTS_FOLDER = ROOT / "docs" / "results" / "simulator"
PAGE = ROOT / "docs" / "simulator-validation.md"
CHAPTERS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "tyre": tyre.draw,
    "body": body.draw,
    "limits": limits.draw,
    "time_step": time_step.draw,
    "roughness": roughness.draw,
    "oracle": lambda folder: oracle.draw(folder, said=lambda what: print(f"    {what}", flush=True)),
    "whole_drive": whole_drive.draw,
}


def main() -> None:
    """Remake what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("chapters", nargs="*", help=f"of {', '.join(CHAPTERS)}; all if none")
    asked = parser.parse_args().chapters or list(CHAPTERS)
    unknown = sorted(set(asked) - set(CHAPTERS))
    if unknown:
        parser.error(f"no chapter is called {', '.join(unknown)}")
    RESULTS_FOLDER.mkdir(parents=True, exist_ok=True)
    path = RESULTS_FOLDER / "validation.json"
    figures: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    print("compiling, if need be", flush=True)
    warm_up()
    started_s = time.monotonic()
    for k, chapter in enumerate(asked):
        print(f"[{k + 1}/{len(asked)}] {chapter}", flush=True)
        begun_s = time.monotonic()
        # Each chapter says which simulator it saw: one can be remade without the others.
        figures[chapter] = in_four_digits(CHAPTERS[chapter](RESULTS_FOLDER)) | {"simulator": compiled_cache_key()}
        print(f"    {time.monotonic() - begun_s:.0f} s", flush=True)
    ordered = {chapter: figures[chapter] for chapter in CHAPTERS if chapter in figures}
    path.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
    if len(ordered) == len(CHAPTERS):
        PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8"), ordered), encoding="utf-8")
    print(f"done in {time.monotonic() - started_s:.0f} s: {RESULTS_FOLDER.relative_to(ROOT)}, {PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()

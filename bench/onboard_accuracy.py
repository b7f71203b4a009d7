"""Remake the accuracy study of the onboard client: pictures, figures, and the tables of its page.

python -m bench.onboard_accuracy                      everything, some minutes (`make onboard-accuracy`)
python -m bench.onboard_accuracy sideslip positions   some chapters only; the figures of the others stay

Writes docs/results/onboard/*.svg and accuracy.json, and the tables in docs/onboard-accuracy.md, docs/vehicle.md and
docs/sensors.md between their marks.
Everything is drawn from fixed seeds: the same code gives the same figures, on any number of processes. A chapter
that needs recordings which are not here says so and is kept as it was.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import traceback
from concurrent.futures import as_completed
from pathlib import Path
from typing import Any

from bench.onboard.chapters import CHAPTERS, InputMissingError, drawn, table_maker
from training.code_identity import code_digest
from training.marked_tables import in_four_digits, with_tables
from training.workers import executor
from vehicle_client.simulator.run import compiled_cache_key, warm_up

ROOT = Path(__file__).resolve().parents[1]
RESULTS_FOLDER = ROOT / "docs" / "results" / "onboard"
FIGURES_PATH = RESULTS_FOLDER / "accuracy.json"
PAGE = ROOT / "docs" / "onboard-accuracy.md"
PAGES = (PAGE, ROOT / "docs" / "vehicle.md", ROOT / "docs" / "sensors.md")
"""Where tables of the study stand."""


def main() -> None:
    """Remake what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("chapters", nargs="*", help=f"of {', '.join(CHAPTERS)}; all if none")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="chapters made at the same time")
    arguments = parser.parse_args()
    asked: list[str] = arguments.chapters or list(CHAPTERS)
    unknown = sorted(set(asked) - set(CHAPTERS))
    if unknown:
        parser.error(f"no chapter is called {', '.join(unknown)}")
    RESULTS_FOLDER.mkdir(parents=True, exist_ok=True)
    print("compiling, if need be", flush=True)
    warm_up()
    started_s = time.monotonic()
    failed = []
    with executor(min(arguments.workers, len(asked))) as pool:
        waiting = {pool.submit(made, chapter): chapter for chapter in asked}
        for done_count, future in enumerate(as_completed(waiting), start=1):
            chapter = waiting[future]
            figures, text = future.result()
            print(f"[{done_count}/{len(asked)}] {chapter}: {text}", flush=True)
            if figures is not None:
                keep(chapter, figures)
            elif not text.startswith(_KEPT):
                failed.append(chapter)
    for page in PAGES:
        page.write_text(page_with_tables(page.read_text(encoding="utf-8"), kept_figures()), encoding="utf-8")
    print(f"done in {time.monotonic() - started_s:.0f} s: {RESULTS_FOLDER.relative_to(ROOT)}, {PAGE.relative_to(ROOT)}")
    if failed:
        parser.exit(1, f"not made: {', '.join(failed)}\n")


_KEPT = "kept as it was"


def made(chapter: str) -> tuple[dict[str, Any] | None, str]:
    """Return the figures of a chapter and a line about it; no figures where it could not be made.

    One chapter's failure must not take the others' results with it: its traceback is the line.
    """
    begun_s = time.monotonic()
    print(f"    {chapter} ...", flush=True)
    # Each chapter says which code it saw, as it began: one can be remade without the others.
    code = {"onboard_code": code_digest("vehicle_client.pipeline"), "simulator": compiled_cache_key()}
    try:
        figures = drawn(chapter, RESULTS_FOLDER)
    except InputMissingError as missing:
        return None, f"{_KEPT}: {missing}"
    except Exception:  # noqa: BLE001 - said and counted by the caller
        return None, f"failed\n{traceback.format_exc()}"
    return in_four_digits(figures) | code, f"{time.monotonic() - begun_s:.0f} s"


def kept_figures() -> dict[str, Any]:
    """Return what is kept of all chapters."""
    found: dict[str, Any] = json.loads(FIGURES_PATH.read_text(encoding="utf-8")) if FIGURES_PATH.is_file() else {}
    return found


def keep(chapter: str, figures: dict[str, Any]) -> None:
    """Put a chapter's figures beside those of the others, in the order of the page."""
    whole = kept_figures() | {chapter: figures}
    ordered = {name: whole[name] for name in CHAPTERS if name in whole}
    FIGURES_PATH.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")


def page_with_tables(page: str, figures: dict[str, Any]) -> str:
    """Return a page with the tables of all chapters that have figures; other tables stay.

    Args:
        page: One of `PAGES`.
        figures: What `accuracy.json` holds.

    Raises:
        KeyError: A mark names no table of its chapter.
    """

    def table_named(name: str) -> str | None:
        chapter, _, table = name.partition(".")
        return table_maker(chapter, table)(figures[chapter]) if chapter in figures else None

    return with_tables(page, table_named)


if __name__ == "__main__":
    main()

"""Drives cars with a life: each group of cars becomes one file, and all of them one table.

As with designs, what is there already is not driven again, a killed run goes on where it was, files of other code are
driven anew, and the result does not depend on the number of workers.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path

from training.car_lives import lived
from training.cars import Lives
from training.code_identity import code_digest
from training.dataset import RUNS_FILE_NAME, DatasetError, Runs, joined, read_description, read_runs, write_runs
from training.workers import executor

LIVING_MODULES = ("training.car_lives",)
"""Modules from which all that shapes a run is reached by imports."""
GROUPS_FOLDER_NAME = "groups"


def lives_description(lives: Lives) -> dict[str, str]:
    """Return what the whole table of some lives says about its origin."""
    return {**_group_description(lives), "groups_count": str(lives.groups_count)}


def live(
    lives: Lives,
    folder: Path,
    *,
    workers_count: int | None = None,
    provenance: Mapping[str, str] | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> Runs:
    """Drive what is not driven yet of some lives, or was driven by other code, and return what the cars tell.

    Args:
        lives: Which cars live.
        folder: Where the files go; made if missing.
        workers_count: Processes; as many as there are processors if None.
        provenance: What else the table shall say about its origin.
        on_progress: Told after every group how many are done, of how many.
    """
    whole = folder / RUNS_FILE_NAME
    if is_lived(lives, whole):
        return read_runs(whole)
    whole.unlink(missing_ok=True)
    (folder / GROUPS_FOLDER_NAME).mkdir(parents=True, exist_ok=True)
    paths = [
        folder / GROUPS_FOLDER_NAME / f"{lives.identity}-{group:04d}.parquet" for group in range(lives.groups_count)
    ]
    description = _group_description(lives)
    missing = [group for group, path in enumerate(paths) if not description.items() <= _origin(path).items()]
    left, running = deque(missing), set[Future[None]]()
    workers = max(1, min(workers_count or os.cpu_count() or 1, len(missing)))
    with executor(workers) as pool:
        while left or running:
            while left and len(running) < workers:
                group = left.popleft()
                running.add(pool.submit(_live_and_write, lives, group, paths[group]))
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()
            if on_progress is not None:
                on_progress(len(paths) - len(left) - len(running), len(paths))
    runs = joined([read_runs(path) for path in paths])
    write_runs(runs, whole, description={**(provenance or {}), **lives_description(lives)})
    return runs


def is_lived(lives: Lives, whole: Path) -> bool:
    """Return whether a table holds some lives, driven by the present code."""
    return lives_description(lives).items() <= _origin(whole).items()


def _group_description(lives: Lives) -> dict[str, str]:
    return {
        "lives": lives.name,
        "lives_identity": lives.identity,
        "seed": str(lives.seed),
        "sensor_grade": lives.grade.value,
        "code_digest": code_digest(*LIVING_MODULES),
    }


def _origin(path: Path) -> dict[str, str]:
    """Return what a file says of its origin; nothing if it is not there, or cut short by a power failure."""
    try:
        return read_description(path)
    except DatasetError:
        return {}


def _live_and_write(lives: Lives, group: int, path: Path) -> None:
    write_runs(lived(lives, group), path, description=_group_description(lives))

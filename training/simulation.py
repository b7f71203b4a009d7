"""Drives a design: shards of simulated and summarised passages become one table.

Each shard becomes one file, whole or not at all; what is there already is not driven again, so a killed run goes on
where it was. A shard says which code drove it: after an edit of simulator, onboard client or design it is driven anew.
The result does not depend on the number of workers. The data set appears in the folder when the design is finished.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path

from roadgrip.section_file import section_to_json
from training.code_identity import code_digest
from training.dataset import (
    COMPLETED,
    RUNS_FILE_NAME,
    SHARDS_FOLDER_NAME,
    DatasetError,
    Runs,
    read_description,
    read_outcomes,
    read_runs,
    write_runs,
)
from training.drive_files import DriveWriter
from training.garage import GROUP_DRIVES_COUNT, memories, remembering_groups_count, school
from training.passage_rows import drive_shard, table_of
from training.scenarios import Design
from training.schedule import Counts, Shard, next_round, streams_of
from training.workers import executor

DRIVING_MODULES = ("training.passage_rows", "training.schedule", "training.everyday")
"""Modules from which all that shapes a run is reached by imports."""
DRIVES_FOLDER_NAME = "drives"
SECTIONS_FOLDER_NAME = "sections"
"""The maps of the roads, beside the full histories: `roadgrip-train evaluate` finds them there."""
GARAGE_FOLDER_NAME = "garage"
"""What cars have learned of themselves before they drove."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a design is driven.

    Attributes:
        attempts_count: Runs on disk.
        driven_now_count: Runs among them that this call has driven.
        done_count: What is done of `wanted_count`; a cell that came to its limit counts as done.
        wanted_count: Runs that are asked for, over all cells, and what cars drive before to learn what they are like.
    """

    attempts_count: int
    driven_now_count: int
    done_count: int
    wanted_count: int


def drive_design(
    design: Design,
    folder: Path,
    *,
    workers_count: int | None = None,
    with_drives: bool = False,
    garage_folder: Path | None = None,
    provenance: Mapping[str, str] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Runs:
    """Drive what is not driven yet of a design, or was driven by other code, and return all its runs.

    The rows come by scenario, base friction and attempt. A cell with a quota ends with the attempt that gives the last
    wanted run, or at its limit of attempts.

    Args:
        design: What to drive.
        folder: Where the files go; made if missing.
        workers_count: Processes; as many as there are processors if None.
        with_drives: Whether the full histories of all runs are kept too.
        garage_folder: Where the design's cars keep what they have learned; designs of one seed may share it. A folder
            in `folder` by default.
        provenance: What else the data set shall say about its origin.
        on_progress: Called after every shard.
    """
    started_s = time.monotonic()
    (folder / SHARDS_FOLDER_NAME).mkdir(parents=True, exist_ok=True)
    if with_drives:
        (folder / DRIVES_FOLDER_NAME).mkdir(exist_ok=True)
        _write_sections(design, folder / SECTIONS_FOLDER_NAME)
    whole, description = folder / RUNS_FILE_NAME, design_description(design)
    finished = description.items() <= _origin(whole).items()
    if not finished:
        whole.unlink(missing_ok=True)
    garage_folder = garage_folder or folder / GARAGE_FOLDER_NAME
    journey = _Journey(design, folder, with_drives=with_drives, garage_folder=garage_folder, on_progress=on_progress)
    journey.report()
    workers_count = max(1, min(workers_count or os.cpu_count() or 1, len(journey.waiting)))
    with executor(workers_count) as pool:
        journey.drive(pool, at_once_count=2 * workers_count if workers_count > 1 else 1)
    if finished and journey.driven_now_count == 0:
        return read_runs(whole)
    runs = table_of(design, [(shard, read_runs(journey.path_of(shard))) for shard in journey.shards])
    timing = {
        "wall_s": f"{time.monotonic() - started_s:.1f}",
        "workers_count": str(workers_count),
        "driven_now_count": str(journey.driven_now_count),
        "dataset_digest": runs.digest(),
    }
    write_runs(runs, whole, description={**(provenance or {}), **description, **timing})
    return runs


def design_description(design: Design) -> dict[str, str]:
    """Return what the files of a design say about their origin."""
    quotas = {scenario.quota for scenario in design.scenarios}
    quota = quotas.pop() if len(quotas) == 1 else None
    return {
        "design": design.name,
        "design_identity": design.identity,
        "seed": str(design.terms.seed),
        "sensor_grade": design.terms.sensor_grade.value,
        "driver_kind": design.terms.driver_kind.value,
        "kept_wanted_count": str((quota and quota.kept_count) or ""),
        "attempts_limit_count": str(quota.attempts_limit_count if quota else ""),
        "code_digest": code_digest(*DRIVING_MODULES),
    }


class _Journey:
    """What of a design is driven, and what is to be driven next."""

    def __init__(
        self,
        design: Design,
        folder: Path,
        *,
        with_drives: bool,
        garage_folder: Path,
        on_progress: Callable[[Progress], None] | None,
    ) -> None:
        self.shards: list[Shard] = []
        self.driven_now_count = 0
        self._design = design
        self._folder = folder
        self._with_drives = with_drives
        self._garage_folder = garage_folder
        self._schooled_count = 0
        self._on_progress = on_progress
        self._streams = streams_of(design)
        self._quotas = [cell.scenario.quota for cells in self._streams for cell in cells]
        self._counts = [Counts() for _ in self._quotas]
        self._stream_of_shard: dict[str, int] = {}
        self._open_count = [0] * len(self._streams)
        self.waiting = deque(shard for i in range(len(self._streams)) for shard in self._next_round(i))

    def drive(self, pool: Executor, *, at_once_count: int) -> None:
        """Drive all that is missing, round by round; cars that shall remember something learn it first."""
        school(self._design.terms, self._garage_folder, pool, on_group=self._count_group)
        description = design_description(self._design)
        running: dict[Future[tuple[str, ...]], Shard] = {}
        while self.waiting or running:
            while self.waiting and len(running) < at_once_count:
                shard = self.waiting.popleft()
                if self._is_driven(shard):
                    self._finish(shard, read_outcomes(self.path_of(shard)), driven_now=False)
                    continue
                drives_path = self._drives_path_of(shard) if self._with_drives else None
                work = pool.submit(
                    _drive_and_write, shard, self.path_of(shard), drives_path, self._garage_folder, description
                )
                running[work] = shard
            for work in wait(running, return_when=FIRST_COMPLETED).done:
                self._finish(running.pop(work), work.result(), driven_now=True)

    def report(self) -> None:
        """Tell how far it is."""
        if self._on_progress is None:
            return
        done = float(self._schooled_count * GROUP_DRIVES_COUNT)
        wanted = remembering_groups_count(self._design.terms) * GROUP_DRIVES_COUNT
        for quota, counts in zip(self._quotas, self._counts, strict=True):
            wanted_here = quota.kept_count or quota.attempts_limit_count
            tried_frac = counts.attempts_count / quota.attempts_limit_count
            kept_frac = 0.0 if quota.kept_count is None else counts.kept_count / quota.kept_count
            done += wanted_here * min(1.0, max(tried_frac, kept_frac))
            wanted += wanted_here
        attempts_count = sum(counts.attempts_count for counts in self._counts)
        self._on_progress(Progress(attempts_count, self.driven_now_count, round(done), wanted))

    def path_of(self, shard: Shard) -> Path:
        """Return the file of a shard."""
        return self._folder / SHARDS_FOLDER_NAME / f"{shard.name}.parquet"

    def _count_group(self) -> None:
        self._schooled_count += 1
        self.report()

    def _finish(self, shard: Shard, outcomes: tuple[str, ...], *, driven_now: bool) -> None:
        row = 0
        for block in shard.blocks:
            done = self._counts[block.cell_index]
            kept_count = outcomes[row : row + block.attempts_count].count(COMPLETED)
            self._counts[block.cell_index] = Counts(
                done.attempts_count + block.attempts_count, done.kept_count + kept_count
            )
            row += block.attempts_count
        self.shards.append(shard)
        self.driven_now_count += shard.attempts_count if driven_now else 0
        stream = self._stream_of_shard[shard.name]
        self._open_count[stream] -= 1
        if self._open_count[stream] == 0:
            # Next in the row: a stream with many rounds should not be the only one left at the end.
            self.waiting.extendleft(reversed(self._next_round(stream)))
        self.report()

    def _next_round(self, stream: int) -> tuple[Shard, ...]:
        cells = self._streams[stream]
        shards = next_round(self._design.terms, cells, [self._counts[cell.cell_index] for cell in cells])
        self._open_count[stream] = len(shards)
        self._stream_of_shard |= {shard.name: stream for shard in shards}
        return shards

    def _is_driven(self, shard: Shard) -> bool:
        """Return whether a shard is on disk, as the present code would drive it."""
        paths = [self.path_of(shard), *([self._drives_path_of(shard)] if self._with_drives else [])]
        digest = code_digest(*DRIVING_MODULES)
        return all(_origin(path).get("code_digest") == digest for path in paths)

    def _drives_path_of(self, shard: Shard) -> Path:
        return self._folder / DRIVES_FOLDER_NAME / f"{shard.name}.parquet"


def _write_sections(design: Design, folder: Path) -> None:
    """Write the roads of a design as section files, as the road side unit holds them."""
    folder.mkdir(exist_ok=True)
    for section in {scenario.section for scenario in design.scenarios}:
        (folder / f"{section.section_id}.json").write_text(section_to_json(section), encoding="utf-8")


def _origin(path: Path) -> dict[str, str]:
    """Return what a file says of its origin; nothing if it is not there, or cut short by a power failure."""
    try:
        return read_description(path)
    except DatasetError:
        return {}


def _drive_and_write(
    shard: Shard, path: Path, drives_path: Path | None, garage_folder: Path, description: dict[str, str]
) -> tuple[str, ...]:
    learned = memories(shard.terms, garage_folder)
    if drives_path is None:
        runs = drive_shard(shard, memories=learned)
    else:
        with DriveWriter(drives_path, description=description) as writer:
            runs = drive_shard(shard, memories=learned, on_batch=writer.write)
    write_runs(runs, path, description=description)
    return runs.outcome

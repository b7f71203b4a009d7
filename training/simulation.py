"""Drives a design: shards of simulated passages, through the vehicle's own pipeline, into Parquet.

Each shard becomes one file, whole or not at all; what is there already is not driven again, so a killed run goes on
where it was. A shard says which code drove it: after an edit of simulator, onboard client or design it is driven anew.
The result does not depend on the number of workers.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roadgrip.features import FEATURES, KINEMATIC_FEATURES, road_features
from roadgrip.records import Rejected
from roadgrip.units import FloatArray
from training.code_identity import code_digest
from training.dataset import COMPLETED, LABEL_COLUMNS, Runs, joined, read_description, read_runs, write_runs
from training.scenarios import Design, Shard, runs_of, shards_of
from vehicle_client.pipeline import summarise_passage
from vehicle_client.simulator.run import Drive, simulate_passage

DRIVING_MODULES = (
    "training.simulation",
    "training.scenarios",
    "vehicle_client.pipeline",
    "vehicle_client.simulator.run",
)
"""Modules from which all that shapes a run is reached by imports."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a design is driven.

    Attributes:
        runs_done_count: Runs whose shard is on disk.
        runs_count: All runs.
    """

    runs_done_count: int
    runs_count: int


def drive_shard(shard: Shard) -> Runs:
    """Return the runs of a shard, driven and summarised; failed ones keep their outcome and have NaN features."""
    road = road_features(shard.section)
    rows, keys, outcomes = [], [], []
    labels: dict[str, list[float]] = {name: [] for name in LABEL_COLUMNS}
    for run in runs_of(shard):
        drive = simulate_passage(shard.section, run.plan)
        values, outcome = _summarise(drive, shard)
        rows.append(np.concatenate([values, road]))
        keys.append(run.key)
        outcomes.append(outcome)
        labels["label_mu"].append(drive.label_mu)
        labels["base_friction_mu"].append(run.plan.base_friction_mu)
        labels["wear_ratio"].append(run.plan.wear_factor)
        labels["esc_active_frac"].append(drive.esc_active_frac)
        labels["peak_utilisation_ratio"].append(drive.peak_utilisation_ratio)
    return Runs(
        features=np.array(rows).reshape(-1, len(FEATURES)),
        labels={name: np.array(values) for name, values in labels.items()},
        section_id=(shard.section.section_id,) * len(keys),
        outcome=tuple(outcomes),
        run_key=tuple(keys),
    )


def drive_design(
    design: Design,
    folder: Path,
    *,
    workers_count: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Runs:
    """Drive what is not driven yet of a design, or was driven by other code, and return all its runs.

    Args:
        design: What to drive.
        folder: Where the shards go; made if missing.
        workers_count: Processes; as many as there are processors if None.
        on_progress: Called after every shard.
    """
    folder.mkdir(parents=True, exist_ok=True)
    shards = shards_of(design)
    missing = [shard for shard in shards if not _is_driven(_path_of(shard, folder))]
    done_count = design.runs_count - sum(shard.runs_count for shard in missing)

    def report() -> None:
        if on_progress is not None:
            on_progress(Progress(done_count, design.runs_count))

    report()
    if missing:
        # Spawned, not forked: the compiled drives and the linear algebra keep threads that do not survive a fork.
        context = multiprocessing.get_context("spawn")
        workers_count = min(workers_count or os.cpu_count() or 1, len(missing))
        with ProcessPoolExecutor(workers_count, mp_context=context) as pool:
            futures = {pool.submit(_drive_and_write, shard, folder): shard for shard in missing}
            for future in as_completed(futures):
                future.result()
                done_count += futures[future].runs_count
                report()
    return joined([read_runs(_path_of(shard, folder)) for shard in shards])


def _drive_and_write(shard: Shard, folder: Path) -> None:
    design = shard.design
    write_runs(
        drive_shard(shard),
        _path_of(shard, folder),
        description={
            "design": design.name,
            "seed": str(design.seed),
            "sensor_grade": design.sensor_grade.value,
            "driver_kind": design.driver_kind.value,
            "section_id": shard.section.section_id,
            "map_version": shard.section.version,
            "code_digest": code_digest(*DRIVING_MODULES),
        },
    )


def _is_driven(path: Path) -> bool:
    """Return whether a shard is on disk, as the present code would drive it."""
    return path.exists() and read_description(path).get("code_digest") == code_digest(*DRIVING_MODULES)


def _path_of(shard: Shard, folder: Path) -> Path:
    return folder / f"{shard.name}.parquet"


def _summarise(drive: Drive, shard: Shard) -> tuple[FloatArray, str]:
    nothing = np.full(len(KINEMATIC_FEATURES), np.nan)
    if not drive.completed:
        return nothing, drive.outcome.value
    result = summarise_passage(drive.trace, shard.section)
    if isinstance(result, Rejected):
        return nothing, f"rejected_{result.reason.value}"
    return np.array(result.summary.values), COMPLETED

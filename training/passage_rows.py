"""What becomes of runs: each is driven, goes through the vehicle's own pipeline, and leaves one row of the table."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby, islice, pairwise
from math import isfinite
from types import MappingProxyType

import numpy as np

from roadgrip.features import NEWEST_TABLE, road_features
from roadgrip.records import Rejected
from roadgrip.section import RoadSection
from roadgrip.units import SAMPLE_S, BoolArray, FloatArray
from training.dataset import COMPLETED, LABEL_COLUMNS, Runs, joined
from training.scenarios import Design, Run, Scenario, surveyed_map
from training.schedule import Shard, inside_quota, runs_of
from vehicle_client.estimation.grip.memory import CarMemory
from vehicle_client.pipeline import summarise_passage
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.plan import DECLARED_NOISE
from vehicle_client.simulator.run import each_passage

BATCH_RUNS_COUNT = 32
"""Drives that are summarised together; their full histories are in memory at once, about 2 MB each."""

NO_MEMORIES: Mapping[int, CarMemory] = MappingProxyType({})
WatchDrives = Callable[[Sequence[Run], Sequence[Drive]], None]


def drive_shard(
    shard: Shard, *, memories: Mapping[int, CarMemory] = NO_MEMORIES, on_batch: WatchDrives | None = None
) -> Runs:
    """Return the runs of a shard, driven and summarised; failed ones keep their outcome and have NaN features.

    Args:
        shard: What to drive.
        memories: What cars have learned of themselves, by `PassagePlan.sensor_seed`.
        on_batch: Called with the full histories, some at a time.
    """
    parts = []
    for _, group in groupby(shard.blocks, key=lambda block: block.scenario.name):
        blocks = list(group)
        scenario = blocks[0].scenario
        road_map = surveyed_map(shard.terms, scenario.section)
        runs = [run for block in blocks for run in runs_of(block, shard.terms)]
        # One stream of drives for all of them: the simulator drives many side by side, and best without a break.
        stream = each_passage(scenario.section, (run.plan for run in runs))
        for first in range(0, len(runs), BATCH_RUNS_COUNT):
            batch = runs[first : first + BATCH_RUNS_COUNT]
            drives = list(islice(stream, len(batch)))
            if on_batch is not None:
                on_batch(batch, drives)
            parts.append(rows_of(scenario, batch, drives, road_map=road_map, memories=memories))
    return joined(parts)


def table_of(design: Design, driven: Sequence[tuple[Shard, Runs]]) -> Runs:
    """Return the table of a design: by scenario, base friction and attempt, and none beyond a cell's last wanted run.

    Args:
        design: The design.
        driven: All its shards with their rows, in any order.
    """
    runs = joined([part for _, part in driven])
    cell = np.concatenate([np.full(b.attempts_count, b.cell_index) for shard, _ in driven for b in shard.blocks])
    order = np.lexsort((runs.labels["attempt_number"], cell))
    completed: BoolArray = np.array([outcome == COMPLETED for outcome in runs.outcome], dtype=np.bool_)[order]
    frictions_count = len(design.base_frictions_mu)
    ends = np.searchsorted(cell[order], np.arange(len(design.scenarios) * frictions_count + 1))
    inside = [
        inside_quota(completed[first:last], design.scenarios[i // frictions_count].quota.kept_count)
        for i, (first, last) in enumerate(pairwise(ends.tolist()))
    ]
    return runs.rows(order[np.concatenate(inside)])


def rows_of(
    scenario: Scenario,
    runs: Sequence[Run],
    drives: Sequence[Drive],
    *,
    road_map: RoadSection,
    memories: Mapping[int, CarMemory] = NO_MEMORIES,
) -> Runs:
    """Return the rows of some driven runs of a scenario.

    The road's features are those of the designed section: they come from the unit's map at run time, the same for
    every vehicle, and a model for a road must know it under the figures that its unit holds.

    Args:
        scenario: What was driven.
        runs: The runs. (n,)
        drives: What became of them. (n,)
        road_map: What the vehicles know of the road.
        memories: What cars have learned of themselves, by `PassagePlan.sensor_seed`; others remember nothing.
    """
    road = road_features(scenario.section)
    rows, outcomes = [], []
    for run, drive in zip(runs, drives, strict=True):
        memory = None if run.plan.sensor_seed is None else memories.get(run.plan.sensor_seed)
        values, outcome = _summarised(run, drive, road_map, memory)
        rows.append(np.concatenate([values, road]))
        outcomes.append(outcome)
    labels = [labels_of(scenario.section, run, drive) for run, drive in zip(runs, drives, strict=True)]
    return Runs(
        features=np.array(rows).reshape(-1, len(NEWEST_TABLE)),
        labels={name: np.array([one[name] for one in labels]) for name in LABEL_COLUMNS},
        scenario=(scenario.name,) * len(rows),
        section_id=(scenario.section.section_id,) * len(rows),
        outcome=tuple(outcomes),
        run_key=tuple(run.key for run in runs),
    )


def labels_of(section: RoadSection, run: Run, drive: Drive) -> dict[str, float]:
    """Return what is known of a drive beyond what its vehicle says: the columns `LABEL_COLUMNS`."""
    plan, station = run.plan, drive.truth.station_m
    inside = (station >= 0.0) & (station <= section.length_m)
    duration_s = SAMPLE_S * float(np.count_nonzero(inside))
    target_mps = section.speed_limit_mps if plan.target_speed_mps is None else plan.target_speed_mps
    guess_mu = plan.driver.friction_guess_mu
    return {
        "label_mu": drive.label_mu,
        "lowest_mu": drive.lowest_mu,
        "base_friction_mu": plan.base_friction_mu,
        "wear_ratio": plan.wear_factor,
        "attempt_number": float(run.number),
        "rated_speed_mps": section.speed_limit_mps,
        "target_speed_mps": target_mps,
        "mean_speed_mps": float(drive.truth.velocity_x_mps[inside].mean()) if inside.any() else np.nan,
        "duration_s": duration_s,
        "friction_guess_mu": guess_mu if isfinite(guess_mu) else np.nan,
        "abs_active_frac": drive.abs_active_frac,
        "tcs_active_frac": drive.tcs_active_frac,
        "esc_active_frac": drive.esc_active_frac,
        "peak_utilisation_ratio": drive.peak_utilisation_ratio,
        "peak_sideslip_rad": drive.peak_sideslip_rad,
    }


def _summarised(run: Run, drive: Drive, road_map: RoadSection, memory: CarMemory | None) -> tuple[FloatArray, str]:
    nothing = np.full(len(NEWEST_TABLE.kinematic), np.nan)
    if not drive.completed:
        return nothing, drive.outcome.value
    result = summarise_passage(
        drive.trace,
        road_map,
        vehicle=run.geometry,
        handling=run.handling,
        noise=DECLARED_NOISE[run.plan.sensor_grade],
        memory=memory,
    )
    if isinstance(result, Rejected):
        return nothing, f"rejected_{result.reason.value}"
    return np.array(result.summary.values), COMPLETED

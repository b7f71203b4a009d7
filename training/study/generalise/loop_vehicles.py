"""Vehicles of the closed loop: simulated, and summarised by the onboard client as those of any design are.

Their cars remember what automotive sensors get wrong, as in the data that the models of the loop learn from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from roadgrip.section import RoadSection
from training.cars import Lives, cars_of
from training.chance import chance
from training.closed_loop import Drive, Passed, Traveller, draw_travellers
from training.dataset import COMPLETED
from training.everyday import schooled
from training.passage_rows import NO_MEMORIES, rows_of
from training.scenarios import WITH_GNSS_FRAC, Run, Scenario, Terms, attempted, surveyed_map
from training.study.chapter import Arrays, Workbench
from vehicle_client.estimation.grip.memory import CarMemory
from vehicle_client.estimation.handling import XC90_HANDLING
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.simulator.drive import DriveOutcome
from vehicle_client.simulator.plan import PassagePlan, SensorGrade, draw_plan
from vehicle_client.simulator.run import each_passage

DESIGN_NAME = "closed-loop"
GROUPS_COUNT, QUICK_GROUPS_COUNT = 6, 1
"""Of eleven cars each, which come again and again, as on any road."""


def schooled_cars(bench: Workbench, grade: SensorGrade) -> dict[int, CarMemory]:
    """Return what some cars have learned of themselves, by the seeds of what their sensors get wrong.

    Exact sensors leave nothing to learn: there are no such cars then.
    """
    if grade is SensorGrade.IDEAL:
        return {}
    groups_count = QUICK_GROUPS_COUNT if bench.quick else GROUPS_COUNT
    cars = Lives(DESIGN_NAME, bench.seed, grade, groups_count, varied_vehicles=False)
    seeds = [car.sensor_seed for group in range(groups_count) for car in cars_of(cars, group)]

    def work() -> Arrays:
        learned: list[CarMemory] = []
        for group in range(groups_count):
            bench.report(f"cars of the closed loop, {grade}", group, groups_count)
            learned += schooled(cars, group)
        return {
            "mean": np.array([memory.mean for memory in learned]),
            "covariance": np.array([memory.covariance for memory in learned]),
            "first_std": np.array([memory.first_std for memory in learned]),
            "passages_count": np.array([memory.passages_count for memory in learned], dtype=np.float64),
        }

    kept = bench.remembered(f"loop-cars-{grade}-{groups_count}-{bench.seed}", work)
    return {
        seed: CarMemory(
            mean=tuple(mean.tolist()),
            covariance=tuple(map(tuple, covariance.tolist())),
            first_std=tuple(first_std.tolist()),
            passages_count=round(count),
        )
        for seed, mean, covariance, first_std, count in zip(
            seeds, kept["mean"], kept["covariance"], kept["first_std"], kept["passages_count"].tolist(), strict=True
        )
    }


def travellers(
    section: RoadSection,
    *,
    phases_mu: Sequence[float],
    phase_s: float,
    vehicles_per_hour: float,
    terms: Terms,
    sensor_seeds: Sequence[int] = (),
) -> tuple[Traveller, ...]:
    """Return the vehicles that come to a road while its friction changes, the paper's drivers and tyres.

    Args:
        section: The road.
        phases_mu: Base friction of one phase after the other.
        phase_s: How long each lasts.
        vehicles_per_hour: How many there are.
        terms: Seed and sensors.
        sensor_seeds: Of the cars there are; without, every vehicle has sensors of its own.
    """

    def plan_at(rng: np.random.Generator, at_s: float) -> PassagePlan:
        plan = draw_plan(
            rng,
            section=section,
            base_friction_mu=phases_mu[min(int(at_s // phase_s), len(phases_mu) - 1)],
            grade=terms.sensor_grade,
            kind=terms.driver_kind,
            with_gnss=bool(rng.random() < WITH_GNSS_FRAC) and bool(section.anchors),
        )
        return replace(plan, sensor_seed=int(rng.choice(sensor_seeds))) if sensor_seeds else plan

    return draw_travellers(
        chance(terms.seed, f"{terms.design_name}|{section.section_id}"),
        until_s=phase_s * len(phases_mu),
        vehicles_per_hour=vehicles_per_hour,
        plan_at=plan_at,
    )


def simulated(section: RoadSection, terms: Terms, *, memories: Mapping[int, CarMemory] = NO_MEMORIES) -> Drive:
    """Return what drives plans over a road.

    Args:
        section: The road.
        terms: Seed and sensors; what vehicles know of the road follows from them.
        memories: What cars have learned of themselves, by `PassagePlan.sensor_seed`.
    """
    road_map = surveyed_map(terms, section)
    scenario = Scenario(DESIGN_NAME, section, attempted(0))

    def drive(plans: Sequence[PassagePlan]) -> Sequence[Passed]:
        runs = [Run(f"{DESIGN_NAME}/{i}", i, plan, XC90, XC90_HANDLING) for i, plan in enumerate(plans)]
        drives = list(each_passage(section, plans))
        rows = rows_of(scenario, runs, drives, road_map=road_map, memories=memories)
        return [
            Passed(
                row=rows.features[i] if rows.outcome[i] == COMPLETED else None,
                kept_to_road=drives[i].outcome is DriveOutcome.COMPLETED,
                duration_s=float(rows.labels["duration_s"][i]),
                label_mu=float(rows.labels["label_mu"][i]),
                mean_speed_mps=float(rows.labels["mean_speed_mps"][i]),
                peak_utilisation_ratio=float(rows.labels["peak_utilisation_ratio"][i]),
            )
            for i in range(len(plans))
        ]

    return drive


def terms_of(seed: int, grade: SensorGrade) -> Terms:
    """Return what all vehicles of the loop share."""
    return Terms(DESIGN_NAME, seed, grade)

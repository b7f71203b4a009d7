"""Simulated drives with their truth, cell by cell of the paper's design, as the accuracy study takes them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

from roadgrip.records import Rejected
from roadgrip.section import RoadSection
from training.designs import Size, named_design
from training.scenarios import Run, Scenario, Terms, run_of, surveyed_map
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.plan import SensorGrade
from vehicle_client.simulator.run import each_passage

SEED = 20260914
"""Of everything drawn in the study."""
ATTEMPTS_PER_DRIVE_COUNT = 20
"""A cell in which fewer drives stay on the road has no figures."""
GRADES = (SensorGrade.AUTOMOTIVE, SensorGrade.IDEAL)
SCENARIO_WORDS = {
    "long-turn": "long turn",
    "s-turn": "S-turn",
    "sharp-turn": "sharp turn",
    "s-turn-two-frictions": "S-turn, two frictions",
}


@dataclass(frozen=True, slots=True)
class Watched:
    """One drive and what the onboard client made of it.

    Attributes:
        run: What was asked for.
        drive: What was true.
        road_map: The map the vehicle had.
        result: The summary with all signals, or the refusal.
    """

    run: Run
    drive: Drive
    road_map: RoadSection
    result: Summarised | Rejected


def study_terms(grade: SensorGrade) -> Terms:
    """Return what all runs share; with either grade of sensors the same drives are watched."""
    return Terms(design_name="onboard-accuracy", seed=SEED, sensor_grade=grade)


def study_scenarios(*, varied_vehicles: bool = False) -> tuple[Scenario, ...]:
    """Return the paper's three roads and the S-turn of two frictions.

    Args:
        varied_vehicles: Whether every drive has a car of its own, from small car to van, instead of the paper's.
    """
    design = "varied-vehicles" if varied_vehicles else "paper"
    return named_design(design, study_terms(SensorGrade.IDEAL), Size(1)).scenarios


def completed_drives(
    scenario: Scenario, grade: SensorGrade, *, base_friction_mu: float, drives_count: int
) -> Iterator[Watched]:
    """Yield the first so many drives of a cell that stayed on the road to the end, summarised or refused.

    All have position fixes: what dead reckoning refuses are not just any drives, but those that slide the most.

    Args:
        scenario: Of the cell.
        grade: Which sensors watch.
        base_friction_mu: Of the cell.
        drives_count: How many; fewer come where the cell is too slippery for them.
    """
    terms = study_terms(grade)
    road_map = surveyed_map(terms, scenario.section)
    numbers = range(ATTEMPTS_PER_DRIVE_COUNT * drives_count)
    runs = [run_of(terms, scenario, base_friction_mu=base_friction_mu, number=number) for number in numbers]
    drives = each_passage(scenario.section, (replace(run.plan, with_gnss=True) for run in runs))
    came_through = ((run, drive) for run, drive in zip(runs, drives, strict=True) if drive.completed)
    for run, drive in islice(came_through, drives_count):
        yield Watched(run, drive, road_map, summarise_passage(drive.trace, road_map, vehicle=run.geometry))


def attempted_drives(
    scenario: Scenario, grade: SensorGrade, *, base_friction_mu: float, drives_count: int
) -> Iterator[tuple[Run, Drive, RoadSection]]:
    """Yield the first so many drives of a cell however they end, all with position fixes, and the vehicles' map.

    Args:
        scenario: Of the cell.
        grade: Which sensors watch.
        base_friction_mu: Of the cell.
        drives_count: How many.
    """
    terms = study_terms(grade)
    road_map = surveyed_map(terms, scenario.section)
    runs = [run_of(terms, scenario, base_friction_mu=base_friction_mu, number=number) for number in range(drives_count)]
    plans = (replace(run.plan, with_gnss=True) for run in runs)
    for run, drive in zip(runs, each_passage(scenario.section, plans), strict=True):
        yield run, drive, road_map

"""Everyday driving, from which cars learn what their sensors and tyres are like before anyone judges what they tell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from roadgrip.features import NEWEST_TABLE
from roadgrip.records import Rejected
from roadgrip.section import RoadSection
from roadgrip.units import FloatArray
from training.cars import Car, Lives, cars_of
from training.chance import chance
from training.random_roads import random_section
from training.scenarios import WITH_GNSS_FRAC, Terms, surveyed_map
from vehicle_client.estimation.grip.memory import AUTOMOTIVE_STDS, IDEAL_STDS, CarMemory, new_memory
from vehicle_client.estimation.grip.noise import GripNoise
from vehicle_client.estimation.handling import Handling
from vehicle_client.pipeline import Summarised, grip_features, memory_after, summarise_passage
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.plan import DECLARED_NOISE, PassagePlan, SensorGrade, draw_plan
from vehicle_client.simulator.run import each_passage

EVERYDAY_COUNT = 15
"""Passages before a car is judged."""
EVERYDAY_MU = (0.4, 0.9)
"""Base friction of everyday roads: wet to dry, evenly."""
MATCHED_STD_RATIO = 0.01
"""How well a maker who declares a car exactly says that he does."""
BEST_COLUMN = NEWEST_TABLE.index("grip_all_best_mu")
_SENSOR_STDS = {SensorGrade.AUTOMOTIVE: AUTOMOTIVE_STDS, SensorGrade.IDEAL: IDEAL_STDS}


def schooled(lives: Lives, group: int) -> tuple[CarMemory, ...]:
    """Return what the cars of a group have learned of themselves from everyday roads, each declared exactly.

    Args:
        lives: Which cars live.
        group: Which of their groups, from 0.
    """
    cars, noise = cars_of(lives, group), DECLARED_NOISE[lives.grade]
    memories = [memory_of_new_car(lives.grade, handling_std_ratio=MATCHED_STD_RATIO) for _ in cars]
    for number in range(EVERYDAY_COUNT):
        road_map, drives = everyday_drives(lives, cars, group, number)
        for place, (car, drive) in enumerate(zip(cars, drives, strict=True)):
            passage = summarised(car, drive, road_map, noise, memories[place])
            if not isinstance(passage, str):
                mu = passage.summary.values[BEST_COLUMN]
                memories[place] = taught(car.matched, car, passage, memories[place], noise, friction_mu=mu)
    return tuple(memories)


def memory_of_new_car(grade: SensorGrade, *, handling_std_ratio: float) -> CarMemory:
    """Return the memory of a car from the dealer.

    Args:
        grade: Its sensors.
        handling_std_ratio: How well masses, springs and tyres are declared.
    """
    return new_memory(handling_std_ratio=handling_std_ratio, sensor_stds=_SENSOR_STDS[grade])


def everyday_road(lives: Lives, group: int, number: int) -> RoadSection:
    """Return a road that the cars of a group learn on."""
    seed = [lives.seed, 1_000_000 + group * EVERYDAY_COUNT + number]
    return random_section(np.random.default_rng(seed), section_id=f"everyday-{lives.seed}-{group:04d}-{number:02d}")


def everyday_drives(lives: Lives, cars: Sequence[Car], group: int, number: int) -> tuple[RoadSection, Iterator[Drive]]:
    """Return the map of an everyday road and how the cars of a group drive it, one after the other."""
    section = everyday_road(lives, group, number)
    plans = []
    for car in cars:
        rng = chance(lives.seed, f"{car.name}|everyday {number}")
        mu = float(rng.uniform(*EVERYDAY_MU))
        plans.append(plan_of(rng, lives, car, section, base_friction_mu=mu))
    return surveyed_map(terms_of(lives), section), each_passage(section, plans)


def plan_of(
    rng: np.random.Generator, lives: Lives, car: Car, section: RoadSection, *, base_friction_mu: float
) -> PassagePlan:
    """Return a drive of a car, with its own tyres and the errors of its own sensors."""
    plan = draw_plan(
        rng,
        section=section,
        base_friction_mu=base_friction_mu,
        grade=lives.grade,
        with_gnss=bool(rng.random() < WITH_GNSS_FRAC),
        vehicle=car.vehicle,
    )
    return replace(plan, wear_factor=car.wear_factor, sensor_seed=car.sensor_seed)


def terms_of(lives: Lives) -> Terms:
    """Return what designs call what all runs share."""
    return Terms(lives.name, lives.seed, lives.grade)


def summarised(
    car: Car, drive: Drive, road_map: RoadSection, noise: GripNoise, memory: CarMemory | None
) -> Summarised | str:
    """Return what an exactly declared car makes of a drive, or the outcome that left nothing to make."""
    if not drive.completed:
        return drive.outcome.value
    passage = summarise_passage(
        drive.trace, road_map, vehicle=car.geometry, handling=car.matched, noise=noise, memory=memory
    )
    return f"rejected_{passage.reason.value}" if isinstance(passage, Rejected) else passage


def grip_of(
    handling: Handling, car: Car, passage: Summarised, noise: GripNoise, memory: CarMemory | None
) -> FloatArray:
    """Return the grip features of a passage by what a car goes by, in the order of the feature table."""
    return grip_features(passage.sensed, vehicle=car.geometry, handling=handling, noise=noise, memory=memory)


def taught(
    handling: Handling, car: Car, passage: Summarised, memory: CarMemory, noise: GripNoise, *, friction_mu: float
) -> CarMemory:
    """Return the memory of a car after a passage."""
    return memory_after(
        passage.sensed, memory, friction_mu=friction_mu, vehicle=car.geometry, handling=handling, noise=noise
    )

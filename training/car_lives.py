"""Cars with a life: each drives everyday roads, learns what its sensors and tyres are like, and is then judged.

Eleven cars are driven together: over everyday roads one after the other, all of them on each; then over eleven roads
that are judged, so that every car meets every road and every base friction once, and every road all cars and all
frictions (a Latin square). Group and roads belong together: who holds out a road holds out the cars, too.

One drive is told in several ways, by what is declared of the car: exactly, or every constant ten per cent too large or
too small; and by what the car has learned of itself until then. So all ways of telling are judged on the same drives.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import TypeAlias

import numpy as np

from roadgrip.features import NEWEST_TABLE, road_features
from roadgrip.records import Rejected
from roadgrip.section import RoadSection
from roadgrip.units import FloatArray
from training.dataset import COMPLETED, LABEL_COLUMNS, Runs, joined
from training.designs import BASE_FRICTIONS_MU
from training.passage_rows import labels_of
from training.random_roads import random_section
from training.scenarios import WITH_GNSS_FRAC, Run, Terms, chance, surveyed_map
from vehicle_client.estimation.grip.memory import AUTOMOTIVE_STDS, IDEAL_STDS, CarMemory, new_memory
from vehicle_client.estimation.grip.noise import GripNoise
from vehicle_client.estimation.handling import XC90_HANDLING, Handling
from vehicle_client.estimation.vehicle_geometry import XC90 as XC90_GEOMETRY
from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.pipeline import Summarised, grip_features, memory_after, summarise_passage
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.plan import DECLARED_NOISE, PassagePlan, SensorGrade, draw_plan
from vehicle_client.simulator.run import each_passage
from vehicle_client.simulator.variation import draw_vehicle, geometry_of, handling_of
from vehicle_client.simulator.vehicle import XC90, Vehicle

CARS_COUNT = len(BASE_FRICTIONS_MU)
"""In a group, as roads that are judged."""
EVERYDAY_COUNT = 15
"""Passages before a car is judged."""
FEW_COUNT = 5
EVERYDAY_MU = (0.4, 0.9)
"""Base friction of everyday roads: wet to dry, evenly."""
WRONG_RATIO = 0.1
MATCHED_STD_RATIO = 0.01
"""How well a maker who declares a car exactly says that he does."""
_BEST_COLUMN = NEWEST_TABLE.index("grip_all_best_mu")
_GRIP_COLUMNS = slice(_BEST_COLUMN, len(NEWEST_TABLE.kinematic))
"""The grip features begin with the best friction and end what the vehicle tells."""
_SENSOR_STDS = {SensorGrade.AUTOMOTIVE: AUTOMOTIVE_STDS, SensorGrade.IDEAL: IDEAL_STDS}


class Telling(StrEnum):
    """What a car goes by when it tells of a passage; the scenario of its rows."""

    MATCHED = "matched"
    """Its constants as they are; sensors as their maker declares them."""
    REMEMBERED = "remembered"
    """The same, and what fifteen passages taught it of its sensors."""
    WRONG = "wrong"
    """Every constant ten per cent too large or too small, and it does not know."""
    IDENTIFIED_FEW = "identified-few"
    """The same constants, of which it knows that they are rough, and what five passages taught it."""
    IDENTIFIED = "identified"
    """What fifteen passages taught it."""


Known: TypeAlias = Mapping[Telling, tuple[Handling, CarMemory | None]]
"""What a car goes by, for every way of telling."""


@dataclass(frozen=True, slots=True)
class Lives:
    """Which cars live.

    Attributes:
        name: Part of every run's key.
        seed: Changes every run; roads that are judged are those of the design of random roads with this seed.
        grade: Which sensors the cars carry.
        groups_count: How many groups of cars.
        varied_vehicles: Whether every car is another one of the fleet, or all are the paper's.
    """

    name: str
    seed: int
    grade: SensorGrade
    groups_count: int
    varied_vehicles: bool

    @property
    def identity(self) -> str:
        """Sixteen hexadecimal characters that change with all but the number of groups and the code."""
        return hashlib.sha256(repr(replace(self, groups_count=0)).encode()).hexdigest()[:16]

    @property
    def terms(self) -> Terms:
        """What designs call what all runs share."""
        return Terms(self.name, self.seed, self.grade)


@dataclass(frozen=True, slots=True)
class Car:
    """One car.

    Attributes:
        name: Of its group and its place in it.
        vehicle: As it is.
        sensor_seed: Of what its sensors get wrong all its life.
        wear_factor: Of its tyres.
        geometry: What is declared, exactly.
        matched: What an exact maker declares.
        wrong: What a careless one declares.
    """

    name: str
    vehicle: Vehicle
    sensor_seed: int
    wear_factor: float
    geometry: VehicleGeometry
    matched: Handling
    wrong: Handling


def wrong_handling(handling: Handling, rng: np.random.Generator, *, ratio: float = WRONG_RATIO) -> Handling:
    """Return constants each of which is too large or too small by the same share; shares stay below 1.

    Args:
        handling: As it is.
        rng: Source of chance.
        ratio: By how much each is off.
    """

    def off(record: object) -> dict[str, float]:
        named = {field.name: getattr(record, field.name) for field in fields(record)}  # type: ignore[arg-type]
        return {
            name: min(1.0, changed) if name.endswith("_frac") else changed
            for name, value in named.items()
            if isinstance(value, float)
            for changed in (value * (1.0 + ratio * rng.choice([-1.0, 1.0])),)
        }

    return replace(handling, **off(handling), tyre=replace(handling.tyre, **off(handling.tyre)))


def car_of(lives: Lives, group: int, place: int) -> Car:
    """Return a car of a group."""
    name = f"{lives.name}/{group:04d}-{place:02d}"
    rng = chance(lives.seed, f"{name}|car")
    vehicle, geometry, matched = XC90, XC90_GEOMETRY, XC90_HANDLING
    if lives.varied_vehicles:
        vehicle = draw_vehicle(chance(lives.seed, f"{name}|vehicle"))
        geometry, matched = geometry_of(vehicle), handling_of(vehicle)
    return Car(
        name=name,
        vehicle=vehicle,
        sensor_seed=int(rng.integers(2**63)),
        wear_factor=rng.uniform(0.8, 1.0),
        geometry=geometry,
        matched=matched,
        wrong=wrong_handling(matched, rng),
    )


def everyday_road(lives: Lives, group: int, number: int) -> RoadSection:
    """Return a road that the cars of a group learn on."""
    seed = [lives.seed, 1_000_000 + group * EVERYDAY_COUNT + number]
    return random_section(np.random.default_rng(seed), section_id=f"everyday-{lives.seed}-{group:04d}-{number:02d}")


def judged_road(lives: Lives, group: int, number: int) -> RoadSection:
    """Return a road that the cars of a group are judged on."""
    index = group * CARS_COUNT + number
    return random_section(np.random.default_rng([lives.seed, index]), section_id=f"random-{lives.seed}-{index:04d}")


def lived(lives: Lives, group: int) -> Runs:
    """Return what the cars of a group tell on the roads that are judged, once for every way of telling.

    Args:
        lives: Which cars live.
        group: Which of their groups, from 0.
    """
    cars = [car_of(lives, group, place) for place in range(CARS_COUNT)]
    noise = DECLARED_NOISE[lives.grade]
    rough, exact = (
        [new_memory(handling_std_ratio=std, sensor_stds=_SENSOR_STDS[lives.grade]) for _ in cars]
        for std in (WRONG_RATIO, MATCHED_STD_RATIO)
    )
    few = list(rough)
    for number in range(EVERYDAY_COUNT):
        if number == FEW_COUNT:
            few = list(rough)
        section = everyday_road(lives, group, number)
        low, high = EVERYDAY_MU
        plans = []
        for car in cars:
            rng = chance(lives.seed, f"{car.name}|everyday {number}")
            plans.append(_plan(rng, lives, car, section, base_friction_mu=float(rng.uniform(low, high))))
        road_map = surveyed_map(lives.terms, section)
        for place, (car, drive) in enumerate(zip(cars, each_passage(section, plans), strict=True)):
            passage = _summarised(car, drive, road_map, noise, exact[place])
            if isinstance(passage, str):
                continue
            mu = passage.summary.values[_BEST_COLUMN]
            exact[place] = _taught(car.matched, car, passage, exact[place], noise, friction_mu=mu)
            mu = _grip(car.wrong, car, passage, noise, rough[place])[0]
            rough[place] = _taught(car.wrong, car, passage, rough[place], noise, friction_mu=float(mu))
    known = [
        {
            Telling.MATCHED: (car.matched, None),
            Telling.REMEMBERED: (car.matched, exact[place]),
            Telling.WRONG: (car.wrong, None),
            Telling.IDENTIFIED_FEW: (car.wrong, few[place]),
            Telling.IDENTIFIED: (car.wrong, rough[place]),
        }
        for place, car in enumerate(cars)
    ]
    return joined([_judged(lives, group, number, cars, known) for number in range(CARS_COUNT)])


def _judged(lives: Lives, group: int, number: int, cars: Sequence[Car], known: Sequence[Known]) -> Runs:
    """Return what the cars tell of one road, in every way."""
    section = judged_road(lives, group, number)
    noise = DECLARED_NOISE[lives.grade]
    road, road_map = road_features(section), surveyed_map(lives.terms, section)
    plans = []
    for place, car in enumerate(cars):
        base_mu = BASE_FRICTIONS_MU[(place + number) % CARS_COUNT]
        rng = chance(lives.seed, f"{car.name}|judged {number}")
        plans.append(_plan(rng, lives, car, section, base_friction_mu=base_mu))
    rows, words, labels = [], [], []
    for place, (car, drive) in enumerate(zip(cars, each_passage(section, plans), strict=True)):
        run = Run(f"{car.name}/{number:02d}", place, drive.plan, car.geometry, car.matched)
        passage = _summarised(car, drive, road_map, noise, None)
        for telling, (handling, memory) in known[place].items():
            values = np.full(len(NEWEST_TABLE), np.nan)
            outcome = passage if isinstance(passage, str) else COMPLETED
            if not isinstance(passage, str):
                values = np.concatenate([passage.summary.values, road])
                values[_GRIP_COLUMNS] = _grip(handling, car, passage, noise, memory)
            rows.append(values)
            words.append((telling.value, outcome, f"{run.key}/{telling.value}"))
            labels.append(labels_of(section, run, drive))
    scenario, outcomes, keys = zip(*words, strict=True)
    return Runs(
        features=np.array(rows),
        labels={name: np.array([one[name] for one in labels]) for name in LABEL_COLUMNS},
        scenario=scenario,
        section_id=(section.section_id,) * len(rows),
        outcome=outcomes,
        run_key=keys,
    )


def _plan(
    rng: np.random.Generator, lives: Lives, car: Car, section: RoadSection, *, base_friction_mu: float
) -> PassagePlan:
    plan = draw_plan(
        rng,
        section=section,
        base_friction_mu=base_friction_mu,
        grade=lives.grade,
        with_gnss=bool(rng.random() < WITH_GNSS_FRAC),
        vehicle=car.vehicle,
    )
    return replace(plan, wear_factor=car.wear_factor, sensor_seed=car.sensor_seed)


def _summarised(
    car: Car, drive: Drive, road_map: RoadSection, noise: GripNoise, memory: CarMemory | None
) -> Summarised | str:
    """Return what an exactly declared car makes of a drive, or the outcome that left nothing to make."""
    if not drive.completed:
        return drive.outcome.value
    passage = summarise_passage(
        drive.trace, road_map, vehicle=car.geometry, handling=car.matched, noise=noise, memory=memory
    )
    return f"rejected_{passage.reason.value}" if isinstance(passage, Rejected) else passage


def _grip(handling: Handling, car: Car, passage: Summarised, noise: GripNoise, memory: CarMemory | None) -> FloatArray:
    return grip_features(passage.sensed, vehicle=car.geometry, handling=handling, noise=noise, memory=memory)


def _taught(
    handling: Handling, car: Car, passage: Summarised, memory: CarMemory, noise: GripNoise, *, friction_mu: float
) -> CarMemory:
    return memory_after(
        passage.sensed, memory, friction_mu=friction_mu, vehicle=car.geometry, handling=handling, noise=noise
    )

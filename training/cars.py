"""Cars that exist for longer than one run: what each is, what its sensors get wrong, what its maker declares of it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from training.chance import chance
from vehicle_client.estimation.handling import XC90_HANDLING, Handling
from vehicle_client.estimation.vehicle_geometry import XC90 as XC90_GEOMETRY
from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.simulator.plan import SensorGrade
from vehicle_client.simulator.variation import draw_vehicle, geometry_of, handling_of
from vehicle_client.simulator.vehicle import XC90, Vehicle

CARS_COUNT = 11
"""Cars in a group, which are driven together: one for each base friction of the paper's matrix."""
WRONG_RATIO = 0.1
GARAGE_NAME = "garage"


@dataclass(frozen=True, slots=True)
class Lives:
    """Which cars live.

    Attributes:
        name: Part of every car's name.
        seed: Changes every car.
        grade: Which sensors the cars carry; the cars are the same with any.
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


@dataclass(frozen=True, slots=True)
class Garage:
    """The cars from which every run of a design takes one, whatever the road: each keeps the errors of its sensors.

    Attributes:
        groups_count: How many groups of cars there are.
        remembering_count: How many of the groups have learned on everyday roads what their cars are like; the others
            come from the dealer.
        varied_vehicles: Whether every car is another one of the fleet, or all are the paper's.
    """

    groups_count: int
    remembering_count: int
    varied_vehicles: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.remembering_count <= self.groups_count or self.groups_count < 1:
            raise ValueError(f"{self.remembering_count} of {self.groups_count} groups of cars cannot have learned")

    def cars(self, seed: int, grade: SensorGrade) -> Lives:
        """Return the cars, of a design's seed and with its sensors."""
        return Lives(GARAGE_NAME, seed, grade, self.groups_count, self.varied_vehicles)


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


def cars_of(lives: Lives, group: int) -> tuple[Car, ...]:
    """Return the cars of a group."""
    return tuple(car_of(lives, group, place) for place in range(CARS_COUNT))


def any_car(rng: np.random.Generator, lives: Lives) -> Car:
    """Return some car of all of them."""
    return car_of(lives, *divmod(int(rng.integers(lives.groups_count * CARS_COUNT)), CARS_COUNT))


def wrong_handling(handling: Handling, rng: np.random.Generator, *, ratio: float = WRONG_RATIO) -> Handling:
    """Return constants each of which is too large or too small by the same share; shares stay below 1.

    Args:
        handling: As it is.
        rng: Source of chance.
        ratio: By how much each is off.
    """

    def off(record: object) -> Iterator[tuple[str, float]]:
        for field in fields(record):  # type: ignore[arg-type]
            value = getattr(record, field.name)
            if isinstance(value, float):
                changed = value * (1.0 + ratio * rng.choice([-1.0, 1.0]))
                yield field.name, min(1.0, changed) if field.name.endswith("_frac") else changed

    return replace(handling, **dict(off(handling)), tyre=replace(handling.tyre, **dict(off(handling.tyre))))

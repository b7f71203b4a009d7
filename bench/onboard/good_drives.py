"""Drives with sensors that work, of every kind there is: what must not be called faulty."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import NamedTuple

import numpy as np

from bench.onboard.drives import SEED
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from training.manoeuvres import (
    Manoeuvre,
    StraightCase,
    draw_extreme_plan,
    draw_manoeuvre,
    draw_straight_plan,
    straight_section,
)
from training.random_roads import random_section
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry
from vehicle_client.simulator.drive import Drive
from vehicle_client.simulator.map_error import map_as_surveyed
from vehicle_client.simulator.plan import DriverKind, PassagePlan, SensorGrade, draw_plan
from vehicle_client.simulator.run import each_passage
from vehicle_client.simulator.sensors import SENSORS
from vehicle_client.simulator.variation import draw_vehicle, geometry_of

ROADS = ("long-turn", "s-turn", "sharp-turn")
FRICTIONS_MU = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
EACH_COUNT = 3
MANOEUVRES_COUNT, RANDOM_COUNT, FLEET_COUNT, STRAIGHTS_COUNT = 160, 200, 120, 24


class Good(NamedTuple):
    """One drive that stayed on the road.

    Attributes:
        kind: The road, or what else is special.
        section: Where it took place.
        road_map: The map the vehicle has of it.
        vehicle: Its car.
        drive: What was true and what the sensors saw.
    """

    kind: str
    section: RoadSection
    road_map: RoadSection
    vehicle: VehicleGeometry
    drive: Drive


def good_drives() -> Iterator[Good]:
    """Yield some 670 drives: all roads, frictions, drivers, grades, with and without positions, slides, other cars."""
    rng = np.random.default_rng(SEED)
    asked = [*_on_the_packaged_roads(rng), *_manoeuvres(rng), *_on_random_roads(rng), *_of_other_cars(rng)]
    for _, group in groupby(asked, key=lambda one: id(one[1])):
        several = list(group)
        plans = [plan for _, _, plan, _ in several]
        drives = each_passage(several[0][1], plans)
        for (kind, section, plan, vehicle), drive in zip(several, drives, strict=True):
            road_map = map_as_surveyed(section, rng=rng, sensors=SENSORS[plan.sensor_grade])
            if drive.completed:
                yield Good(kind, section, road_map, vehicle, drive)


_Asked = tuple[str, RoadSection, PassagePlan, VehicleGeometry]


def _on_the_packaged_roads(rng: np.random.Generator) -> Iterator[_Asked]:
    for name in ROADS:
        section = read_section(name)
        for base_friction_mu in FRICTIONS_MU:
            for number in range(4 * EACH_COUNT):
                kind = DriverKind.REACTING if number % 3 == 0 else DriverKind.PRUDENT
                plan = draw_plan(
                    rng,
                    section=section,
                    base_friction_mu=base_friction_mu,
                    grade=tuple(SensorGrade)[number % 2],
                    kind=kind,
                    with_gnss=number % 4 < 2,
                )
                yield name, section, plan, XC90


def _manoeuvres(rng: np.random.Generator) -> Iterator[_Asked]:
    for number in range(MANOEUVRES_COUNT):
        kind = tuple(Manoeuvre)[number % 4]
        section = draw_manoeuvre(rng, kind, section_id=f"{kind.value}-{number}")
        plan = draw_extreme_plan(
            rng,
            section=section,
            base_friction_mu=rng.uniform(0.2, 1.0),
            grade=tuple(SensorGrade)[number // 4 % 2],
            with_gnss=number % 3 > 0,
        )
        yield kind.value, section, plan, XC90
    for number in range(STRAIGHTS_COUNT):
        case = tuple(StraightCase)[number % 4]
        straight_plan = draw_straight_plan(
            rng, case=case, base_friction_mu=rng.uniform(0.2, 0.8), grade=tuple(SensorGrade)[number // 4 % 2]
        )
        yield case.value, straight_section(), straight_plan, XC90


def _on_random_roads(rng: np.random.Generator) -> Iterator[_Asked]:
    for number in range(RANDOM_COUNT):
        section = random_section(rng, section_id=f"random-{number}")
        plan = draw_plan(
            rng,
            section=section,
            base_friction_mu=rng.uniform(0.2, 0.8),
            grade=tuple(SensorGrade)[number % 2],
            with_gnss=number % 4 < 2,
        )
        yield "random road", section, plan, XC90


def _of_other_cars(rng: np.random.Generator) -> Iterator[_Asked]:
    for number in range(FLEET_COUNT):
        packaged = number % 2 == 0
        section = read_section(ROADS[number % 3]) if packaged else random_section(rng, section_id=f"fleet-{number}")
        vehicle = draw_vehicle(rng)
        plan = draw_plan(
            rng,
            section=section,
            base_friction_mu=rng.uniform(0.2, 0.8),
            with_gnss=number % 4 < 2,
            vehicle=vehicle,
        )
        yield "other car", section, plan, geometry_of(vehicle)

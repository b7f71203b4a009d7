"""Named designs: which roads are driven at which friction by how many vehicles.

A run depends on its key and the design's seed alone. Adding roads or vehicles to a design changes no run that was in
it before, and any run can be driven again by itself.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from roadgrip.section import RoadSection
from training.random_roads import random_section
from vehicle_client.simulator.plan import DriverKind, PassagePlan, SensorGrade, draw_plan

BASE_FRICTIONS_MU = tuple(round(0.20 + 0.05 * i, 2) for i in range(11))
"""The paper's test matrix: 0.2 to 0.7 in steps of 0.05."""
WITH_GNSS_FRAC = 0.75
"""Share of the vehicles that have position fixes; the others match the map by their motion."""
SHARD_RUNS_COUNT = 10
"""Runs per base friction in one shard: a few seconds of work, so that little is lost to a kill."""


@dataclass(frozen=True, slots=True)
class Road:
    """One road of a design.

    Attributes:
        section: Its map.
        runs_count: Vehicles per base friction.
    """

    section: RoadSection
    runs_count: int


@dataclass(frozen=True, slots=True)
class Design:
    """A set of runs.

    Attributes:
        name: Part of every run's key.
        roads: What is driven.
        base_frictions_mu: Each road is driven at each of them.
        sensor_grade: Which sensors the vehicles carry.
        driver_kind: What their drivers go by.
        seed: Changes every run.
    """

    name: str
    roads: tuple[Road, ...]
    base_frictions_mu: tuple[float, ...]
    sensor_grade: SensorGrade
    driver_kind: DriverKind
    seed: int

    @property
    def runs_count(self) -> int:
        """All runs of the design."""
        return sum(road.runs_count for road in self.roads) * len(self.base_frictions_mu)


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a design.

    Attributes:
        key: Its name; with the design's seed it fixes everything random in it.
        plan: What is driven.
    """

    key: str
    plan: PassagePlan


@dataclass(frozen=True, slots=True)
class Shard:
    """Runs on one road that are driven and stored together.

    Attributes:
        design: What it is a part of.
        road_index: Its road.
        first_run: Number of its first vehicle at each base friction.
        last_run: One beyond its last.
    """

    design: Design
    road_index: int
    first_run: int
    last_run: int

    @property
    def section(self) -> RoadSection:
        """The road it is driven on."""
        return self.design.roads[self.road_index].section

    @property
    def runs_count(self) -> int:
        """Number of its runs."""
        return (self.last_run - self.first_run) * len(self.design.base_frictions_mu)

    @property
    def name(self) -> str:
        """Name of its file: changes with everything that changes its runs, but for the code that drives them."""
        design = self.design
        text = "|".join(
            [
                design.name,
                str(design.seed),
                design.sensor_grade.value,
                design.driver_kind.value,
                self.section.version,
                ",".join(f"{mu:.3f}" for mu in design.base_frictions_mu),
            ]
        )
        digest = hashlib.sha256(text.encode()).hexdigest()[:8]
        return f"{self.section.section_id}-{self.first_run:05d}-{self.last_run:05d}-{digest}"


def paper_roads_design(
    sections: tuple[RoadSection, ...],
    *,
    runs_count: int,
    sensor_grade: SensorGrade,
    seed: int,
    driver_kind: DriverKind = DriverKind.PRUDENT,
) -> Design:
    """Return the paper's test matrix on its roads, with so many vehicles per road and base friction."""
    return Design(
        name="paper-roads",
        roads=tuple(Road(section, runs_count) for section in sections),
        base_frictions_mu=BASE_FRICTIONS_MU,
        sensor_grade=sensor_grade,
        driver_kind=driver_kind,
        seed=seed,
    )


def mixed_design(
    sections: tuple[RoadSection, ...],
    *,
    runs_count: int,
    random_roads_count: int,
    random_runs_count: int,
    sensor_grade: SensorGrade,
    seed: int,
    driver_kind: DriverKind = DriverKind.PRUDENT,
) -> Design:
    """Return given roads with many vehicles each and random roads with a few each.

    Args:
        sections: Roads the model shall know well.
        runs_count: Vehicles per base friction on each of them.
        random_roads_count: Number of random roads.
        random_runs_count: Vehicles per base friction on each of those.
        sensor_grade: Which sensors the vehicles carry.
        seed: Changes every run and every random road.
        driver_kind: What the drivers go by.
    """
    known = tuple(Road(section, runs_count) for section in sections)
    unknown = tuple(
        Road(random_section(np.random.default_rng([seed, i]), section_id=f"random-{seed}-{i:04d}"), random_runs_count)
        for i in range(random_roads_count)
    )
    return Design(
        name="mixed",
        roads=known + unknown,
        base_frictions_mu=BASE_FRICTIONS_MU,
        sensor_grade=sensor_grade,
        driver_kind=driver_kind,
        seed=seed,
    )


def shards_of(design: Design) -> tuple[Shard, ...]:
    """Return the design cut into pieces of a few seconds' work; together they hold every run once."""
    return tuple(
        Shard(design, road_index, first, min(first + SHARD_RUNS_COUNT, road.runs_count))
        for road_index, road in enumerate(design.roads)
        for first in range(0, road.runs_count, SHARD_RUNS_COUNT)
    )


def runs_of(shard: Shard) -> tuple[Run, ...]:
    """Return the runs of a shard, by base friction and number."""
    return tuple(
        _run(shard.design, shard.section, base_friction_mu=mu, number=number)
        for mu in shard.design.base_frictions_mu
        for number in range(shard.first_run, shard.last_run)
    )


def _run(design: Design, section: RoadSection, *, base_friction_mu: float, number: int) -> Run:
    key = f"{design.name}/{design.sensor_grade.value}/{section.section_id}/{base_friction_mu:.2f}/{number:05d}"
    entropy = int.from_bytes(hashlib.sha256(f"{design.seed}|{key}".encode()).digest()[:16], "big")
    rng = np.random.default_rng(entropy)
    with_gnss = bool(rng.random() < WITH_GNSS_FRAC)
    plan = draw_plan(
        rng,
        section=section,
        base_friction_mu=base_friction_mu,
        grade=design.sensor_grade,
        kind=design.driver_kind,
        with_gnss=with_gnss,
    )
    return Run(key, plan)

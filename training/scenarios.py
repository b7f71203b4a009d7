"""What a design is made of: scenarios, each driven at every base friction, and the plan of every run in it.

A run depends on its key and the design's seed alone. Adding scenarios or vehicles to a design changes no run that was
in it before, and any run can be driven again by itself. The key does not name the sensors: with the same seed, ideal
and automotive sensors watch the same drives.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace

import numpy as np

from roadgrip.section import RoadSection
from training.advice_following import draw_advised_plan, with_any_speed
from training.cars import Garage, Lives, any_car
from training.chance import chance
from training.friction_profiles import two_frictions
from training.manoeuvres import StraightCase, draw_extreme_plan, draw_straight_plan
from vehicle_client.estimation.handling import XC90_HANDLING, Handling
from vehicle_client.estimation.vehicle_geometry import XC90 as XC90_GEOMETRY
from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.simulator.amplitudes import SENSORS, scaled
from vehicle_client.simulator.map_error import map_as_surveyed
from vehicle_client.simulator.plan import (
    UNSCALED,
    AmplitudeScales,
    DriverKind,
    PassagePlan,
    SensorGrade,
    draw_plan,
)
from vehicle_client.simulator.variation import draw_vehicle, geometry_of, handling_of
from vehicle_client.simulator.vehicle import XC90, Vehicle

WITH_GNSS_FRAC = 0.75
"""Share of the vehicles that have position fixes; the others match the map by their motion."""
ATTEMPTS_PER_KEPT_RUN_COUNT = 20
"""How often a cell is tried per run that it shall keep before it is called infeasible."""


@dataclass(frozen=True, slots=True)
class Quota:
    """When a cell has enough.

    Attributes:
        attempts_limit_count: No more are made.
        kept_count: The cell ends with the attempt that gives this many kept runs; None: with the last attempt.
    """

    attempts_limit_count: int
    kept_count: int | None = None


def kept(runs_count: int) -> Quota:
    """Return the paper's rule: so many runs that gave a summary, or the cell is infeasible after 20 times as many."""
    return Quota(ATTEMPTS_PER_KEPT_RUN_COUNT * runs_count, runs_count)


def attempted(runs_count: int) -> Quota:
    """Return the plain rule: so many runs, however they end."""
    return Quota(runs_count)


@dataclass(frozen=True, slots=True)
class Scenario:
    """One way of driving one road.

    Attributes:
        name: Part of every run's key; one of its kind in the design.
        section: The road.
        quota: How many runs at each base friction.
        two_frictions: Whether the friction drops along the road instead of being the same all over.
        slippery_first: Whether it rises instead, where there are two.
        varied_vehicles: Whether every run has a car of its own instead of the paper's.
        compliance_frac: Share of the drivers who follow the advisory; None where nobody is advised.
        extreme: Whether test drivers drive, as fast as the surface lets them, every other one without stability
            systems.
        straight_case: What the pedals do, on the straight section.
        any_speed: Whether drivers wish any speed from `SLOWEST_FRAC` of the rated one to the paper's highest, whatever
            the friction: someone ahead of them, an advice that is wrong, a view.
        drawn_as: Scenarios with the same word here have the same drivers, tyres and surfaces, run by run; None: its
            own name.
    """

    name: str
    section: RoadSection
    quota: Quota
    two_frictions: bool = False
    slippery_first: bool = False
    varied_vehicles: bool = False
    compliance_frac: float | None = None
    extreme: bool = False
    straight_case: StraightCase | None = None
    any_speed: bool = False
    drawn_as: str | None = None

    @property
    def identity(self) -> str:
        """All that shapes the runs of the scenario besides code, seed and friction, as text."""
        way = (
            self.two_frictions,
            self.varied_vehicles,
            self.compliance_frac,
            self.extreme,
            str(self.straight_case),
            self.drawn_as,
        )
        # Named where it is so, as usual designs keep their names.
        words = "|any speed" if self.any_speed else ""
        words += "|slippery first" if self.slippery_first else ""
        return f"{self.name}|{self.section.section_id}|{self.section.version}|{way}{words}"


@dataclass(frozen=True, slots=True)
class Terms:
    """What all runs of a design share.

    Attributes:
        design_name: Part of every run's key.
        seed: Changes every run.
        sensor_grade: Which sensors the vehicles carry.
        driver_kind: What their drivers go by.
        scales: How many times as large disturbances are as usual; the drivers and the draws stay the same.
        garage: The cars that are driven; None: every run has sensors of its own, and remembers nothing.
    """

    design_name: str
    seed: int
    sensor_grade: SensorGrade
    driver_kind: DriverKind = DriverKind.PRUDENT
    scales: AmplitudeScales = field(default=UNSCALED, repr=False)
    garage: Garage | None = field(default=None, repr=False)

    def __str__(self) -> str:
        """Return all of it as text; what is as usual is not named, so that usual designs keep their names."""
        words = [repr(self)]
        words += [] if self.scales == UNSCALED else [str(self.scales)]
        words += [] if self.garage is None else [str(self.garage)]
        return "|".join(words)

    @property
    def cars(self) -> Lives | None:
        """The cars of the garage."""
        return None if self.garage is None else self.garage.cars(self.seed, self.sensor_grade)


@dataclass(frozen=True, slots=True)
class Design:
    """A set of cells: each scenario at each base friction.

    Attributes:
        terms: What all runs share.
        scenarios: What is driven.
        base_frictions_mu: Each scenario is driven at each of them.
    """

    terms: Terms
    scenarios: tuple[Scenario, ...]
    base_frictions_mu: tuple[float, ...]

    def __post_init__(self) -> None:
        names = [scenario.name for scenario in self.scenarios]
        if len(set(names)) < len(names):
            raise ValueError(f"two scenarios of one name: {sorted({n for n in names if names.count(n) > 1})}")

    @property
    def name(self) -> str:
        """Name of the design."""
        return self.terms.design_name

    @property
    def identity(self) -> str:
        """Sixteen hexadecimal characters that change with everything that changes the table, but for the code."""
        parts = [str(self.terms), str(self.base_frictions_mu)]
        parts += [f"{scenario.identity}|{scenario.quota}" for scenario in self.scenarios]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a design.

    Attributes:
        key: Its name; with the design's seed it fixes everything random in it.
        number: Which attempt of its cell it is, from 0.
        plan: What is driven.
        geometry: What the car's onboard client knows of it.
        handling: What is declared to it of masses, springs and tyres.
    """

    key: str
    number: int
    plan: PassagePlan
    geometry: VehicleGeometry
    handling: Handling


def run_of(terms: Terms, scenario: Scenario, *, base_friction_mu: float, number: int) -> Run:
    """Return one attempt of a cell.

    Args:
        terms: Of its design.
        scenario: Of its cell.
        base_friction_mu: Of its cell.
        number: Which attempt, from 0.

    Raises:
        ValueError: The scenario wants cars of a fleet, and the garage holds none, or the other way round.
    """
    key = f"{terms.design_name}/{scenario.name}/{base_friction_mu:.2f}/{number:05d}"
    drawn_as = f"{terms.design_name}/{scenario.drawn_as or scenario.name}/{base_friction_mu:.2f}/{number:05d}"
    vehicle, geometry, handling = XC90, XC90_GEOMETRY, XC90_HANDLING
    if scenario.varied_vehicles:
        vehicle = draw_vehicle(chance(terms.seed, f"{drawn_as}|vehicle"))
        geometry, handling = geometry_of(vehicle), handling_of(vehicle)
    sensor_seed = None
    if (cars := terms.cars) is not None:
        if cars.varied_vehicles != scenario.varied_vehicles:
            raise ValueError(f"{scenario.name}: the garage holds other kinds of cars than the scenario wants")
        car = any_car(chance(terms.seed, f"{drawn_as}|car"), cars)
        vehicle, geometry, handling, sensor_seed = car.vehicle, car.geometry, car.matched, car.sensor_seed
    plan = _plan(chance(terms.seed, drawn_as), terms, scenario, base_friction_mu=base_friction_mu, vehicle=vehicle)
    return Run(key, number, replace(plan, scales=terms.scales, sensor_seed=sensor_seed), geometry, handling)


def _plan(
    rng: np.random.Generator, terms: Terms, scenario: Scenario, *, base_friction_mu: float, vehicle: Vehicle
) -> PassagePlan:
    section, grade = scenario.section, terms.sensor_grade
    with_gnss = bool(rng.random() < WITH_GNSS_FRAC) and bool(section.anchors)
    if scenario.straight_case is not None:
        return draw_straight_plan(
            rng, case=scenario.straight_case, base_friction_mu=base_friction_mu, grade=grade, vehicle=vehicle
        )
    if scenario.extreme:
        return draw_extreme_plan(rng, section=section, base_friction_mu=base_friction_mu, grade=grade, vehicle=vehicle)
    profile = None
    if scenario.two_frictions:
        profile = two_frictions(section, base_friction_mu=base_friction_mu, slippery_first=scenario.slippery_first)
    if scenario.compliance_frac is None:
        usual = draw_plan(
            rng,
            section=section,
            base_friction_mu=base_friction_mu,
            grade=grade,
            kind=terms.driver_kind,
            friction_profile=profile,
            with_gnss=with_gnss,
            vehicle=vehicle,
        )
        return with_any_speed(usual, rng, section=section) if scenario.any_speed else usual
    return draw_advised_plan(
        rng,
        section=section,
        base_friction_mu=base_friction_mu,
        compliance_frac=scenario.compliance_frac,
        grade=grade,
        kind=terms.driver_kind,
        friction_profile=profile,
        with_gnss=with_gnss,
        vehicle=vehicle,
    )


def surveyed_map(terms: Terms, section: RoadSection) -> RoadSection:
    """Return the map that all vehicles of a design have of a road: a survey's with automotive sensors, else the road.

    Args:
        terms: Of the design.
        section: The road as it is.
    """
    rng = chance(terms.seed, f"map|{section.section_id}")
    sensors = scaled(SENSORS[terms.sensor_grade], terms.scales.sensors_ratio)
    return map_as_surveyed(section, rng=rng, sensors=sensors)

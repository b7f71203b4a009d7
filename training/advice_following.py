"""Drivers who follow the advised speed: a design in which speeds go down to two fifths of the rated one.

What a driver is told depends on the friction, so in these drives friction leaks into the speed, on purpose: it will do
so on every road with a road side unit, and a regressor that takes the speed for a hint of the friction then hears its
own estimates again. This design is for studies of that effect and for models that must live with it. The paper's
design holds speed and friction apart.

The advice is what the unit's own rules make of fifty passages of the hour before, whose estimates are off as a good
regressor's are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rsu_app.domain.advisory import AdvisoryPolicy, advise
from rsu_app.domain.interval import WORN_TYRE_RATIO, IntervalPolicy, friction_interval
from vehicle_client.simulator.plan import (
    SPEED_SPREAD_RATIO,
    DriverKind,
    FrictionProfile,
    PassagePlan,
    SensorGrade,
    draw_plan,
)
from vehicle_client.simulator.vehicle import XC90, Vehicle

if TYPE_CHECKING:
    from roadgrip.records import Advisory
    from roadgrip.section import RoadSection

PASSAGES_COUNT = 50
"""Vehicles that the unit has heard of: from so many on, the paper states its accuracy."""
PASSAGE_ERROR_RATIO = 0.05
"""Standard deviation of one passage's estimate, relative to the friction it found (the paper: below 5 % RMS)."""
ROAD_ERROR_RATIO = 0.05
"""Standard deviation of the error that all estimates of one hour on one road share; it does not average out. The
paper's worst error of the median of 50 vehicles is 6 to 10 %, which is about two of it."""
SLOWEST_FRAC = 0.4
"""Share of the rated speed below which nobody drives for an advice."""
OBEDIENCE_SPREAD_RATIO = 0.05
"""Half width of the triangular distribution of speeds around the advised one among those who follow it."""
NEWEST_AGE_S = 60.0


def draw_advisory(rng: np.random.Generator, *, section: RoadSection, base_friction_mu: float) -> Advisory:
    """Return what a unit tells drivers on a road of known friction, with the errors that its estimates have.

    Args:
        rng: Source of chance; every call takes the same number of draws.
        section: The road.
        base_friction_mu: What it offers a new tyre, where it offers least.
    """
    wear = rng.uniform(WORN_TYRE_RATIO, 1.0, PASSAGES_COUNT)
    error = ROAD_ERROR_RATIO * rng.standard_normal() + PASSAGE_ERROR_RATIO * rng.standard_normal(PASSAGES_COUNT)
    estimates_mu = np.sort(base_friction_mu * wear * np.exp(error))
    interval = friction_interval(estimates_mu.tolist(), newest_age_s=NEWEST_AGE_S, policy=IntervalPolicy())
    return advise(section, interval=interval, model_live=True, policy=AdvisoryPolicy(), previous_speed_mps=None)


def draw_advised_plan(
    rng: np.random.Generator,
    *,
    section: RoadSection,
    base_friction_mu: float,
    compliance_frac: float,
    grade: SensorGrade = SensorGrade.AUTOMOTIVE,
    kind: DriverKind = DriverKind.PRUDENT,
    friction_profile: FrictionProfile | None = None,
    with_gnss: bool = False,
    vehicle: Vehicle = XC90,
) -> PassagePlan:
    """Return the plan of one vehicle whose driver is told an advised speed.

    He follows it with a given probability: then his speed is the advised one, 5 % to either side, yet never below 0.4
    of the rated one. Else he drives as in the paper's matrix: for the same chance he is the very driver of
    `draw_plan`, in the very car. Who follows at one compliance follows at every higher one.

    Args:
        rng: Source of chance; every call takes the same number of draws.
        section: The road, and what is advised on it.
        base_friction_mu: What the surface offers a new tyre, where it offers least.
        compliance_frac: Share of the drivers who follow the advice.
        grade: Which sensors the vehicle carries.
        kind: What the driver goes by besides.
        friction_profile: Friction that varies along the section.
        with_gnss: Whether the trace shall hold position fixes.
        vehicle: The car.
    """
    plan = draw_plan(
        rng,
        section=section,
        base_friction_mu=base_friction_mu,
        grade=grade,
        kind=kind,
        friction_profile=friction_profile,
        with_gnss=with_gnss,
        vehicle=vehicle,
    )
    advised_mps = draw_advisory(rng, section=section, base_friction_mu=base_friction_mu).speed_mps
    obedience_ratio = draw_obedience_ratio(rng)
    follows = bool(rng.random() < compliance_frac)
    return obedient(plan, told_mps=obedience_ratio * advised_mps, section=section) if follows else plan


def draw_obedience_ratio(rng: np.random.Generator) -> float:
    """Return the speed of one who follows an advice over the advised one."""
    return rng.triangular(1.0 - OBEDIENCE_SPREAD_RATIO, 1.0, 1.0 + OBEDIENCE_SPREAD_RATIO)


def obedient(plan: PassagePlan, *, told_mps: float, section: RoadSection) -> PassagePlan:
    """Return how one drives who wishes the speed he is told, and none below `SLOWEST_FRAC` of the rated one."""
    return replace(plan, target_speed_mps=max(SLOWEST_FRAC * section.speed_limit_mps, told_mps))


def with_any_speed(plan: PassagePlan, rng: np.random.Generator, *, section: RoadSection) -> PassagePlan:
    """Return how the same driver drives in the same car with a speed in mind that has nothing to do with the friction.

    Even from `SLOWEST_FRAC` of the rated speed to the highest of the paper's drivers. Models that shall live with
    advice, and with what is wrong in it, must know slow drives on dry roads and fast ones on ice.
    """
    fastest_frac = 1.0 + SPEED_SPREAD_RATIO
    return replace(plan, target_speed_mps=section.speed_limit_mps * rng.uniform(SLOWEST_FRAC, fastest_frac))

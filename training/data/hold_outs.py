"""The simulated hold-outs of a laboratory: three small designs that only judge, with a seed of their own."""

from __future__ import annotations

from dataclasses import dataclass

from training.data.data_shelf import Role
from training.designs import Size, named_design, paper_sections, sections_design
from training.scenarios import Design, Terms
from vehicle_client.simulator.plan import SensorGrade

HOLD_OUT_SEED = 20_310_617
"""Of no design that is learned from; another seed draws other random roads, drivers and tyres."""
DEFAULT_RUNS_COUNT = 12
DEFAULT_RANDOM_ROADS_COUNT = 40
UNSEEN_RUNS_COUNT = 2
"""Runs per base friction on each unseen road: many roads say more than many runs."""
KNOWN_PER_MANOEUVRE_COUNT = 4
"""A run of each manoeuvre for so many on each known road: four manoeuvres, and a half more frictions."""


@dataclass(frozen=True, slots=True)
class HoldOut:
    """A hold-out as it is driven.

    Attributes:
        role: What it judges.
        name: What it is called on the shelf.
        design: What is driven.
    """

    role: Role
    name: str
    design: Design


def hold_outs(*, seed: int, runs_count: int, random_roads_count: int) -> tuple[HoldOut, ...]:
    """Return the hold-outs of known roads, unseen roads and manoeuvres, with automotive sensors and cars as delivered.

    Args:
        seed: Of all three.
        runs_count: Kept runs per cell on the paper's three roads; a quarter of it per cell of the manoeuvres.
        random_roads_count: Roads that nobody learns from.
    """
    manoeuvre_runs_count = -(-runs_count // KNOWN_PER_MANOEUVRE_COUNT)
    roads = Size(UNSEEN_RUNS_COUNT, random_roads_count=random_roads_count)
    designs = {
        Role.KNOWN_ROADS: sections_design(paper_sections(), _terms(Role.KNOWN_ROADS, seed), Size(runs_count)),
        Role.UNSEEN_ROADS: named_design("random-roads", _terms(Role.UNSEEN_ROADS, seed), roads),
        Role.MANOEUVRES: named_design("manoeuvres", _terms(Role.MANOEUVRES, seed), Size(manoeuvre_runs_count)),
    }
    return tuple(HoldOut(role, hold_out_name(role), design) for role, design in designs.items())


def hold_out_name(role: Role) -> str:
    """Return what the simulated hold-out of a role is called."""
    return f"holdout-{role.value.replace('_', '-')}"


def _terms(role: Role, seed: int) -> Terms:
    # A name of its own keeps every run's key, and so its chance, apart from designs that are learned from.
    return Terms(hold_out_name(role), seed, SensorGrade.AUTOMOTIVE)

"""The named designs: what `roadgrip-train simulate --design NAME` drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from training.friction_profiles import has_like_turns
from training.manoeuvres import MANOEUVRE_FRICTIONS_MU, StraightCase, manoeuvre_sections, straight_section
from training.random_roads import random_section
from training.scenarios import Design, Quota, Scenario, Terms, attempted, kept

BASE_FRICTIONS_MU = tuple(round(0.20 + 0.05 * i, 2) for i in range(11))
"""The paper's test matrix: 0.2 to 0.7 in steps of 0.05."""
PAPER_ROADS = ("long-turn", "s-turn", "sharp-turn")
TWO_FRICTIONS_ROAD = "s-turn"
COMPLIANCES_FRAC = (0.0, 0.5, 1.0)
ANY_SPEED_SUFFIX, EXACT_SUFFIX, TWO_FRICTIONS_SUFFIX = "-any-speed", "-exact", "-two-frictions"
"""Of the names of scenarios with drivers of any speed beside usual ones, with exact sensors beside others, or where the
friction drops along the road."""


@dataclass(frozen=True, slots=True)
class Size:
    """How much of a design is driven.

    Attributes:
        runs_count: Per cell: kept runs where the design has a quota, attempts else.
        random_roads_count: Random roads, where the design has some.
        random_runs_count: Runs per base friction on each random road of the mixed design.
    """

    runs_count: int
    random_roads_count: int = 30
    random_runs_count: int = 4


@dataclass(frozen=True, slots=True)
class NamedDesign:
    """One row of the table of designs.

    Attributes:
        description: What it is for, in a line.
        scenarios: Its scenarios, of a size and with a seed for random roads.
        base_frictions_mu: Each scenario is driven at each of them.
        test_drivers: Whether drivers are test drivers, so that there is no kind to choose.
        random_roads: Whether it has random roads.
        random_runs: Whether those have a number of runs of their own.
    """

    description: str
    scenarios: Callable[[Size, int], tuple[Scenario, ...]]
    base_frictions_mu: tuple[float, ...] = BASE_FRICTIONS_MU
    test_drivers: bool = False
    random_roads: bool = False
    random_runs: bool = False


def named_design(name: str, terms_given: Terms, size: Size) -> Design:
    """Return a design of the table.

    Args:
        name: Its name.
        terms_given: Seed, sensors and drivers.
        size: How much of it.

    Raises:
        KeyError: There is no such design.
    """
    named = DESIGNS[name]
    return Design(terms_given, named.scenarios(size, terms_given.seed), named.base_frictions_mu)


def sections_design(sections: tuple[RoadSection, ...], terms: Terms, size: Size) -> Design:
    """Return the paper's test matrix on other roads."""
    scenarios = tuple(Scenario(section.section_id, section, kept(size.runs_count)) for section in sections)
    return Design(terms, scenarios, BASE_FRICTIONS_MU)


def paper_sections() -> tuple[RoadSection, ...]:
    """Return the paper's three roads."""
    return tuple(read_section(name) for name in PAPER_ROADS)


def random_roads(seed: int, roads_count: int, quota: Quota) -> tuple[Scenario, ...]:
    """Return random roads; the first ones are the same however many there are."""
    sections = (
        random_section(np.random.default_rng([seed, i]), section_id=f"random-{seed}-{i:04d}")
        for i in range(roads_count)
    )
    return tuple(Scenario(section.section_id, section, quota) for section in sections)


def _paper(size: Size, _seed: int, *, varied_vehicles: bool = False) -> tuple[Scenario, ...]:
    quota = kept(size.runs_count)
    roads = tuple(
        Scenario(section.section_id, section, quota, varied_vehicles=varied_vehicles) for section in paper_sections()
    )
    section = read_section(TWO_FRICTIONS_ROAD)
    name = f"{TWO_FRICTIONS_ROAD}{TWO_FRICTIONS_SUFFIX}"
    return (*roads, Scenario(name, section, quota, two_frictions=True, varied_vehicles=varied_vehicles))


def _varied_vehicles(size: Size, seed: int) -> tuple[Scenario, ...]:
    return _paper(size, seed, varied_vehicles=True)


def _advice(size: Size, seed: int) -> tuple[Scenario, ...]:
    return tuple(
        Scenario(
            f"{usual.name}-compliance-{100 * compliance:.0f}",
            usual.section,
            usual.quota,
            two_frictions=usual.two_frictions,
            compliance_frac=compliance,
            drawn_as=usual.name,
        )
        for usual in _paper(size, seed)
        for compliance in COMPLIANCES_FRAC
    )


def _manoeuvres(size: Size, _seed: int) -> tuple[Scenario, ...]:
    quota = kept(size.runs_count)
    return tuple(Scenario(section.section_id, section, quota, extreme=True) for section in manoeuvre_sections())


def _straight(size: Size, _seed: int) -> tuple[Scenario, ...]:
    quota = kept(size.runs_count)
    return tuple(Scenario(f"straight-{case}", straight_section(), quota, straight_case=case) for case in StraightCase)


def _random_roads(size: Size, seed: int) -> tuple[Scenario, ...]:
    return random_roads(seed, size.random_roads_count, attempted(size.runs_count))


def _random_roads_fleet(size: Size, seed: int) -> tuple[Scenario, ...]:
    return tuple(replace(scenario, varied_vehicles=True) for scenario in _random_roads(size, seed))


def _random_roads_two_frictions(size: Size, seed: int) -> tuple[Scenario, ...]:
    return _with_two_frictions(_random_roads(size, seed))


def _with_two_frictions(roads: tuple[Scenario, ...]) -> tuple[Scenario, ...]:
    """Return those roads that have two like turns, every other one of all roads with its slippery turn first."""
    return tuple(
        replace(road, name=f"{road.name}{TWO_FRICTIONS_SUFFIX}", two_frictions=True, slippery_first=number % 2 == 1)
        for number, road in enumerate(roads)
        if has_like_turns(road.section)
    )


def _mixed(size: Size, seed: int) -> tuple[Scenario, ...]:
    quota = attempted(size.runs_count)
    known = tuple(Scenario(section.section_id, section, quota) for section in paper_sections())
    return known + random_roads(seed, size.random_roads_count, attempted(size.random_runs_count))


def _any_speed(size: Size, seed: int) -> tuple[Scenario, ...]:
    return tuple(replace(scenario, any_speed=True) for scenario in _mixed(size, seed))


def _default_bundle(size: Size, seed: int) -> tuple[Scenario, ...]:
    # A drive of any speed for every four usual ones.
    fewer = replace(size, runs_count=-(-size.runs_count // 4), random_runs_count=-(-size.random_runs_count // 4))
    usual = _mixed(size, seed)
    any_speed = (replace(road, name=f"{road.name}{ANY_SPEED_SUFFIX}") for road in _any_speed(fewer, seed))
    return usual + tuple(any_speed) + _with_two_frictions(usual)


DESIGNS: Mapping[str, NamedDesign] = {
    "paper": NamedDesign("the paper's test matrix: four scenarios at 11 base frictions, kept runs per cell", _paper),
    "varied-vehicles": NamedDesign(
        "the same with another vehicle in every run, from small car to van", _varied_vehicles
    ),
    "advice": NamedDesign("the same with drivers who follow the advised speed: none, half, all of them", _advice),
    "random-roads": NamedDesign(
        "random roads with a few vehicles each, for what must hold on the next road", _random_roads, random_roads=True
    ),
    "random-roads-fleet": NamedDesign(
        "the same roads with another vehicle in every run", _random_roads_fleet, random_roads=True
    ),
    "random-roads-two-frictions": NamedDesign(
        "random roads of two like turns, one of which is slipperier than the other",
        _random_roads_two_frictions,
        random_roads=True,
    ),
    "manoeuvres": NamedDesign(
        "slalom, tight lane change, ninety-degree turn, sine wave at 0.2 to 1.0, by test drivers",
        _manoeuvres,
        MANOEUVRE_FRICTIONS_MU,
        test_drivers=True,
    ),
    "straight": NamedDesign(
        "straight driving at constant speed, braking softly and fully, accelerating, at 0.2 to 1.0",
        _straight,
        MANOEUVRE_FRICTIONS_MU,
    ),
    "any-speed": NamedDesign(
        "the mixed roads with drivers of any speed, slow or fast whatever the friction",
        _any_speed,
        random_roads=True,
        random_runs=True,
    ),
    "mixed": NamedDesign(
        "the paper's three roads and random ones, attempts per cell", _mixed, random_roads=True, random_runs=True
    ),
    "default-bundle": NamedDesign(
        "the mixed roads by usual drivers, a quarter as many of any speed, like turns also with two frictions",
        _default_bundle,
        random_roads=True,
        random_runs=True,
    ),
}

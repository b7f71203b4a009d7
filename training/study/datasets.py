"""The data sets of the study: which design, how large, with which drivers and cars."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from roadgrip.section import RoadSection
from training.designs import Size
from training.study.ringebu import ringebu_sections
from vehicle_client.simulator.plan import UNSCALED, AmplitudeScales, DriverKind


class Cars(Enum):
    """Which cars have a life of their own in a data set (`training.car_lives`)."""

    PAPER = "all the paper's"
    FLEET = "each another one of the fleet"


@dataclass(frozen=True, slots=True)
class DataSet:
    """One data set.

    Attributes:
        name: How chapters ask for it.
        design: Its name in `training.designs`.
        size: Full size.
        quick_size: For a rough answer.
        driver_kind: What the drivers go by.
        seed: Of the design.
        purpose: What it is for, in a line.
        scales: How many times as large disturbances are as usual.
        sections: Roads to drive instead of a named design's, runs as attempts at the paper's base frictions; `design`
            then only names the runs. Where it returns none, their source is not on this machine, and there are no runs.
        remembering: Whether cars remember the errors of automotive sensors from everyday roads; exact ones leave none.
        lives: Cars that learn on everyday roads before they are judged; `design` then only names the runs, and the
            size counts groups of eleven cars as runs.
    """

    name: str
    design: str
    size: Size
    quick_size: Size
    purpose: str
    driver_kind: DriverKind = DriverKind.PRUDENT
    seed: int = 1
    scales: AmplitudeScales = UNSCALED
    sections: Callable[[], tuple[RoadSection, ...]] | None = None
    remembering: bool = True
    lives: Cars | None = None


GARAGE_GROUPS_COUNT = 36
"""Eleven cars each."""
GARAGE_QUICK_GROUPS_COUNT = 2
SENSITIVITY_SIZE = Size(150)
SENSITIVITY_QUICK_SIZE = Size(6)


def _scaled_set(name: str, what: str, scales: AmplitudeScales) -> DataSet:
    return DataSet(
        name=name,
        design="paper",
        size=SENSITIVITY_SIZE,
        quick_size=SENSITIVITY_QUICK_SIZE,
        purpose=f"the first runs of the paper's matrix once more, {what}",
        scales=scales,
        remembering=False,
    )


DATA_SETS: tuple[DataSet, ...] = (
    DataSet(
        name="paper",
        design="paper",
        size=Size(1000),
        quick_size=Size(30),
        purpose="the paper's matrix: four scenarios, 11 base frictions, prudent drivers, the paper's car",
    ),
    DataSet(
        name="paper-reacting",
        design="paper",
        size=Size(250),
        quick_size=Size(10),
        driver_kind=DriverKind.REACTING,
        purpose="the same by drivers who only react to what they feel",
    ),
    DataSet(
        name="paper-fleet",
        design="varied-vehicles",
        size=Size(300),
        quick_size=Size(10),
        purpose="the same with another vehicle in every run",
    ),
    DataSet(
        name="manoeuvres",
        design="manoeuvres",
        size=Size(60),
        quick_size=Size(6),
        purpose="extreme manoeuvres at base frictions 0.2 to 1.0, never learned from",
    ),
    DataSet(
        name="random-roads",
        design="random-roads",
        size=Size(1, random_roads_count=1500),
        quick_size=Size(1, random_roads_count=90),
        seed=2,
        purpose="random roads, one vehicle per base friction on each",
    ),
    DataSet(
        name="random-roads-two-frictions",
        design="random-roads-two-frictions",
        size=Size(1, random_roads_count=1500),
        quick_size=Size(1, random_roads_count=90),
        seed=5,
        purpose="other random roads, of two like turns with another friction each, one vehicle per base friction",
    ),
    DataSet(
        name="random-roads-new-cars",
        design="random-roads",
        size=Size(1, random_roads_count=400),
        quick_size=Size(1, random_roads_count=60),
        seed=2,
        purpose="some of the random roads by cars from the dealer, which remember nothing of their sensors",
        remembering=False,
    ),
    DataSet(
        name="random-roads-finer-sensors",
        design="random-roads",
        size=Size(1, random_roads_count=400),
        quick_size=Size(1, random_roads_count=60),
        seed=2,
        purpose="the same with half the errors of sensors and map, for what sensors limit",
        scales=AmplitudeScales(sensors_ratio=0.5),
        remembering=False,
    ),
    DataSet(
        name="any-speed",
        design="any-speed",
        size=Size(60, random_roads_count=400, random_runs_count=1),
        quick_size=Size(4, random_roads_count=20, random_runs_count=1),
        seed=2,
        purpose="the paper's roads and some of the random ones at any speed, whatever the friction",
    ),
    DataSet(
        name="random-roads-batches",
        design="random-roads",
        size=Size(60, random_roads_count=30),
        quick_size=Size(12, random_roads_count=4),
        seed=4,
        purpose="other random roads with many vehicles per base friction, for what they say together",
    ),
    DataSet(
        name="ringebu",
        design="ringebu",
        size=Size(2),
        quick_size=Size(1),
        seed=3,
        purpose="bends of a real mountain road, of which nothing is learned, two vehicles per base friction on each",
        sections=ringebu_sections,
    ),
    DataSet(
        name="lives-fleet",
        design="lives-fleet",
        size=Size(48),
        quick_size=Size(3),
        seed=2,
        purpose="cars of a fleet that learn on everyday roads, then drive random ones; told in several ways",
        lives=Cars.FLEET,
    ),
    DataSet(
        name="lives-paper",
        design="lives-paper",
        size=Size(24),
        quick_size=Size(2),
        seed=2,
        purpose="the same with the paper's car and other sensors in each",
        lives=Cars.PAPER,
    ),
    _scaled_set("sensors-halved", "with half the errors of sensors and map", AmplitudeScales(sensors_ratio=0.5)),
    _scaled_set("sensors-doubled", "with twice the errors of sensors and map", AmplitudeScales(sensors_ratio=2.0)),
    _scaled_set("roughness-halved", "on roads half as uneven", AmplitudeScales(roughness_ratio=0.5)),
    _scaled_set("roughness-doubled", "on roads twice as uneven", AmplitudeScales(roughness_ratio=2.0)),
)

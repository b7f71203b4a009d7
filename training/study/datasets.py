"""The data sets of the study: which design, how large, with which drivers and cars."""

from __future__ import annotations

from dataclasses import dataclass

from training.designs import Size
from vehicle_client.simulator.plan import DriverKind


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
    """

    name: str
    design: str
    size: Size
    quick_size: Size
    purpose: str
    driver_kind: DriverKind = DriverKind.PRUDENT
    seed: int = 1


DATA_SETS: tuple[DataSet, ...] = (
    DataSet(
        name="paper",
        design="paper",
        size=Size(1000),
        quick_size=Size(40),
        purpose="the paper's matrix: four scenarios, 11 base frictions, prudent drivers, the paper's car",
    ),
    DataSet(
        name="paper-reacting",
        design="paper",
        size=Size(250),
        quick_size=Size(20),
        driver_kind=DriverKind.REACTING,
        purpose="the same by drivers who only react to what they feel",
    ),
    DataSet(
        name="paper-fleet",
        design="varied-vehicles",
        size=Size(500),
        quick_size=Size(20),
        purpose="the same with another vehicle in every run",
    ),
    DataSet(
        name="manoeuvres",
        design="manoeuvres",
        size=Size(60),
        quick_size=Size(8),
        purpose="extreme manoeuvres at base frictions 0.2 to 1.0, never learned from",
    ),
    DataSet(
        name="random-roads",
        design="random-roads",
        size=Size(1, random_roads_count=1500),
        quick_size=Size(1, random_roads_count=100),
        seed=2,
        purpose="random roads, one vehicle per base friction on each",
    ),
    DataSet(
        name="random-roads-fleet",
        design="random-roads-fleet",
        size=Size(1, random_roads_count=1500),
        quick_size=Size(1, random_roads_count=100),
        seed=2,
        purpose="the same roads with another vehicle in every run",
    ),
)

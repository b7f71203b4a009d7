"""Cars with a life: each drives everyday roads, learns what its sensors and tyres are like, and is then judged.

Eleven cars are driven together: over everyday roads one after the other, all of them on each; then over eleven roads
that are judged, so that every car meets every road and every base friction once, and every road all cars and all
frictions (a Latin square). Group and roads belong together: who holds out a road holds out the cars, too.

One drive is told in several ways, by what is declared of the car: exactly, or every constant ten per cent too large or
too small; and by what the car has learned of itself until then. So all ways of telling are judged on the same drives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import TypeAlias

import numpy as np

from roadgrip.features import NEWEST_TABLE, road_features
from roadgrip.section import RoadSection
from training.cars import CARS_COUNT, WRONG_RATIO, Car, Lives, cars_of
from training.chance import chance
from training.dataset import COMPLETED, LABEL_COLUMNS, Runs, joined
from training.designs import BASE_FRICTIONS_MU
from training.everyday import (
    BEST_COLUMN,
    EVERYDAY_COUNT,
    MATCHED_STD_RATIO,
    everyday_drives,
    grip_of,
    memory_of_new_car,
    plan_of,
    summarised,
    taught,
    terms_of,
)
from training.passage_rows import labels_of
from training.random_roads import random_section
from training.scenarios import Run, surveyed_map
from vehicle_client.estimation.grip.memory import CarMemory
from vehicle_client.estimation.handling import Handling
from vehicle_client.simulator.plan import DECLARED_NOISE
from vehicle_client.simulator.run import each_passage

FEW_COUNT = 5
_GRIP_COLUMNS = slice(BEST_COLUMN, len(NEWEST_TABLE.kinematic))
"""The grip features begin with the best friction and end what the vehicle tells."""


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
    cars, noise = cars_of(lives, group), DECLARED_NOISE[lives.grade]
    rough, exact = (
        [memory_of_new_car(lives.grade, handling_std_ratio=std) for _ in cars]
        for std in (WRONG_RATIO, MATCHED_STD_RATIO)
    )
    few = list(rough)
    for number in range(EVERYDAY_COUNT):
        if number == FEW_COUNT:
            few = list(rough)
        road_map, drives = everyday_drives(lives, cars, group, number)
        for place, (car, drive) in enumerate(zip(cars, drives, strict=True)):
            passage = summarised(car, drive, road_map, noise, exact[place])
            if isinstance(passage, str):
                continue
            mu = passage.summary.values[BEST_COLUMN]
            exact[place] = taught(car.matched, car, passage, exact[place], noise, friction_mu=mu)
            mu = float(grip_of(car.wrong, car, passage, noise, rough[place])[0])
            rough[place] = taught(car.wrong, car, passage, rough[place], noise, friction_mu=mu)
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
    road, road_map = road_features(section), surveyed_map(terms_of(lives), section)
    plans = []
    for place, car in enumerate(cars):
        base_mu = BASE_FRICTIONS_MU[(place + number) % CARS_COUNT]
        rng = chance(lives.seed, f"{car.name}|judged {number}")
        plans.append(plan_of(rng, lives, car, section, base_friction_mu=base_mu))
    rows, words, labels = [], [], []
    for place, (car, drive) in enumerate(zip(cars, each_passage(section, plans), strict=True)):
        run = Run(f"{car.name}/{number:02d}", place, drive.plan, car.geometry, car.matched)
        passage = summarised(car, drive, road_map, noise, None)
        for telling, (handling, memory) in known[place].items():
            values = np.full(len(NEWEST_TABLE), np.nan)
            outcome = passage if isinstance(passage, str) else COMPLETED
            if not isinstance(passage, str):
                values = np.concatenate([passage.summary.values, road])
                values[_GRIP_COLUMNS] = grip_of(handling, car, passage, noise, memory)
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

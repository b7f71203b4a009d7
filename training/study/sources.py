"""Where the data sets of the study come from: designs that are driven once, and again after an edit of what drives."""

from __future__ import annotations

import fcntl
import hashlib
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from roadgrip.errors import ConfigurationError
from roadgrip.features import FEATURE_NAMES
from training.cars import Garage, Lives
from training.dataset import LABEL_COLUMNS, RUNS_FILE_NAME, DatasetError, Runs, read_description
from training.designs import BASE_FRICTIONS_MU, named_design
from training.life_simulation import is_lived, live, lives_description
from training.machine import origin_of_drives
from training.scenarios import Design, Scenario, Terms, attempted
from training.simulation import GARAGE_FOLDER_NAME, Progress, design_description, drive_design
from training.study.datasets import DATA_SETS, GARAGE_GROUPS_COUNT, GARAGE_QUICK_GROUPS_COUNT, Cars, DataSet
from vehicle_client.simulator.plan import SensorGrade

USUAL_SEED = 1


class Source(Protocol):
    """Gives data sets by name."""

    def digest(self, name: str, grade: SensorGrade) -> str:
        """Return what changes with the data set, without making it."""
        ...

    def is_there(self, name: str, grade: SensorGrade) -> bool:
        """Return whether the data set needs no driving."""
        ...

    def runs(self, name: str, grade: SensorGrade, on_progress: Callable[[int, int], None]) -> Runs:
        """Return the data set, made now if need be; tells how many runs are done, of how many."""
        ...


class DesignSource:
    """The data sets of the study, driven into folders."""

    def __init__(self, folder: Path, *, quick: bool, seed: int, workers_count: int | None = None) -> None:
        """Keep the data sets in a folder.

        Args:
            folder: Made when the first of them is driven.
            quick: Whether the small sizes are wanted.
            seed: Of the study; another one drives other runs.
            workers_count: Processes; as many as there are processors if None.
        """
        self._folder = folder
        self._quick = quick
        self._seed = seed
        self._workers_count = workers_count
        self._designs: dict[tuple[str, SensorGrade], Design] = {}

    def digest(self, name: str, grade: SensorGrade) -> str:
        """Return what changes with the design and with the code that drives it: both fix every run."""
        lives = self.lives(name, grade)
        description = design_description(self.design(name, grade)) if lives is None else lives_description(lives)
        described = json.dumps(description, sort_keys=True)
        return hashlib.sha256(described.encode()).hexdigest()[:16]

    def is_there(self, name: str, grade: SensorGrade) -> bool:
        """Return whether the design is driven to its end, by the present code, or has nothing to drive."""
        lives = self.lives(name, grade)
        if lives is not None:
            return is_lived(lives, self.folder_of(name, grade) / RUNS_FILE_NAME)
        if not self.design(name, grade).scenarios:
            return True
        try:
            origin = read_description(self.folder_of(name, grade) / RUNS_FILE_NAME)
        except DatasetError:
            return False
        return design_description(self.design(name, grade)).items() <= origin.items()

    def runs(self, name: str, grade: SensorGrade, on_progress: Callable[[int, int], None]) -> Runs:
        """Return the runs of a data set, driven now as far as they are not there; none if it has no roads here."""
        lives = self.lives(name, grade)
        if lives is None and not self.design(name, grade).scenarios:
            return no_runs()
        folder = self.folder_of(name, grade)
        provenance = origin_of_drives(f"data set {name} of roadgrip-train study")

        def tell(now: Progress) -> None:
            on_progress(now.done_count, now.wanted_count)

        with _alone_in(folder):
            if lives is not None:
                return live(
                    lives, folder, workers_count=self._workers_count, provenance=provenance, on_progress=on_progress
                )
            return drive_design(
                self.design(name, grade),
                folder,
                workers_count=self._workers_count,
                garage_folder=self._folder / GARAGE_FOLDER_NAME,
                provenance=provenance,
                on_progress=tell,
            )

    def design(self, name: str, grade: SensorGrade) -> Design:
        """Return the design of a data set, at the size that is wanted."""
        if (name, grade) not in self._designs:
            self._designs[name, grade] = self._new_design(name, grade)
        return self._designs[name, grade]

    def lives(self, name: str, grade: SensorGrade) -> Lives | None:
        """Return the lives of a data set's cars, at the size that is wanted; None if it is a design's."""
        wanted = data_set(name)
        if wanted.lives is None:
            return None
        size = wanted.quick_size if self._quick else wanted.size
        seed = wanted.seed + self._seed - USUAL_SEED
        return Lives(wanted.design, seed, grade, size.runs_count, wanted.lives is Cars.FLEET)

    def folder_of(self, name: str, grade: SensorGrade) -> Path:
        """Return where a data set lies."""
        words = [name, grade.value]
        words += ["quick"] if self._quick else []
        words += [f"seed{self._seed}"] if self._seed != USUAL_SEED else []
        return self._folder / "-".join(words)

    def _new_design(self, name: str, grade: SensorGrade) -> Design:
        wanted = data_set(name)
        seed = wanted.seed + self._seed - USUAL_SEED
        terms = Terms(wanted.design, seed, grade, wanted.driver_kind, wanted.scales)
        size = wanted.quick_size if self._quick else wanted.size
        if wanted.sections is None:
            design = named_design(wanted.design, terms, size)
            garage = self._garage(wanted, grade, varied_vehicles=any(s.varied_vehicles for s in design.scenarios))
            return replace(design, terms=replace(terms, garage=garage))
        terms = replace(terms, garage=self._garage(wanted, grade, varied_vehicles=False))
        roads = (Scenario(road.section_id, road, attempted(size.runs_count)) for road in wanted.sections())
        return Design(terms, tuple(roads), BASE_FRICTIONS_MU)

    def _garage(self, wanted: DataSet, grade: SensorGrade, *, varied_vehicles: bool) -> Garage:
        groups_count = GARAGE_QUICK_GROUPS_COUNT if self._quick else GARAGE_GROUPS_COUNT
        # Exact sensors leave nothing to remember; the cars are the same.
        learned = wanted.remembering and grade is SensorGrade.AUTOMOTIVE
        return Garage(groups_count, groups_count if learned else 0, varied_vehicles=varied_vehicles)


def no_runs() -> Runs:
    """Return a table without a row."""
    return Runs(
        features=np.empty((0, len(FEATURE_NAMES))),
        labels={name: np.empty(0) for name in LABEL_COLUMNS},
        scenario=(),
        section_id=(),
        outcome=(),
        run_key=(),
    )


def data_set(name: str) -> DataSet:
    """Return a data set of the study.

    Raises:
        ConfigurationError: There is none of that name.
    """
    for known in DATA_SETS:
        if known.name == name:
            return known
    raise ConfigurationError(f"no data set {name!r}; there are {', '.join(known.name for known in DATA_SETS)}")


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Wait until no other process drives into a folder: both parts of the study may be run side by side."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield

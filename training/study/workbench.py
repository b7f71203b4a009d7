"""What the chapters of the study work with: data sets driven once, arrays and results computed once.

What is kept says by which code it was computed and from which data sets. It is taken for current as long as neither
has changed: the function that computed it with all it reaches, the libraries, the designs with what drives them. So a
study that was killed goes on where it was, and an edit of one chapter computes that chapter again and nothing else.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from roadgrip.errors import RoadgripError
from training.code_identity import function_digest
from training.dataset import Runs
from training.study.chapter import Arrays, Chapter
from training.study.documents import document_of, result_of
from training.study.finding import Computed, Timing
from training.study.sources import DesignSource, Source
from vehicle_client.simulator.plan import SensorGrade

FORMAT = 1
"""Counts up when what is kept is kept in another way."""
LIBRARIES = ("numpy", "scipy", "xgboost-cpu", "scikit-learn", "optuna")
CACHE_FOLDER_NAME = "cache"
_RECORD = "__record__"

Reads = dict[str, str]
"""Digest of each data set that something was computed from, by "name grade"."""


@dataclass
class _Scope:
    """What is known of the computation under way.

    Attributes:
        reads: The data sets it has read.
        driving_wall_s: Time that went into making data sets.
        driving_cpu_s: The same over all threads and processes.
    """

    reads: Reads = field(default_factory=dict)
    driving_wall_s: float = 0.0
    driving_cpu_s: float = 0.0


class StudyWorkbench:
    """The workbench of a study: `training.study.chapter.Workbench`, with files behind it."""

    def __init__(
        self,
        work: Path,
        *,
        quick: bool = False,
        seed: int = 1,
        source: Source | None = None,
        on_report: Callable[[str, int, int], None] | None = None,
        code_of: Callable[[Callable[..., object]], str] | None = None,
    ) -> None:
        """Set a workbench up in a folder.

        Args:
            work: For data sets and caches; made if missing.
            quick: Whether a rough answer in minutes is wanted.
            seed: Seed from which every chance of the study follows.
            source: Where data sets come from; the study's designs, driven into the folder, if None.
            on_report: Is told how far a long computation is: what, how many done, of how many.
            code_of: Digest of the code that a function reaches; another one is for tests.
        """
        self._work = work
        self._quick = quick
        self._seed = seed
        self._source = source or DesignSource(work / "data", quick=quick, seed=seed)
        self._on_report = on_report
        self._code_of = code_of or reached_code_digest
        self._runs: dict[tuple[str, SensorGrade], Runs] = {}
        self._scope = _Scope()
        work.mkdir(parents=True, exist_ok=True)

    @property
    def quick(self) -> bool:
        """Whether a rough answer in minutes is wanted."""
        return self._quick

    @property
    def seed(self) -> int:
        """Seed from which every chance of the study follows."""
        return self._seed

    @property
    def folder(self) -> Path:
        """Where drives and caches lie."""
        return self._work

    def report(self, what: str, done_count: int, wanted_count: int) -> None:
        """Tell how far a long computation is."""
        if self._on_report is not None:
            self._on_report(what, done_count, wanted_count)

    def is_driven(self, name: str, grade: SensorGrade) -> bool:
        """Return whether a data set needs no driving."""
        return (name, grade) in self._runs or self._source.is_there(name, grade)

    def runs(self, name: str, grade: SensorGrade) -> Runs:
        """Return a data set of the study, driven now unless it is there."""
        self._scope.reads[f"{name} {grade.value}"] = self._source.digest(name, grade)
        if (name, grade) not in self._runs:
            what = f"data {name}, {grade.value} sensors"
            began = _clocks()
            self._runs[name, grade] = self._source.runs(name, grade, partial(self.report, what))
            took = _since(began)
            self._scope.driving_wall_s += took.wall_s
            self._scope.driving_cpu_s += took.cpu_s
        return self._runs[name, grade]

    def remembered(self, name: str, work: Callable[[], Arrays]) -> Arrays:
        """Return arrays that `work` computes, or those it computed before.

        They are computed again when the code that `work` reaches has changed, or a data set that was read by then. The
        name must hold everything else they depend on, such as the grade of the sensors.
        """
        code = self._key(work)
        path = self._path_of("arrays", name, ".npz")
        kept = _read_arrays(path)
        if kept is None or kept[1] != code or not self._current(kept[0]):
            computed = work()
            kept = (dict(self._scope.reads), code, {key: np.asarray(value) for key, value in computed.items()})
            _write_arrays(path, kept)
        self._scope.reads |= kept[0]
        return kept[2]

    def computed(self, chapter: Chapter, grade: SensorGrade) -> Computed:
        """Return what a chapter finds with one grade of sensors, computed now unless it is there and current."""
        kept = self.kept(chapter, grade)
        if kept is not None and not kept.stale:
            return kept
        code = self._key(chapter.compute)
        began = _clocks()
        with self._new_scope() as scope:
            result = chapter.compute(self, grade)
        took = _since(began)
        timing = Timing(took.wall_s - scope.driving_wall_s, max(0.0, took.cpu_s - scope.driving_cpu_s))
        document: dict[str, Any] = {
            "code": code,
            "reads": scope.reads,
            "timing": asdict(timing),
            "result": document_of(result),
        }
        _write_text(self._path_of("results", f"{chapter.name} {grade.value}", ".json"), json.dumps(document))
        # Read back, so that a first look and a later one show the same.
        return Computed(result_of(document["result"]), timing, code, dict(scope.reads))

    def kept(self, chapter: Chapter, grade: SensorGrade) -> Computed | None:
        """Return what a chapter found before, current or not; None if there is nothing."""
        document = _read_json(self._path_of("results", f"{chapter.name} {grade.value}", ".json"))
        if document is None:
            return None
        return Computed(
            result=result_of(document["result"]),
            timing=Timing(**document["timing"]),
            code_digest=document["code"],
            data=document["reads"],
            stale=document["code"] != self._key(chapter.compute) or not self._current(document["reads"]),
        )

    def _current(self, reads: Reads) -> bool:
        for key, digest in reads.items():
            name, _, grade = key.rpartition(" ")
            try:
                if self._source.digest(name, SensorGrade(grade)) != digest:
                    return False
            except (RoadgripError, LookupError, ValueError):  # a data set that there was then
                return False
        return True

    def _key(self, work: Callable[..., object]) -> str:
        return f"{self._code_of(work)}-{_libraries_digest()}"

    def _path_of(self, kind: str, name: str, suffix: str) -> Path:
        """Return a file of its own for each name, quickness and seed."""
        whole = f"{name}|{self._quick}|{self._seed}|{FORMAT}"
        readable = re.sub(r"[^a-zA-Z0-9]+", "-", name).strip("-")[:60]
        return (
            self._work
            / CACHE_FOLDER_NAME
            / kind
            / f"{readable}-{hashlib.sha256(whole.encode()).hexdigest()[:8]}{suffix}"
        )

    @contextmanager
    def _new_scope(self) -> Iterator[_Scope]:
        outer, self._scope = self._scope, _Scope()
        try:
            yield self._scope
        finally:
            self._scope = outer


def reached_code_digest(work: Callable[..., object]) -> str:
    """Return what changes with the code that a function, lambda, method or partial of one reaches."""
    if isinstance(work, partial):
        given = [*work.args, *(part for pair in sorted(work.keywords.items()) for part in pair)]
        words = [reached_code_digest(work.func), *(_identity(value) for value in given)]
        return hashlib.sha256("\n".join(words).encode()).hexdigest()[:16]
    named = work if hasattr(work, "__qualname__") else type(work)
    top = str(named.__qualname__).split(".", 1)[0]
    return function_digest(named.__module__, top)


def _identity(value: object) -> str:
    """Return what an argument is, as text that is the same in the next process."""
    return reached_code_digest(value) if callable(value) else repr(value)


@cache
def _libraries_digest() -> str:
    found = []
    for library in LIBRARIES:
        try:
            found.append(f"{library} {version(library)}")
        except PackageNotFoundError:
            found.append(library)
    return hashlib.sha256("\n".join(found).encode()).hexdigest()[:8]


def _clocks() -> Timing:
    now = os.times()
    return Timing(time.monotonic(), now.user + now.system + now.children_user + now.children_system)


def _since(began: Timing) -> Timing:
    now = _clocks()
    return Timing(now.wall_s - began.wall_s, now.cpu_s - began.cpu_s)


def _read_arrays(path: Path) -> tuple[Reads, str, Arrays] | None:
    """Return what was kept; None where there is nothing, or something that a power failure cut short."""
    try:
        # Opened here: numpy leaves a file open that it cannot read.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as kept:
            record = json.loads(str(kept[_RECORD]))
            return record["reads"], record["code"], {name: kept[name] for name in kept.files if name != _RECORD}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _write_arrays(path: Path, kept: tuple[Reads, str, Mapping[str, Any]]) -> None:
    reads, code, arrays = kept
    path.parent.mkdir(parents=True, exist_ok=True)
    partial_path = path.with_suffix(".partial")
    with partial_path.open("wb") as file:
        everything: dict[str, Any] = {_RECORD: np.array(json.dumps({"reads": reads, "code": code})), **arrays}
        np.savez(file, **everything)
    partial_path.replace(path)


def _read_json(path: Path) -> dict[str, Any] | None:
    try:
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return document


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial_path = path.with_suffix(".partial")
    partial_path.write_text(text, encoding="utf-8")
    partial_path.replace(path)

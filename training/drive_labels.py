"""What is said of recorded drives beside their traces: friction, section, whose interval, which car."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roadgrip.errors import ConfigurationError, TraceError
from training.dataset import RUNS_FILE_NAME, read_runs
from training.evaluation import check_label

LABELS_FILE_NAME = "labels.csv"
LABEL_COLUMN = "label_mu"
_COLUMNS = ("file", LABEL_COLUMN, "section", "group", "vehicle")


@dataclass(frozen=True, slots=True)
class Told:
    """What is said of a drive beside its trace.

    Attributes:
        label_mu: Friction its tyres found; None where nobody says.
        section_id: Where it was; empty where nobody says.
        group: Whose interval it belongs to.
        vehicle: Path of the car's file, relative to the folder; empty where nobody says.
    """

    label_mu: float | None = None
    section_id: str = ""
    group: str = ""
    vehicle: str = ""


def told_of(told: Mapping[str, Told], *names: str) -> Told:
    """Return what is said under the first of the names that something is said under."""
    return next((told[name] for name in names if name in told), Told())


def labels_of_runs(folder: Path) -> dict[str, Told]:
    """Return what the table of a simulated design says of its drives, by their keys; nothing where there is no table.

    Raises:
        DatasetError: The table is none.
    """
    path = folder / RUNS_FILE_NAME
    if not path.is_file():
        return {}
    runs = read_runs(path)
    labels, base = runs.labels[LABEL_COLUMN], runs.labels["base_friction_mu"]
    return {
        key: Told(
            label_mu=float(labels[i]) if np.isfinite(labels[i]) else None,
            section_id=runs.section_id[i],
            group=f"base friction {base[i]:.2f}",
        )
        for i, key in enumerate(runs.run_key)
    }


def labels_of_csv(folder: Path, files: tuple[Path, ...] | None) -> dict[str, Told]:
    """Return what `labels.csv` says of drives, by the names of files or drives; nothing where there is no such file.

    Args:
        folder: Where it may lie.
        files: Those it may name; None if it may name others too.

    Raises:
        ConfigurationError: It cannot be read, names a file that is not there, or a label that is no friction.
    """
    path = folder / LABELS_FILE_NAME
    if not path.is_file():
        return {}
    rows = csv.DictReader(io.StringIO(text_of(path), newline=""), skipinitialspace=True)
    header = [name.strip() for name in rows.fieldnames or []]
    rows.fieldnames = header
    unknown = sorted(set(header) - set(_COLUMNS))
    if "file" not in header or unknown:
        problem = "has no column file" if "file" not in header else f"has unknown columns {', '.join(unknown)}"
        raise ConfigurationError(f"{path} {problem}; it may hold {', '.join(_COLUMNS)}, comma-separated")
    there = None if files is None else {file.relative_to(folder).as_posix() for file in files}
    told: dict[str, Told] = {}
    for row in rows:
        cells = {key: (value or "").strip() for key, value in row.items() if isinstance(key, str)}
        name, place = cells["file"], f"{path}, line {rows.line_num}"
        if name in told:
            raise ConfigurationError(f"{place}: {name} is named twice")
        if there is not None and name.split("#", 1)[0] not in there:
            raise ConfigurationError(f"{place}: there is no table {name!r} in {folder}")
        told[name] = Told(
            label_mu=_number(cells.get(LABEL_COLUMN, ""), place=place),
            section_id=cells.get("section", ""),
            group=cells.get("group", ""),
            vehicle=cells.get("vehicle", ""),
        )
    return told


def _number(cell: str, *, place: str) -> float | None:
    if not cell:
        return None
    try:
        number = float(cell)
        check_label(number, subject=place)
    except ValueError as error:
        raise ConfigurationError(f"{place}: label_mu is {cell!r}, not a number") from error
    except TraceError as error:
        raise ConfigurationError(str(error)) from error
    return number


def text_of(path: Path) -> str:
    """Return the text of a file.

    Raises:
        ConfigurationError: It cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error

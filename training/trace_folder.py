"""A folder of recorded drives: tables in our own columns or in somebody else's, with what is said of them beside.

    drives/
      anything.csv            a drive; .csv.gz and .parquet too, in folders of their own if there are many
      labels.csv              optional: file, label_mu, section, group, vehicle
      sections/*.json         optional: the maps
      vehicle.toml            optional: the car

A Parquet file with a column `run_key` holds one drive per key; `roadgrip-train simulate --raw` writes such, and its
table `runs.parquet` tells their labels. docs/evaluate.md says what every column means.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from roadgrip.errors import ConfigurationError, RoadgripError, TraceError
from roadgrip.section import RoadSection
from roadgrip.sections import read_section
from roadgrip.units import FloatArray
from training.dataset import RUNS_FILE_NAME, SHARDS_FOLDER_NAME
from training.drive_labels import LABEL_COLUMN, LABELS_FILE_NAME, Told, labels_of_csv, labels_of_runs, text_of, told_of
from training.evaluation import RecordedDrive, check_label
from training.reference_drives import MAPPINGS, ReferenceFormat
from vehicle_client.estimation.trace import Trace
from vehicle_client.recording.channels import CHANNELS, TIME_COLUMN
from vehicle_client.recording.csv_table import columns_of_csv
from vehicle_client.recording.foreign import recording_of_columns
from vehicle_client.recording.own_columns import trace_of_columns
from vehicle_client.recording.series import trace_of_series
from vehicle_client.recording.signal_mapping import SignalMapping, signal_mapping_of_toml
from vehicle_client.recording.table_series import series_of_columns
from vehicle_client.vehicle_profile import PAPER_VEHICLE, VehicleProfile, profile_of_toml

SECTIONS_FOLDER_NAME = "sections"
VEHICLE_FILE_NAME = "vehicle.toml"
KEY_COLUMN = "run_key"
TRUE_PREFIX = "true_"
"""What was so, and no sensor told: nothing here may look at it."""
TRACE_SUFFIXES = (".csv", ".csv.gz", ".parquet")
STEP_LIMIT_S = 0.051
"""Rows may come so seldom: 20 a second are enough for what the features hold, 100 are asked for."""


@dataclass(frozen=True, slots=True)
class ReadAs:
    """How the tables of a folder are to be read.

    Attributes:
        recorded_as: Whose columns they have; does not matter with `mapping`.
        mapping: What their columns mean, if they have names of their own.
        vehicle: The car, where a drive does not name its own.
    """

    recorded_as: ReferenceFormat = ReferenceFormat.ROADGRIP
    mapping: SignalMapping | None = None
    vehicle: VehicleProfile = PAPER_VEHICLE


def read_as(*, recorded_as: ReferenceFormat = ReferenceFormat.ROADGRIP, signals: Path | None = None) -> ReadAs:
    """Return how tables are read, and the car that goes with that.

    Args:
        recorded_as: Whose recordings they are.
        signals: Path of a `signals.toml`, if their columns have names or units of their own.

    Raises:
        ConfigurationError: A file cannot be read, or is for CAN logs.
    """
    if signals is not None:
        mapping = read_mapping(signals)
        car = read_vehicle(signals.parent / mapping.vehicle) if mapping.vehicle else PAPER_VEHICLE
        return ReadAs(mapping=mapping, vehicle=car)
    if recorded_as is ReferenceFormat.ROADGRIP:
        return ReadAs()
    known = VehicleProfile(name=recorded_as.value, geometry=MAPPINGS[recorded_as].vehicle)
    return ReadAs(recorded_as=recorded_as, vehicle=known)


@dataclass(frozen=True, slots=True)
class TraceFolder:
    """A folder of recorded drives, before any of them is read.

    Attributes:
        folder: The folder, or a single file's.
        files: The tables.
        told: What is said of drives, by the name of a drive or of a file.
        sections: The maps that came with them, by id.
        reading: How to read them.
        only_told: Whether of drives with keys only those count that something is said of: a simulated design is driven
            a little beyond what it asks for.
    """

    folder: Path
    files: tuple[Path, ...]
    told: Mapping[str, Told] = field(default_factory=dict)
    sections: tuple[RoadSection, ...] = ()
    reading: ReadAs = field(default_factory=ReadAs)
    only_told: bool = False


def open_folder(place: Path, reading: ReadAs | None = None, *, vehicle: Path | None = None) -> TraceFolder:
    """Return what a folder of drives, or a single file, holds.

    Args:
        place: The folder, or one table.
        reading: How to read the tables; in our own columns if None.
        vehicle: The car's file; the folder's own if None, and what goes with `reading` if there is none.

    Raises:
        ConfigurationError: There is no table, or what is said of drives cannot be used.
        SectionError: One of its section files is none.
    """
    if not place.exists():
        raise ConfigurationError(f"no folder or file {place}")
    folder = place if place.is_dir() else place.parent
    files = tuple(_tables_in(folder)) if place.is_dir() else (place,)
    if not files:
        raise ConfigurationError(f"no recorded drives in {place}: a table ends in {', '.join(TRACE_SUFFIXES)}")
    designed = labels_of_runs(folder)
    told = designed | labels_of_csv(folder, files if place.is_dir() else None)
    sections = tuple(read_section(path) for path in sorted((folder / SECTIONS_FOLDER_NAME).glob("*.json")))
    own = folder / VEHICLE_FILE_NAME
    reading = reading or ReadAs()
    car = vehicle or (own if own.is_file() else None)
    if car is not None:
        reading = replace(reading, vehicle=read_vehicle(car))
    return TraceFolder(folder, files, told, sections, reading, only_told=bool(designed))


def read_mapping(path: Path) -> SignalMapping:
    """Return what a file says of somebody else's columns.

    Raises:
        ConfigurationError: It cannot be read, or is for CAN logs.
    """
    mapping = signal_mapping_of_toml(text_of(path), place=str(path))
    if not mapping.time_column:
        raise ConfigurationError(
            f"{path} names a dbc, which goes with CAN logs; `roadgrip-vehicle replay` reads those. A table needs a "
            "time_column"
        )
    return mapping


def read_vehicle(path: Path) -> VehicleProfile:
    """Return the car that a file describes.

    Raises:
        ConfigurationError: It cannot be read, or something in it is not allowed.
    """
    return profile_of_toml(text_of(path), place=str(path))


def drives_of(file: Path, source: TraceFolder) -> Iterator[RecordedDrive | tuple[str, str]]:
    """Return the drives of one table, one after another; of one that cannot be used its name, and why.

    Args:
        file: One of `source.files`.
        source: The folder.
    """
    name = file.relative_to(source.folder).as_posix()
    try:
        tables = _tables_of(file, name)
    except (RoadgripError, OSError) as error:
        yield name, _without_name(str(error), name, file.name)
        return
    for key, columns in tables:
        if key and source.only_told and key not in source.told:
            continue
        drive = f"{name}#{key}" if key else name
        try:
            yield _drive(drive, columns, source, told=told_of(source.told, drive, key, name))
        except (TraceError, ConfigurationError) as error:
            yield drive, _without_name(str(error), drive, file.name)


def _drive(name: str, columns: Mapping[str, FloatArray], source: TraceFolder, *, told: Told) -> RecordedDrive:
    reading = source.reading
    trace, time_column = _trace(name, columns, reading)
    vehicle = read_vehicle(source.folder / told.vehicle) if told.vehicle else reading.vehicle
    friction = None
    if told.label_mu is not None:
        check_label(told.label_mu, subject=name)
        friction = np.full(trace.samples_count, told.label_mu)
    elif LABEL_COLUMN in columns:
        friction = _friction(columns[time_column], columns[LABEL_COLUMN], trace.time_s, name=name)
    return RecordedDrive(
        name=name,
        trace=trace,
        vehicle=vehicle,
        friction_mu=friction,
        section_id=told.section_id,
        group=told.group,
        step_s=_step_s(columns[time_column]),
    )


def _trace(name: str, columns: Mapping[str, FloatArray], reading: ReadAs) -> tuple[Trace, str]:
    """Return the trace, and which column its time is."""
    if reading.mapping is not None:
        column = reading.mapping.time_column
        series = series_of_columns(columns, reading.mapping, place=name)
        _check_rate(columns[column], name=name, column=column)
        return trace_of_series(series, missing=reading.mapping.missing).trace, column
    if reading.recorded_as is not ReferenceFormat.ROADGRIP:
        mapping = MAPPINGS[reading.recorded_as]
        recording = recording_of_columns(columns, mapping, place=name)
        _check_rate(columns[mapping.time_column], name=name, column=mapping.time_column)
        return recording.trace, mapping.time_column
    absent = [needed for needed in (TIME_COLUMN, *CHANNELS) if needed not in columns]
    if absent:
        there = ", ".join(columns) or "no column of numbers"
        raise TraceError(
            f"no column {', '.join(absent)}; there are {there:.400}. Other names and units are read with --signals FILE"
        )
    _check_rate(columns[TIME_COLUMN], name=name, column=TIME_COLUMN)
    return trace_of_columns(columns, place=name), TIME_COLUMN


def _step_s(time_s: FloatArray) -> float:
    """Return the usual time between two rows; NaN of fewer than two."""
    steps = np.diff(time_s[np.isfinite(time_s)])
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if len(steps) else float("nan")


def _check_rate(time_s: FloatArray, *, name: str, column: str) -> None:
    step_s = _step_s(time_s)
    if step_s > STEP_LIMIT_S:
        raise TraceError(
            f"{name}: by {column} its rows come every {step_s:g} s; 100 a second are asked for, 20 are the least. Is "
            f"{column} in seconds?"
        )


def _friction(time_s: FloatArray, label_mu: FloatArray, at_s: FloatArray, *, name: str) -> FloatArray | None:
    """Return a column of labels on the samples of the trace; None where it is empty. (n,)"""
    told = np.isfinite(label_mu) & np.isfinite(time_s)
    if not told.any():
        return None
    for extreme in (float(label_mu[told].min()), float(label_mu[told].max())):
        check_label(extreme, subject=name)
    return np.interp(at_s, time_s[told], label_mu[told])


def _tables_in(folder: Path) -> Iterator[Path]:
    """Return the tables of a folder and of those within, but for what is no drive."""
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in inside.parts)
        if hidden or not path.name.lower().endswith(TRACE_SUFFIXES) or not path.is_file():
            continue
        if inside.name in {LABELS_FILE_NAME, RUNS_FILE_NAME} or inside.parts[0] == SHARDS_FOLDER_NAME:
            continue
        yield path


def _tables_of(file: Path, name: str) -> list[tuple[str, dict[str, FloatArray]]]:
    """Return the columns of numbers of every drive in a file, by its key; an empty key where there is but one."""
    if not file.name.lower().endswith(".parquet"):
        return [("", columns_of_csv(file.read_bytes(), place=name))]
    try:
        table: Any = pq.read_table(file)
    except pa.ArrowInvalid as error:
        raise TraceError(f"{name} is no Parquet file: {error}") from error
    numeric = (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean)
    columns = {
        column: table[column].cast(pa.float64()).to_numpy().astype(np.float64)
        for column in table.column_names
        if any(kind(table[column].type) for kind in numeric) and not column.startswith(TRUE_PREFIX)
    }
    if KEY_COLUMN not in table.column_names:
        return [("", columns)]
    keys = np.array([str(key) for key in table[KEY_COLUMN].to_pylist()])
    starts = np.concatenate([[0], np.flatnonzero(keys[1:] != keys[:-1]) + 1, [len(keys)]]) if len(keys) else [0]
    return [(str(keys[a]), {name: values[a:b] for name, values in columns.items()}) for a, b in pairwise(starts)]


def _without_name(message: str, *names: str) -> str:
    """Return a message without the name of the file in front, which stands beside it anyway."""
    for name in names:
        message = message.removeprefix(f"{name}: ")
    return message

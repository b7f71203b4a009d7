"""Recorded drives on disk: our own columns, other people's, CAN logs; what a file is, its name says."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from roadgrip.errors import ConfigurationError, TraceError
from vehicle_client.recording.csv_table import columns_of_csv, csv_of_columns
from vehicle_client.recording.foreign import recording_of_columns
from vehicle_client.recording.own_columns import columns_of_trace, trace_of_columns
from vehicle_client.recording.series import trace_of_series
from vehicle_client.recording.table_series import series_of_columns
from vehicle_client.vehicle_profile import PAPER_VEHICLE, VehicleProfile, profile_of_toml

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from roadgrip.units import FloatArray
    from vehicle_client.estimation.trace import Trace
    from vehicle_client.recording.foreign import ColumnMapping, Recording
    from vehicle_client.recording.series import Aligned
    from vehicle_client.recording.signal_mapping import SignalMapping

TABLE_SUFFIXES = (".csv", ".csv.gz", ".parquet")
TRACE_SUFFIXES = (*TABLE_SUFFIXES, ".blf", ".asc", ".log", ".mf4")
"""What a trace can be written as."""


def nobody_watches(frames_count: int, time_s: float) -> None:
    """Do nothing about the progress of reading."""


@dataclass(frozen=True, slots=True)
class MappedRecording:
    """A drive that was read through `signals.toml`.

    Attributes:
        aligned: The channels on one grid, and what each of them is worth.
        mapping: What the file says.
        vehicle: The car, by the file that the mapping names; the car of the paper if it names none.
    """

    aligned: Aligned
    mapping: SignalMapping
    vehicle: VehicleProfile


def read_columns(path: Path) -> dict[str, FloatArray]:
    """Return the columns of a CSV or Parquet file. Each (n,)

    Raises:
        TraceError: A cell is no number; the message says where.
        OSError: The file cannot be read.
        ModuleNotFoundError: Parquet needs pyarrow.
    """
    if path.suffix.lower() == ".parquet":
        return _columns_of_parquet(path)
    return columns_of_csv(path.read_bytes(), place=path.name)


def read_trace_csv(path: Path) -> Trace:
    """Return the trace of a CSV or Parquet file in our own format.

    Raises:
        TraceError: A column is missing, a cell is no number, time runs backwards; the message says where.
        OSError: The file cannot be read.
    """
    return trace_of_columns(read_columns(path), place=path.name)


def write_trace_csv(path: Path, trace: Trace) -> None:
    """Write a trace in our own format; reading it back gives the same numbers to the last bit.

    Raises:
        OSError: The file cannot be written.
    """
    data = csv_of_columns(columns_of_trace(trace))
    # Without a time stamp inside, the same trace gives the same file.
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)


def write_trace(path: Path, trace: Trace) -> None:
    """Write a trace as what the file's name says: .csv, .csv.gz, .parquet, or a CAN log of a made-up car.

    CAN logs are written by the packaged example (`--signals example` reads them back): a few bits are lost, and
    positions that the trace has not are left out.

    Raises:
        ConfigurationError: The name says nothing we can write.
        OSError: The file cannot be written.
        ModuleNotFoundError: .parquet and .mf4 need the extra `vehicle-files`.
    """
    name = path.name.lower()
    if not name.endswith(TRACE_SUFFIXES):
        raise ConfigurationError(f"{path}: a trace is written as one of {', '.join(TRACE_SUFFIXES)}")
    if name.endswith((".csv", ".csv.gz")):
        write_trace_csv(path, trace)
    elif name.endswith(".parquet"):
        _write_parquet(path, columns_of_trace(trace))
    else:
        from vehicle_client.shell.can.description import EXAMPLE, path_of_signals, read_can_mapping
        from vehicle_client.shell.can.written import write_log

        write_log(path, trace, read_can_mapping(path_of_signals(EXAMPLE)))


def read_recording(path: Path, mapping: ColumnMapping) -> Recording:
    """Return a drive that somebody else recorded, in CSV or Parquet.

    Raises:
        TraceError: A column is missing, a cell is no number, time runs backwards; the message says where.
        OSError: The file cannot be read.
    """
    return recording_of_columns(read_columns(path), mapping, place=path.name)


def read_mapped(path: Path, signals: str, *, watch: Callable[[int, float], None] = nobody_watches) -> MappedRecording:
    """Return a drive that was recorded as a CAN log, or as a table with names of its own, by a file `signals.toml`.

    Args:
        path: .blf, .asc, .log, .mf4 if the mapping names a DBC; .csv, .csv.gz, .parquet if it names a time column.
        signals: Path of the mapping; `example` for the packaged one.
        watch: Told now and then how many frames are read, and the time stamp of the last.

    Raises:
        ConfigurationError: A file cannot be read, or they do not fit each other.
        TraceError: The recording lacks what the mapping asks for, or its clock was set back.
        ModuleNotFoundError: .parquet and .mf4 need the extra `vehicle-files`.
    """
    from vehicle_client.shell.can.description import can_mapping_at, path_of_signals, read_signals
    from vehicle_client.shell.can.log_names import LOG_SUFFIXES, is_log
    from vehicle_client.shell.can.logs import read_log

    place = path_of_signals(signals)
    mapping = read_signals(place)
    if is_log(path) != bool(mapping.dbc):
        what = (
            "names a dbc, which goes with a CAN log" if mapping.dbc else "names a time_column, which goes with a table"
        )
        raise ConfigurationError(f"{signals} {what} ({', '.join(LOG_SUFFIXES)} are CAN logs); {path.name} is not such")
    if mapping.dbc:
        series = read_log(path, can_mapping_at(mapping, place), watch=watch)
    else:
        try:
            series = series_of_columns(read_columns(path), mapping, place=path.name)
        except OSError as error:
            raise ConfigurationError(f"cannot read {path}: {error.strerror or error}") from error
    try:
        aligned = trace_of_series(series, missing=mapping.missing)
    except TraceError as error:
        raise TraceError(f"{path.name}: {error}") from error
    vehicle = read_vehicle(place.parent / mapping.vehicle) if mapping.vehicle else PAPER_VEHICLE
    return MappedRecording(aligned=aligned, mapping=mapping, vehicle=vehicle)


def read_vehicle(path: Path) -> VehicleProfile:
    """Return the car that a file describes.

    Raises:
        ConfigurationError: It cannot be read, or something in it is not allowed.
    """
    try:
        return profile_of_toml(path.read_text(encoding="utf-8"), place=str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read {path}: {error}") from error


def _columns_of_parquet(path: Path) -> dict[str, FloatArray]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table: Any = pq.read_table(path)
        columns = {name: table.column(name) for name in table.column_names}
        return {
            name: column.cast(pa.float64()).to_numpy().astype(float)
            for name, column in columns.items()
            if pa.types.is_floating(column.type) or pa.types.is_integer(column.type) or pa.types.is_boolean(column.type)
        }
    except pa.ArrowInvalid as error:
        raise TraceError(f"{path.name} is no Parquet file: {error}") from error


def _write_parquet(path: Path, columns: Mapping[str, FloatArray]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(dict(columns)), path)

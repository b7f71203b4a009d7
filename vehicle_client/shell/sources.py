"""Recorded drives on disk: our own format, and other people's through a mapping of columns."""

from __future__ import annotations

import gzip
from typing import TYPE_CHECKING

from vehicle_client.recording.csv_table import columns_of_csv, csv_of_columns
from vehicle_client.recording.foreign import recording_of_columns
from vehicle_client.recording.own_columns import columns_of_trace, trace_of_columns

if TYPE_CHECKING:
    from pathlib import Path

    from vehicle_client.estimation.trace import Trace
    from vehicle_client.recording.foreign import ColumnMapping, Recording


def read_trace_csv(path: Path) -> Trace:
    """Return the trace of a file in our own format.

    Raises:
        TraceError: A column is missing, a cell is no number, time runs backwards; the message says where.
        OSError: The file cannot be read.
    """
    return trace_of_columns(columns_of_csv(path.read_bytes(), place=path.name), place=path.name)


def write_trace_csv(path: Path, trace: Trace) -> None:
    """Write a trace in our own format; reading it back gives the same numbers to the last bit.

    Raises:
        OSError: The file cannot be written.
    """
    data = csv_of_columns(columns_of_trace(trace))
    # Without a time stamp inside, the same trace gives the same file.
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)


def read_recording(path: Path, mapping: ColumnMapping) -> Recording:
    """Return a drive that somebody else recorded.

    Raises:
        TraceError: A column is missing, a cell is no number, time runs backwards; the message says where.
        OSError: The file cannot be read.
    """
    return recording_of_columns(columns_of_csv(path.read_bytes(), place=path.name), mapping, place=path.name)

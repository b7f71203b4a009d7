"""Columns with names of somebody else's as series of our channels, by a signal mapping."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import ConfigurationError, TraceError
from vehicle_client.recording.channels import STABILITY_CHANNELS
from vehicle_client.recording.series import Series
from vehicle_client.recording.signal_mapping import meant

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.recording.signal_mapping import SignalMapping, SignalSource, Word


def series_of_columns(columns: Mapping[str, FloatArray], mapping: SignalMapping, *, place: str) -> dict[str, Series]:
    """Return our channels of a table.

    An empty cell is no value at all, as if a message had not come; a value that is listed as invalid is one that the
    car did not know.

    Args:
        columns: All (n,); NaN where a cell is empty.
        mapping: With a time column.
        place: What the table is called, for messages.

    Raises:
        ConfigurationError: The mapping names a column that is not there, or names values, which only a DBC has.
        TraceError: Time runs backwards.
    """
    time_s = _column(columns, mapping.time_column, place=f"{mapping.place} time_column", table=place)
    known = np.isfinite(time_s)
    back = np.flatnonzero(np.diff(time_s[known]) < 0.0)
    if len(back):
        raise TraceError(f"{place}: time runs backwards after {time_s[known][back[0]]:.3f} s")
    series = {}
    for source in mapping.sources:
        where = f"{mapping.place} [{source.table}]"
        theirs = _column(columns, source.signal, place=f"{where} column", table=place)
        there = known & np.isfinite(theirs)
        below = np.zeros(len(theirs), dtype=bool)
        if source.sign_signal:
            sign = _column(columns, source.sign_signal, place=f"{where} negative_when", table=place)
            below = _among(sign, source.negative_values, place=f"{where} negative_when")
            there &= np.isfinite(sign)
        values = _values(source, theirs, below=below, place=where)
        if source.valid_signal:
            told = _column(columns, source.valid_signal, place=f"{where} valid_when", table=place)
            values = np.where(_among(told, source.valid_values, place=f"{where} valid_when"), values, np.nan)
        series[source.channel] = Series(time_s[there] - source.delay_s, values[there])
    return series


def _values(source: SignalSource, theirs: FloatArray, *, below: BoolArray, place: str) -> FloatArray:
    """Return our values; NaN where the car does not know, `below` where another column says the sign is minus."""
    holds = ~_among(theirs, source.invalid, place=f"{place} invalid")
    if source.channel in STABILITY_CHANNELS:
        active = _among(theirs, source.active, place=f"{place} active") if source.active else theirs != 0.0
        return np.where(holds, active, np.nan)
    return np.where(holds, source.converted(np.where(below, -theirs, theirs)), np.nan)


def _column(columns: Mapping[str, FloatArray], name: str, *, place: str, table: str) -> FloatArray:
    if name not in columns:
        raise ConfigurationError(f"{place}: {table} has no column {name!r}{meant(name, columns)}")
    return columns[name]


def _among(values: FloatArray, words: tuple[Word, ...], *, place: str) -> BoolArray:
    named = [word for word in words if isinstance(word, str)]
    if named:
        raise ConfigurationError(f"{place}: {named[0]!r} is a name, which only a DBC knows; give the number")
    return np.asarray(np.isin(values, np.array([float(word) for word in words])), dtype=bool)

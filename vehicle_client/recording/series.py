"""Channels that come each with time stamps of their own, as CAN messages bring them, on the one grid of a trace.

Alignment. A value on the grid is interpolated between the neighbours of its own channel, so it needs the first value
*after* it: a loop that runs in a car knows a sample as soon as every channel has gone on, or has been silent for
`GAP_LIMIT_S`, and never later. That lag of a quarter of a second costs nothing, since a passage is summarised when it
is over, and it is why a drive gives the same trace live and from its log. Holding the last value instead would be at
hand at once, and late by half a step on average: at 50 values a second that is 10 ms, 0.3 m at motorway speed, and
different for each channel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.order_statistics import median
from roadgrip.records import QualityFlag
from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.trace import GnssTrack, Trace, check_trace
from vehicle_client.recording.channels import CHANNELS, GNSS_SPEED_COLUMN, STABILITY_CHANNELS
from vehicle_client.recording.own_columns import GNSS_ACCURACY_M
from vehicle_client.recording.resampling import DURATION_LIMIT_S, GAP_STEPS_COUNT, ON_GRID_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from roadgrip.units import BoolArray, FloatArray

GAP_LIMIT_S = 0.25
"""Whatever its rate: a channel that is silent for longer is not interpolated."""
FLAG_LIMIT_S = 1.0
"""A flag that nobody has repeated for so long no longer counts as set."""
_SAME_FIX_S = 0.05
"""Latitude and longitude of one fix may come in two messages so far apart."""
_FIX_DETAIL_LIMIT_S = 1.5
_STALE_FIX_S = 1.0
"""A position that is repeated to the last digit sooner than this is the old one again."""


@dataclass(frozen=True, slots=True)
class Series:
    """One channel of a recording.

    Attributes:
        time_s: In any order; one stamp may come more than once. (k,)
        values: In the channel's unit; NaN where the car says that it does not know. (k,)
    """

    time_s: FloatArray
    values: FloatArray


@dataclass(frozen=True, slots=True)
class SeriesCount:
    """What one channel is worth.

    Attributes:
        values_count: Values that came.
        repeated_count: Of them, those whose time stamp came again later; the last one holds.
        invalid_count: Of them, those that say there is none.
        step_s: Usual time between two of them; NaN for fewer than two.
        longest_gap_s: Longest time between two values that hold.
        lower: Smallest of the values that hold, in the channel's unit; NaN without any.
        upper: Largest of them.
    """

    values_count: int
    repeated_count: int
    invalid_count: int
    step_s: float
    longest_gap_s: float
    lower: float
    upper: float


@dataclass(frozen=True, slots=True)
class Aligned:
    """Channels on one grid.

    Attributes:
        trace: A sample is valid where every sensor is covered.
        covered: Per sensor, where it is known. Each (n,)
        counts: Per channel that came.
        missing: Sensors that the recording lacks and that read zero in the trace.
    """

    trace: Trace
    covered: Mapping[str, BoolArray]
    counts: Mapping[str, SeriesCount]
    missing: tuple[str, ...]


def trace_of_series(
    series: Mapping[str, Series], *, missing: tuple[str, ...] = (), quality: QualityFlag = QualityFlag.NONE
) -> Aligned:
    """Return the trace that channels with their own time stamps make, at 100 samples a second.

    The grid begins with the first value of any sensor. A sample of a channel is interpolated between its neighbours,
    and covered where both hold and are no more than two and a half usual steps (at least 25 ms, at most `GAP_LIMIT_S`)
    apart. Of equal time stamps the last holds. Flags hold until the next one, for at most a second. The order in which
    values with different stamps come does not matter, nor do channels that a trace does not have.

    Args:
        series: By channel, see `SERIES_CHANNELS`.
        missing: Sensors that this car does not have: they read zero.
        quality: Passed on.

    Raises:
        TraceError: A sensor has no values and is not said to be missing, a time is not finite, or the recording spans
            more than four hours.
    """
    sensors = {name: _ordered(series[name], name) for name in CHANNELS if name not in missing and name in series}
    silent = [name for name in CHANNELS if name not in missing and not (name in sensors and len(sensors[name].time_s))]
    if silent:
        raise TraceError(f"no values of {', '.join(silent)}")
    time_s = _grid_s(list(sensors.values()))
    columns, covered = {}, {}
    for name in CHANNELS:
        if name in sensors:
            columns[name], covered[name] = values_at(sensors[name], time_s)
        else:
            columns[name], covered[name] = np.zeros(len(time_s)), np.ones(len(time_s), dtype=bool)
    values = np.column_stack([columns[name] for name in CHANNELS])
    valid: BoolArray = np.logical_and.reduce([covered[name] for name in CHANNELS])
    values[~valid] = 0.0
    flags = [flag for name in STABILITY_CHANNELS if name in series and len((flag := series[name]).time_s)]
    trace = Trace(
        time_s=time_s,
        accel_x_mps2=values[:, 0],
        accel_y_mps2=values[:, 1],
        roll_rate_radps=values[:, 2],
        yaw_rate_radps=values[:, 3],
        steer_rad=values[:, 4],
        wheel_speed_mps=values[:, 5:9],
        valid=valid,
        stability_active=np.logical_or.reduce([_held(flag, time_s) for flag in flags]) if flags else None,
        gnss=_fixes(series),
        quality=quality,
        absent=missing,
    )
    check_trace(trace)
    return Aligned(
        trace=trace,
        covered={name: covered[name] for name in sensors},
        counts={name: count_of(of) for name, of in series.items()},
        missing=missing,
    )


def values_at(series: Series, time_s: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return a channel at other times, and where it is known there; zero where it is not. Each (n,)

    Args:
        series: In the order of time, no stamp twice.
        time_s: Increasing. (n,)
    """
    known_s, values = series.time_s, series.values
    if len(known_s) < 2:
        alone = values[0] if len(values) else np.nan
        hit = np.abs(time_s - known_s[:1]) <= ON_GRID_S if np.isfinite(alone) else np.zeros(len(time_s), dtype=bool)
        return np.where(hit, alone, 0.0), hit
    after = np.clip(np.searchsorted(known_s, time_s), 1, len(known_s) - 1)
    before = after - 1
    apart = known_s[after] - known_s[before]
    share = np.clip((time_s - known_s[before]) / apart, 0.0, 1.0)
    between = values[before] + share * (values[after] - values[before])
    limit = min(GAP_STEPS_COUNT * max(SAMPLE_S, median(np.diff(known_s))), GAP_LIMIT_S)
    inside = (time_s >= known_s[0] - ON_GRID_S) & (time_s <= known_s[-1] + ON_GRID_S)
    # A sample that lies on a value needs no second one.
    result = np.where(inside & (apart <= limit), between, np.nan)
    for near in (before, after):
        on_value = np.abs(time_s - known_s[near]) <= ON_GRID_S
        result = np.where(on_value & np.isnan(result), values[near], result)
    covered: BoolArray = np.isfinite(result)
    return np.where(covered, result, 0.0), covered


def count_of(series: Series) -> SeriesCount:
    """Return what a channel is worth."""
    time_s = np.sort(series.time_s)
    steps = np.diff(time_s)
    repeated = int((steps == 0.0).sum())
    steps = steps[steps > 0.0]
    holds = np.isfinite(series.values)
    gaps = np.diff(np.sort(series.time_s[holds]))
    return SeriesCount(
        values_count=len(time_s),
        repeated_count=repeated,
        invalid_count=int((~holds).sum()),
        step_s=median(steps) if len(steps) else float("nan"),
        longest_gap_s=float(gaps.max()) if len(gaps) else float("nan"),
        lower=float(series.values[holds].min()) if holds.any() else float("nan"),
        upper=float(series.values[holds].max()) if holds.any() else float("nan"),
    )


def _ordered(series: Series, name: str) -> Series:
    if not np.isfinite(series.time_s).all():
        raise TraceError(f"a value of {name} has no time")
    time_s, values = series.time_s, series.values
    if len(time_s) and not (np.diff(time_s) > 0.0).all():
        order = np.argsort(time_s, kind="stable")
        time_s, values = time_s[order], values[order]
        last = np.append(np.diff(time_s) > 0.0, [True])
        time_s, values = time_s[last], values[last]
    return Series(time_s, values)


def _grid_s(sensors: list[Series]) -> FloatArray:
    start_s = min(float(of.time_s[0]) for of in sensors)
    span_s = max(float(of.time_s[-1]) for of in sensors) - start_s
    if span_s > DURATION_LIMIT_S:
        raise TraceError(f"the recording spans {span_s:.0f} s, more than {DURATION_LIMIT_S:.0f}; cut it first")
    if span_s < SAMPLE_S:
        raise TraceError("a recording needs at least two samples")
    grid_s: FloatArray = start_s + SAMPLE_S * np.arange(int(np.floor(span_s / SAMPLE_S + 1e-6)) + 1, dtype=np.float64)
    return grid_s


def _held(flag: Series, time_s: FloatArray) -> BoolArray:
    """Return where the last value of a flag, no older than a second, says yes. (n,)"""
    flag = _ordered(flag, "a flag")
    at = np.searchsorted(flag.time_s, time_s + ON_GRID_S, side="right") - 1
    told = np.clip(at, 0, None)
    fresh = (at >= 0) & (time_s - flag.time_s[told] <= FLAG_LIMIT_S)
    return np.asarray(fresh & (flag.values[told] > 0.5))


def _fixes(series: Mapping[str, Series]) -> GnssTrack | None:
    """Return the position fixes; None without any."""
    if "lat_deg" not in series or "lon_deg" not in series:
        return None
    lat, lon = (_holding(_ordered(series[name], name)) for name in ("lat_deg", "lon_deg"))
    if not len(lat.time_s) or not len(lon.time_s):
        return None
    lon_deg = _nearest(lon, lat.time_s, within_s=_SAME_FIX_S)
    there = np.isfinite(lon_deg) & (np.abs(lat.values) <= 90.0) & (np.abs(lon_deg) <= 180.0)
    time_s, lat_deg, lon_deg = lat.time_s[there], lat.values[there], lon_deg[there]
    new = np.ones(len(time_s), dtype=bool)
    same = (np.diff(lat_deg) == 0.0) & (np.diff(lon_deg) == 0.0) & (np.diff(time_s) < _STALE_FIX_S)
    new[1:] = ~same
    if not new.any():
        return None
    time_s = time_s[new]
    accuracy_m = _detail(series, "gnss_accuracy_m", time_s)
    return GnssTrack(
        time_s=time_s,
        lat_deg=lat_deg[new],
        lon_deg=lon_deg[new],
        accuracy_m=np.where(np.isfinite(accuracy_m), accuracy_m, GNSS_ACCURACY_M),
        speed_mps=_detail(series, GNSS_SPEED_COLUMN, time_s) if GNSS_SPEED_COLUMN in series else None,
    )


def _detail(series: Mapping[str, Series], name: str, time_s: FloatArray) -> FloatArray:
    """Return what a channel says of fixes; NaN where it says nothing. (n,)"""
    if name not in series:
        return np.full(len(time_s), np.nan)
    return _nearest(_holding(_ordered(series[name], name)), time_s, within_s=_FIX_DETAIL_LIMIT_S)


def _holding(series: Series) -> Series:
    holds = np.isfinite(series.values)
    return Series(series.time_s[holds], series.values[holds])


def _nearest(series: Series, time_s: FloatArray, *, within_s: float) -> FloatArray:
    """Return the value nearest in time; NaN where none is near enough. (n,)"""
    if not len(series.time_s):
        return np.full(len(time_s), np.nan)
    after = np.clip(np.searchsorted(series.time_s, time_s), 0, len(series.time_s) - 1)
    before = np.clip(after - 1, 0, None)
    closer = np.abs(series.time_s[before] - time_s) < np.abs(series.time_s[after] - time_s)
    nearest = np.where(closer, before, after)
    values: FloatArray = series.values[nearest].copy()
    values[np.abs(series.time_s[nearest] - time_s) > within_s] = np.nan
    return values

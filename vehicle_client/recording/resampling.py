"""Samples that came at any times, on the grid of 100 a second that traces have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.order_statistics import median
from roadgrip.records import QualityFlag
from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.trace import Trace, check_trace

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.estimation.trace import GnssTrack

DURATION_LIMIT_S = 4.0 * 3600.0
"""A longer recording, or a clock that jumps further, is refused instead of filling the memory."""
ON_GRID_S = SAMPLE_S / 20.0
"""A sample so near to a time of the grid is that time's."""
CLOCK_DRIFT_RATIO = 1e-3
"""Clocks of a car and its recorder differ by less; samples that come otherwise often than a hundred times a second are
interpolated, since all that integrates counts on a hundred."""
GAP_STEPS_COUNT = 2.5
"""Rows farther apart than so many usual steps leave a gap between them."""


def trace_of_samples(
    time_s: FloatArray,
    values: FloatArray,
    *,
    stability_active: BoolArray | None = None,
    gnss: GnssTrack | None = None,
    quality: QualityFlag = QualityFlag.NONE,
) -> Trace:
    """Return a trace of samples that came at any times, at 100 a second, with a mask where nothing came.

    Samples that come every 10 ms are kept as they are. Others are interpolated between neighbours that are no
    more than two and a half usual steps (and at least 25 ms) apart; in wider gaps samples are not valid. Of rows with
    one and the same time the last holds, see `repeated_count`.

    Args:
        time_s: Not decreasing. (k,)
        values: Columns as in `CHANNELS`; NaN where a sensor was silent. (k, 9)
        stability_active: At those times. (k,)
        gnss: Passed on.
        quality: Passed on.

    Raises:
        TraceError: Times are missing, run backwards or span more than four hours; there are fewer than two samples.
    """
    _check_times(time_s)
    last = last_of_each_time(time_s)
    if not last.all():
        time_s, values = time_s[last], values[last]
        stability_active = None if stability_active is None else stability_active[last]
    whole: BoolArray = np.asarray(np.isfinite(values).all(axis=1))
    steps = np.diff(time_s)
    late_s = abs(float(time_s[-1] - time_s[0]) - SAMPLE_S * len(steps))
    if np.abs(steps - SAMPLE_S).max() <= ON_GRID_S and late_s <= ON_GRID_S + CLOCK_DRIFT_RATIO * SAMPLE_S * len(steps):
        time, resampled, valid = time_s, np.where(whole[:, None], values, 0.0), whole
        active = stability_active
    else:
        count = int(np.floor((time_s[-1] - time_s[0]) / SAMPLE_S + 1e-6)) + 1
        time = time_s[0] + SAMPLE_S * np.arange(count)
        resampled, valid = _resampled(time, time_s, values, whole)
        nearest = np.searchsorted((time_s[1:] + time_s[:-1]) / 2.0, time)
        active = None if stability_active is None else stability_active[nearest]
    trace = Trace(
        time_s=time,
        accel_x_mps2=resampled[:, 0],
        accel_y_mps2=resampled[:, 1],
        roll_rate_radps=resampled[:, 2],
        yaw_rate_radps=resampled[:, 3],
        steer_rad=resampled[:, 4],
        wheel_speed_mps=resampled[:, 5:9],
        valid=valid,
        stability_active=active,
        gnss=gnss,
        quality=quality,
    )
    check_trace(trace)
    return trace


def last_of_each_time(time_s: FloatArray) -> BoolArray:
    """Return a mask of the rows whose time does not come again in the next one. (k,)"""
    return np.append(np.diff(time_s) != 0.0, [True])


def repeated_count(time_s: FloatArray) -> int:
    """Return how many rows give way to a later one with the same time."""
    return int((~last_of_each_time(time_s)).sum())


def _check_times(time_s: FloatArray) -> None:
    if len(time_s) < 2 or not np.isfinite(time_s).all():
        message = "a recording needs at least two samples, each with its time"
        raise TraceError(message)
    back = np.flatnonzero(np.diff(time_s) < 0.0)
    if len(back):
        message = f"time runs backwards after {time_s[back[0]]:.3f} s (row {int(back[0]) + 1})"
        raise TraceError(message)
    if time_s[0] == time_s[-1]:
        message = f"time stands still at {time_s[0]:.3f} s"
        raise TraceError(message)
    if time_s[-1] - time_s[0] > DURATION_LIMIT_S:
        message = f"the recording spans {time_s[-1] - time_s[0]:.0f} s, more than {DURATION_LIMIT_S:.0f}; cut it first"
        raise TraceError(message)


def _resampled(
    time_s: FloatArray, from_s: FloatArray, values: FloatArray, whole: BoolArray
) -> tuple[FloatArray, BoolArray]:
    if whole.sum() < 2:
        return np.zeros((len(time_s), values.shape[1])), np.zeros(len(time_s), dtype=bool)
    known = from_s[whole]
    limit = max(GAP_STEPS_COUNT * SAMPLE_S, GAP_STEPS_COUNT * median(np.diff(from_s)))
    after = np.clip(np.searchsorted(known, time_s - ON_GRID_S), 1, len(known) - 1)
    apart = known[after] - known[after - 1]
    on_sample = np.minimum(np.abs(known[after] - time_s), np.abs(known[after - 1] - time_s)) <= SAMPLE_S / 2.0
    covered = (time_s >= known[0] - ON_GRID_S) & (time_s <= known[-1] + ON_GRID_S)
    columns = [np.interp(time_s, known, values[whole, i]) for i in range(values.shape[1])]
    return np.column_stack(columns), covered & ((apart <= limit) | on_sample)

"""Which samples can be believed, and a bridge over those that cannot."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.units import SAMPLE_S
from vehicle_client.estimation.trace import check_trace

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.estimation.trace import Trace

_SPIKES = (
    ("accel_x_mps2", 25.0),
    ("accel_y_mps2", 25.0),
    ("roll_rate_radps", 1.0),
    ("yaw_rate_radps", 0.5),
    ("steer_rad", 0.05),
)
"""How far a sample may lie from both neighbours (on the same side) before it cannot be the car's motion."""
_REACH = (
    ("accel_x_mps2", 500.0),
    ("accel_y_mps2", 500.0),
    ("roll_rate_radps", 35.0),
    ("yaw_rate_radps", 35.0),
    ("steer_rad", 1.5),
    ("wheel_speed_mps", 150.0),
)
"""Larger numbers are no reading of a car's sensor but an error code or a broken message."""


def believable(trace: Trace) -> BoolArray:
    """Return which samples are there, within what sensors can read, and not a spike of a single sample. (n,)

    A spike leaves both neighbours by more than 25 m/s^2, 1 rad/s of roll, 0.5 rad/s of yaw or 0.05 rad of steering
    within 10 ms and comes back: wires do that, cars do not.

    Raises:
        TraceError: The arrays do not fit each other.
    """
    check_trace(trace)
    valid = trace.valid.copy()
    for name, reach in _REACH:
        channel = getattr(trace, name)
        # What is not valid may be anything, NaN included; a comparison with it is false.
        within = np.abs(channel) <= reach
        valid &= within if within.ndim == 1 else within.all(axis=1)
    there = valid.copy()
    for name, limit in _SPIKES:
        values: FloatArray = np.where(there, getattr(trace, name), np.nan)
        step = np.diff(values)
        up, down = step[:-1], -step[1:]
        # A comparison with NaN is false, as it should be: the neighbour of a gap is not a spike.
        valid[1:-1] &= ~((np.minimum(up, down) > limit) | (np.maximum(up, down) < -limit))
    return valid


def bridged(trace: Trace, valid: BoolArray) -> Trace:
    """Return the trace with straight lines over the samples that are not valid, and the mask put in.

    Beyond the first and last valid sample the nearest one is held.

    Args:
        trace: With at least one valid sample.
        valid: Which samples to keep. (n,)
    """
    if valid.all():
        return replace(trace, valid=valid)
    at = np.arange(trace.samples_count, dtype=np.float64)
    known = at[valid]

    def line(values: FloatArray) -> FloatArray:
        return np.interp(at, known, values[valid])

    return replace(
        trace,
        accel_x_mps2=line(trace.accel_x_mps2),
        accel_y_mps2=line(trace.accel_y_mps2),
        roll_rate_radps=line(trace.roll_rate_radps),
        yaw_rate_radps=line(trace.yaw_rate_radps),
        steer_rad=line(trace.steer_rad),
        wheel_speed_mps=np.column_stack([line(trace.wheel_speed_mps[:, i]) for i in range(4)]),
        valid=valid,
    )


def longest_gap_s(valid: BoolArray) -> float:
    """Return the duration of the longest run of samples that are not valid."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], valid, [True]]).astype(np.int8)))
    return float(np.diff(edges)[::2].max() * SAMPLE_S) if len(edges) else 0.0


def missing_frac(valid: BoolArray) -> float:
    """Return the share of samples that are not valid; 1 for no samples at all."""
    return float(1.0 - valid.mean()) if len(valid) else 1.0

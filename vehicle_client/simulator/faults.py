"""What breaks in a vehicle's sensors, as functions from a trace to the trace with the fault.

For tests of the onboard client and for whoever brings a client of his own: the same fault goes into a simulated drive
or a recorded one. Nothing here is random. What the onboard client makes of each fault is in `docs/sensors.md`, held by
tests on simulated and on recorded drives.
"""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.units import GRAVITY_MPS2, SAMPLE_RATE_HZ
from vehicle_client.estimation.trace import part_of

if TYPE_CHECKING:
    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.estimation.trace import GnssTrack, Trace

SPIKE_RADPS = 4.0
RANGE_MPS2 = 1.8 * GRAVITY_MPS2
"""End of the range of the lateral accelerometers of stability systems."""
STEERING_JUMP_RAD = 0.02
"""A fifth of a turn at the steering wheel: its calibration is lost or a tooth is skipped."""
SHORT_GAP_S = 0.2
LONG_GAP_S = 0.6
GNSS_GAP_S = 5.0
GNSS_JUMP_M = 30.0
GNSS_BIAS_M = 40.0
GNSS_DRIFT_MPS = 3.0
GNSS_SPARSE_S = 5.0
GNSS_LATE_S = 1.0
GNSS_SPEED_DRIFT_MPS2 = 0.5
SLOW_RATIO = 0.95
CLOCK_JUMP_S = 2.0
_METRES_PER_DEG = 111_320.0


class Fault(StrEnum):
    """A fault of the sensors; those from a moment on last to the end of the trace."""

    STUCK_WHEEL_SPEED = "stuck_wheel_speed"
    """The front right wheel speed keeps its value from a moment on."""
    WHEEL_SPEED_ZERO = "wheel_speed_zero"
    """The rear left wheel speed reads zero from a moment on."""
    GYRO_SPIKE = "gyro_spike"
    """One sample of the yaw rate is off by 4 rad/s."""
    GYRO_FROZEN = "gyro_frozen"
    """The yaw rate keeps its value from a moment on."""
    GYRO_DEAD = "gyro_dead"
    """The yaw rate reads zero throughout."""
    GYRO_REVERSED = "gyro_reversed"
    """The yaw rate has the wrong sign throughout."""
    ACCEL_SATURATED = "accel_saturated"
    """The lateral accelerometer reads the end of its range, 1.8 g, from a moment on."""
    ACCEL_DEAD = "accel_dead"
    """The lateral accelerometer reads zero throughout."""
    STEERING_OFFSET_JUMP = "steering_offset_jump"
    """The steering angle is off by 0.02 rad from a moment on."""
    STEERING_FROZEN = "steering_frozen"
    """The steering angle keeps its value from a moment on."""
    WHEEL_SLOW = "wheel_slow"
    """The front left wheel speed reads 5 % too little throughout: a wrong tyre."""
    ALL_WHEELS_SLOW = "all_wheels_slow"
    """All wheel speeds read 5 % too little throughout: a wrong rolling radius."""
    SHORT_GAP = "short_gap"
    """No samples for 0.2 s."""
    LONG_GAP = "long_gap"
    """No samples for 0.6 s."""
    REPEATED_SAMPLES = "repeated_samples"
    """A sender repeats itself for 0.2 s: all channels keep their values, on time and said to be valid."""
    DUPLICATED_SAMPLES = "duplicated_samples"
    """For 0.2 s every sample comes twice, with the same time stamp."""
    CLOCK_JUMPS_AHEAD = "clock_jumps_ahead"
    """Time stamps are 2 s later from a moment on."""
    CLOCK_JUMPS_BACK = "clock_jumps_back"
    """Time stamps are 2 s earlier from a moment on."""
    CUT_SHORT = "cut_short"
    """The recording ends at a moment."""
    GNSS_GAP = "gnss_gap"
    """No position fixes for 5 s."""
    GNSS_JUMP = "gnss_jump"
    """Position fixes lie 30 m further north from a moment on, and do not say so."""
    GNSS_BIAS = "gnss_bias"
    """Position fixes lie 40 m further north throughout, and do not say so."""
    GNSS_DRIFT = "gnss_drift"
    """Position fixes wander off from a moment on, by 3 m/s to the north."""
    GNSS_FROZEN = "gnss_frozen"
    """The receiver repeats its last position from a moment on."""
    GNSS_SPARSE = "gnss_sparse"
    """One fix in five seconds, throughout."""
    GNSS_LATE = "gnss_late"
    """Position fixes carry the time one second after theirs."""
    GNSS_SPEED_DRIFT = "gnss_speed_drift"
    """The receiver's speed, not its position, is 0.5 m/s more with every second from a moment on."""


CLOCK_FAULTS = frozenset({Fault.DUPLICATED_SAMPLES, Fault.CLOCK_JUMPS_AHEAD, Fault.CLOCK_JUMPS_BACK})
"""After these the samples are not 10 ms apart: the onboard client refuses the trace as it is (TraceError). What reads
recordings puts samples on the grid first, and so must who wants to see further."""
GNSS_FAULTS = frozenset(fault for fault in Fault if fault.value.startswith("gnss"))
"""These change nothing in a trace without position fixes."""


def with_fault(trace: Trace, fault: Fault, *, at_s: float) -> Trace:
    """Return the trace with a fault in it.

    Args:
        trace: A drive; it is not changed.
        fault: What breaks.
        at_s: When, counted from the first sample; without meaning for faults that last throughout.

    Raises:
        TraceError: The moment lies outside the trace.
    """
    at = round(at_s * SAMPLE_RATE_HZ)
    if not 0 < at < trace.samples_count:
        message = f"a fault at {at_s} s does not lie in a trace of {trace.samples_count} samples"
        raise TraceError(message)
    if fault in GNSS_FAULTS:
        return trace if trace.gnss is None else replace(trace, gnss=_gnss_with(trace.gnss, fault, trace.time_s[at]))
    if fault in CLOCK_FAULTS:
        return _with_clock_fault(trace, fault, at)
    match fault:
        case Fault.SHORT_GAP:
            return replace(trace, valid=trace.valid & ~_during(trace, at, SHORT_GAP_S))
        case Fault.LONG_GAP:
            return replace(trace, valid=trace.valid & ~_during(trace, at, LONG_GAP_S))
        case Fault.REPEATED_SAMPLES:
            rows = np.arange(trace.samples_count)
            return _rows_of(trace, np.where(_during(trace, at, SHORT_GAP_S), at, rows), time_s=trace.time_s)
        case Fault.CUT_SHORT:
            return part_of(trace, from_s=0.0, to_s=(at - 1) / SAMPLE_RATE_HZ)
        case _:
            return _with_channel_fault(trace, fault, at)


def _with_channel_fault(trace: Trace, fault: Fault, at: int) -> Trace:
    wheels, yaw_rate = trace.wheel_speed_mps.copy(), trace.yaw_rate_radps.copy()
    accel_y, steer = trace.accel_y_mps2.copy(), trace.steer_rad.copy()
    match fault:
        case Fault.STUCK_WHEEL_SPEED:
            wheels[at:, 1] = wheels[at, 1]
        case Fault.WHEEL_SPEED_ZERO:
            wheels[at:, 2] = 0.0
        case Fault.GYRO_SPIKE:
            yaw_rate[at] += SPIKE_RADPS
        case Fault.GYRO_FROZEN:
            yaw_rate[at:] = yaw_rate[at]
        case Fault.GYRO_DEAD:
            yaw_rate[:] = 0.0
        case Fault.GYRO_REVERSED:
            yaw_rate *= -1.0
        case Fault.ACCEL_SATURATED:
            accel_y[at:] = RANGE_MPS2
        case Fault.ACCEL_DEAD:
            accel_y[:] = 0.0
        case Fault.STEERING_FROZEN:
            steer[at:] = steer[at]
        case Fault.WHEEL_SLOW:
            wheels[:, 0] *= SLOW_RATIO
        case Fault.ALL_WHEELS_SLOW:
            wheels *= SLOW_RATIO
        case _:  # the steering, which is all that is left
            steer[at:] += STEERING_JUMP_RAD
    return replace(trace, wheel_speed_mps=wheels, yaw_rate_radps=yaw_rate, accel_y_mps2=accel_y, steer_rad=steer)


def _with_clock_fault(trace: Trace, fault: Fault, at: int) -> Trace:
    rows = np.arange(trace.samples_count)
    if fault is Fault.DUPLICATED_SAMPLES:
        doubled = np.repeat(rows, np.where(_during(trace, at, SHORT_GAP_S), 2, 1))
        return _rows_of(trace, doubled, time_s=trace.time_s[doubled])
    jump = CLOCK_JUMP_S if fault is Fault.CLOCK_JUMPS_AHEAD else -CLOCK_JUMP_S
    return replace(trace, time_s=trace.time_s + np.where(rows < at, 0.0, jump))


def _gnss_with(gnss: GnssTrack, fault: Fault, from_s: float) -> GnssTrack:
    time, lat = gnss.time_s, gnss.lat_deg
    since_s = np.maximum(0.0, time - from_s)
    match fault:
        case Fault.GNSS_GAP:
            return gnss.where((time < from_s) | (time >= from_s + GNSS_GAP_S))
        case Fault.GNSS_SPARSE:
            turn = np.floor((time - time[:1]) / GNSS_SPARSE_S)
            return gnss.where(np.diff(turn, prepend=-1.0) > 0.0)
        case Fault.GNSS_JUMP:
            return replace(gnss, lat_deg=lat + np.where(time >= from_s, GNSS_JUMP_M, 0.0) / _METRES_PER_DEG)
        case Fault.GNSS_BIAS:
            return replace(gnss, lat_deg=lat + GNSS_BIAS_M / _METRES_PER_DEG)
        case Fault.GNSS_DRIFT:
            return replace(gnss, lat_deg=lat + GNSS_DRIFT_MPS * since_s / _METRES_PER_DEG)
        case Fault.GNSS_FROZEN:
            last = np.minimum(np.arange(len(time)), max(0, int(np.searchsorted(time, from_s)) - 1))
            return replace(gnss, lat_deg=lat[last], lon_deg=gnss.lon_deg[last])
        case Fault.GNSS_LATE:
            return replace(gnss, time_s=time + GNSS_LATE_S)
        case _:  # the receiver's speed, which is all that is left
            speed = gnss.speed_mps
            return gnss if speed is None else replace(gnss, speed_mps=speed + GNSS_SPEED_DRIFT_MPS2 * since_s)


def _during(trace: Trace, at: int, seconds: float) -> BoolArray:
    rows = np.arange(trace.samples_count)
    return (rows >= at) & (rows < at + round(seconds * SAMPLE_RATE_HZ))


def _rows_of(trace: Trace, rows: np.typing.NDArray[np.int64], *, time_s: FloatArray) -> Trace:
    return replace(
        trace,
        time_s=time_s,
        accel_x_mps2=trace.accel_x_mps2[rows],
        accel_y_mps2=trace.accel_y_mps2[rows],
        roll_rate_radps=trace.roll_rate_radps[rows],
        yaw_rate_radps=trace.yaw_rate_radps[rows],
        steer_rad=trace.steer_rad[rows],
        wheel_speed_mps=trace.wheel_speed_mps[rows],
        valid=trace.valid[rows],
        stability_active=None if trace.stability_active is None else trace.stability_active[rows],
    )

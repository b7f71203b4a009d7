"""What goes wrong with real sensors, and what the client owes the road side unit then."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.records import QualityFlag, Reason
from roadgrip.units import FloatArray
from vehicle_client.estimation.trace import Trace
from vehicle_client.shell.sources import trace_of_samples


@dataclass(frozen=True, slots=True)
class Summary:
    """The passage is reported, with these flags among its own, and the speed as without the fault."""

    flags: QualityFlag = QualityFlag.NONE


@dataclass(frozen=True, slots=True)
class Refusal:
    """The passage is kept back for this reason."""

    reason: Reason


@dataclass(frozen=True, slots=True)
class Unreadable:
    """There is no trace to begin with."""

    error: type[Exception] = TraceError


class Fault(Enum):
    """A fault; `EXPECTED` holds its result and `applied` puts it into a drive."""

    NONE = auto()
    STUCK_WHEEL_SPEED = auto()
    WHEEL_SPEED_ZERO = auto()
    GYRO_SPIKE = auto()
    SHORT_GAP = auto()
    LONG_GAP = auto()
    CLOCK_JUMPS_AHEAD = auto()
    CLOCK_JUMPS_BACK = auto()
    GYRO_DEAD = auto()
    GYRO_REVERSED = auto()
    CUT_SHORT = auto()


EXPECTED: dict[Fault, Summary | Refusal | Unreadable] = {
    Fault.NONE: Summary(),
    Fault.STUCK_WHEEL_SPEED: Summary(),
    Fault.WHEEL_SPEED_ZERO: Summary(),
    Fault.GYRO_SPIKE: Summary(QualityFlag.SAMPLES_MISSING),
    Fault.SHORT_GAP: Summary(QualityFlag.SAMPLES_MISSING),
    Fault.LONG_GAP: Refusal(Reason.TOO_MANY_GAPS),
    Fault.CLOCK_JUMPS_AHEAD: Refusal(Reason.TOO_MANY_GAPS),
    Fault.CLOCK_JUMPS_BACK: Unreadable(),
    Fault.GYRO_DEAD: Refusal(Reason.WRONG_ROAD),
    Fault.GYRO_REVERSED: Refusal(Reason.WRONG_ROAD),
    Fault.CUT_SHORT: Refusal(Reason.PASSAGE_ABORTED),
}


def applied(fault: Fault, trace: Trace, *, at: int) -> Trace:
    """Return the drive with the fault at sample `at`, inside the section.

    Raises:
        TraceError: The fault is one that no trace survives.
    """
    n = trace.samples_count
    sample = np.arange(n)
    wheels, yaw_rate = trace.wheel_speed_mps.copy(), trace.yaw_rate_radps.copy()
    match fault:
        case Fault.STUCK_WHEEL_SPEED:
            wheels[at:, 1] = wheels[at, 1]
            result = replace(trace, wheel_speed_mps=wheels)
        case Fault.WHEEL_SPEED_ZERO:
            wheels[:, 2] = 0.0
            result = replace(trace, wheel_speed_mps=wheels)
        case Fault.GYRO_SPIKE:
            yaw_rate[at] += 4.0
            result = replace(trace, yaw_rate_radps=yaw_rate)
        case Fault.SHORT_GAP:
            result = replace(trace, valid=trace.valid & ((sample < at) | (sample >= at + 20)))
        case Fault.LONG_GAP:
            result = replace(trace, valid=trace.valid & ((sample < at) | (sample >= at + 60)))
        case Fault.CLOCK_JUMPS_AHEAD:
            result = _retimed(trace, trace.time_s + np.where(sample < at, 0.0, 2.0))
        case Fault.CLOCK_JUMPS_BACK:
            result = _retimed(trace, trace.time_s - np.where(sample < at, 0.0, 2.0))
        case Fault.GYRO_DEAD:
            result = replace(trace, yaw_rate_radps=np.zeros(n))
        case Fault.GYRO_REVERSED:
            result = replace(trace, yaw_rate_radps=-yaw_rate)
        case Fault.CUT_SHORT:
            result = _first(trace, at)
        case _:
            result = trace
    return result


def _channels(trace: Trace) -> tuple[FloatArray, ...]:
    return (
        trace.accel_x_mps2,
        trace.accel_y_mps2,
        trace.roll_rate_radps,
        trace.yaw_rate_radps,
        trace.steer_rad,
        trace.wheel_speed_mps,
    )


def _retimed(trace: Trace, time_s: FloatArray) -> Trace:
    return trace_of_samples(time_s, np.column_stack(_channels(trace)), quality=trace.quality)


def _first(trace: Trace, count: int) -> Trace:
    return trace_of_samples(
        trace.time_s[:count], np.column_stack([values[:count] for values in _channels(trace)]), quality=trace.quality
    )

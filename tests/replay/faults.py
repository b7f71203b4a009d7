"""What the onboard client makes of each fault: the table of `docs/sensors.md`, and how a test asks for it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.features import NEWEST_TABLE
from roadgrip.records import KinematicSummary, QualityFlag, Reason, Rejected
from roadgrip.section import RoadSection
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.recording.resampling import trace_of_samples
from vehicle_client.simulator.faults import CLOCK_FAULTS, GNSS_FAULTS, Fault, with_fault

TELLING = ("speed_mean_mps", "steer_std_rad", "sideslip_std_rad", "yaw_rate_excess_std_radps")
"""Features by which a summary is said to be harmed."""
HARMLESS_RATIO = 0.1
"""On the drives of the tests harmless faults change them by 2 % at most, harmful ones by 15 % or far more."""
APART_LIMIT_S = 0.5
"""Farther from where it was placed without the fault, a passage is harmed, too."""


@dataclass(frozen=True, slots=True)
class Unharmed:
    """The passage is reported as without the fault, with these flags among its own."""

    flags: QualityFlag = QualityFlag.NONE


@dataclass(frozen=True, slots=True)
class Flagged:
    """The passage is reported with a summary that the fault changed, and with these flags that say so."""

    flags: QualityFlag


@dataclass(frozen=True, slots=True)
class Refused:
    """The passage is kept back for one of these reasons."""

    reasons: frozenset[Reason]


@dataclass(frozen=True, slots=True)
class Unreadable:
    """There is no trace to begin with."""


@dataclass(frozen=True, slots=True)
class Unnoticed:
    """A wrong summary is reported, with no word of warning. It should not be; the page says so."""


Result = Unharmed | Flagged | Refused | Unreadable | Unnoticed


def refused(*reasons: Reason) -> Refused:
    return Refused(frozenset(reasons))


DOUBTFUL, POOR = QualityFlag.SENSORS_DOUBTFUL, QualityFlag.GNSS_POOR
BY_MOTION_INSTEAD = QualityFlag.NO_GNSS | QualityFlag.GNSS_POOR

BY_DEAD_RECKONING: dict[Fault, Result | tuple[Result, ...]] = {
    Fault.STUCK_WHEEL_SPEED: Unharmed(),
    Fault.WHEEL_SPEED_ZERO: Unharmed(DOUBTFUL),
    Fault.GYRO_SPIKE: Unharmed(QualityFlag.SAMPLES_MISSING),
    Fault.GYRO_FROZEN: refused(Reason.SENSOR_FAULT),
    Fault.GYRO_DEAD: refused(Reason.SENSOR_FAULT),
    Fault.GYRO_REVERSED: refused(Reason.SENSOR_FAULT),
    Fault.ACCEL_SATURATED: refused(Reason.SENSOR_FAULT),
    Fault.ACCEL_DEAD: refused(Reason.SENSOR_FAULT),
    Fault.STEERING_OFFSET_JUMP: refused(Reason.SENSOR_FAULT),
    Fault.STEERING_FROZEN: refused(Reason.SENSOR_FAULT),
    Fault.WHEEL_SLOW: Flagged(DOUBTFUL),
    Fault.ALL_WHEELS_SLOW: (refused(Reason.WRONG_ROAD), Flagged(DOUBTFUL), Unharmed(DOUBTFUL)),
    Fault.SHORT_GAP: Unharmed(QualityFlag.SAMPLES_MISSING),
    Fault.LONG_GAP: refused(Reason.TOO_MANY_GAPS),
    Fault.REPEATED_SAMPLES: Unharmed(),
    Fault.DUPLICATED_SAMPLES: Unharmed(),
    Fault.CLOCK_JUMPS_AHEAD: refused(Reason.TOO_MANY_GAPS),
    Fault.CLOCK_JUMPS_BACK: Unreadable(),
    Fault.CUT_SHORT: refused(Reason.PASSAGE_ABORTED),
    **{fault: Unharmed() for fault in GNSS_FAULTS},
}
WITH_POSITIONS = BY_DEAD_RECKONING | {
    Fault.ALL_WHEELS_SLOW: Flagged(DOUBTFUL),
    Fault.GNSS_GAP: Unharmed(POOR),
    Fault.GNSS_JUMP: Unharmed(BY_MOTION_INSTEAD),
    Fault.GNSS_BIAS: Unharmed(BY_MOTION_INSTEAD),
    Fault.GNSS_DRIFT: Unharmed(BY_MOTION_INSTEAD),
    Fault.GNSS_FROZEN: Unharmed(POOR),
    Fault.GNSS_SPARSE: Unharmed(POOR),
    Fault.GNSS_LATE: Unharmed(BY_MOTION_INSTEAD),
    Fault.GNSS_SPEED_DRIFT: Unharmed(POOR),
}
WITHOUT_WHEELS = BY_DEAD_RECKONING | {
    # Wheels that were made of a reference speed are not held to account, and outvoted all the same.
    Fault.WHEEL_SPEED_ZERO: Unharmed(),
    Fault.WHEEL_SLOW: Unharmed(),
}


def result_of(
    trace: Trace, section: RoadSection, fault: Fault, *, at_s: float, vehicle: VehicleGeometry = XC90
) -> Result:
    """Return what becomes of a drive with a fault, compared with the same drive without it."""
    whole = summarise_passage(trace, section, vehicle=vehicle)
    assert isinstance(whole, Summarised), whole
    broken = with_fault(trace, fault, at_s=at_s)
    if fault in CLOCK_FAULTS:
        try:
            broken = _on_the_grid(broken)
        except TraceError:
            return Unreadable()
    outcome = summarise_passage(broken, section, vehicle=vehicle)
    if isinstance(outcome, Rejected):
        return refused(outcome.reason)
    # How well the offsets are known is a matter of degree, and may turn either way at its limit.
    before, after = (made.summary.quality & ~QualityFlag.OFFSETS_UNCERTAIN for made in (whole, outcome))
    assert after & before == before
    flags = after & ~before
    harm = harm_ratio(outcome.summary, than=whole.summary)
    apart_s = max(abs(outcome.match.entry_s - whole.match.entry_s), abs(outcome.match.exit_s - whole.match.exit_s))
    if harm <= HARMLESS_RATIO and apart_s < APART_LIMIT_S:
        return Unharmed(flags)
    return Flagged(flags) if flags & (DOUBTFUL | POOR) else Unnoticed()


def ends_as(result: Result, expected: Result | tuple[Result, ...]) -> bool:
    """Return whether a result is the expected one, or one of several."""
    if isinstance(expected, tuple):
        return any(ends_as(result, one) for one in expected)
    if isinstance(result, Refused) and isinstance(expected, Refused):
        return result.reasons <= expected.reasons
    return result == expected


def harm_ratio(summary: KinematicSummary, *, than: KinematicSummary) -> float:
    """Return the largest relative change of the telling features."""
    names = [feature.name for feature in NEWEST_TABLE.kinematic]
    rows = [names.index(name) for name in TELLING]
    values, whole = np.array(summary.values)[rows], np.array(than.values)[rows]
    return float(np.abs(values / whole - 1.0).max())


def _on_the_grid(trace: Trace) -> Trace:
    """Return the trace as whoever reads recordings makes it of samples that come at any time."""
    channels = (
        trace.accel_x_mps2,
        trace.accel_y_mps2,
        trace.roll_rate_radps,
        trace.yaw_rate_radps,
        trace.steer_rad,
        trace.wheel_speed_mps,
    )
    gridded = trace_of_samples(
        trace.time_s,
        np.column_stack(channels),
        stability_active=trace.stability_active,
        gnss=trace.gnss,
        quality=trace.quality,
    )
    return replace(gridded, absent=trace.absent)

"""What the onboard client makes of each fault: the table of `docs/sensors.md`, and how a test asks for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadgrip.errors import TraceError
from roadgrip.features import KINEMATIC_FEATURES
from roadgrip.records import KinematicSummary, QualityFlag, Reason, Rejected
from roadgrip.section import RoadSection
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.recording.resampling import trace_of_samples
from vehicle_client.simulator.faults import CLOCK_FAULTS, Fault, with_fault

TELLING = ("speed_mean_mps", "steer_std_rad", "sideslip_std_rad", "yaw_rate_excess_std_radps")
"""Features by which a summary is said to be harmed."""
HARMLESS_RATIO = 0.1
"""On the drives of the tests harmless faults change them by 2 % at most, harmful ones by 15 % or far more."""


@dataclass(frozen=True, slots=True)
class Unharmed:
    """The passage is reported as without the fault, with these flags among its own."""

    flags: QualityFlag = QualityFlag.NONE


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


Result = Unharmed | Refused | Unreadable | Unnoticed


def refused(*reasons: Reason) -> Refused:
    return Refused(frozenset(reasons))


BY_DEAD_RECKONING: dict[Fault, Result] = {
    Fault.STUCK_WHEEL_SPEED: Unharmed(),
    Fault.WHEEL_SPEED_ZERO: Unharmed(),
    Fault.GYRO_SPIKE: Unharmed(QualityFlag.SAMPLES_MISSING),
    Fault.GYRO_FROZEN: refused(Reason.WRONG_ROAD),
    Fault.GYRO_DEAD: refused(Reason.WRONG_ROAD),
    Fault.GYRO_REVERSED: refused(Reason.WRONG_ROAD),
    Fault.ACCEL_SATURATED: Unnoticed(),
    Fault.STEERING_OFFSET_JUMP: Unnoticed(),
    Fault.SHORT_GAP: Unharmed(QualityFlag.SAMPLES_MISSING),
    Fault.LONG_GAP: refused(Reason.TOO_MANY_GAPS),
    Fault.REPEATED_SAMPLES: Unharmed(),
    Fault.DUPLICATED_SAMPLES: Unreadable(),
    Fault.CLOCK_JUMPS_AHEAD: refused(Reason.TOO_MANY_GAPS),
    Fault.CLOCK_JUMPS_BACK: Unreadable(),
    Fault.CUT_SHORT: refused(Reason.PASSAGE_ABORTED),
    Fault.GNSS_GAP: Unharmed(),
    Fault.GNSS_JUMP: Unharmed(),
}
WITH_POSITIONS = BY_DEAD_RECKONING | {
    # Positions find the road without the gyro, which nobody then compares with the map.
    Fault.GYRO_FROZEN: Unnoticed(),
    Fault.GYRO_DEAD: Unnoticed(),
    Fault.GYRO_REVERSED: Unnoticed(),
    Fault.GNSS_JUMP: refused(Reason.WRONG_ROAD, Reason.PASSAGE_ABORTED),
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
    assert outcome.summary.quality & whole.summary.quality == whole.summary.quality
    flags = outcome.summary.quality & ~whole.summary.quality
    harm = harm_ratio(outcome.summary, than=whole.summary)
    if harm <= HARMLESS_RATIO:
        assert abs(outcome.match.exit_s - whole.match.exit_s) < 0.3
        return Unharmed(flags)
    assert flags == QualityFlag.NONE
    return Unnoticed()


def ends_as(result: Result, expected: Result) -> bool:
    """Return whether a result is the expected one, or one of several."""
    if isinstance(result, Refused) and isinstance(expected, Refused):
        return result.reasons <= expected.reasons
    return result == expected


def harm_ratio(summary: KinematicSummary, *, than: KinematicSummary) -> float:
    """Return the largest relative change of the telling features."""
    names = [feature.name for feature in KINEMATIC_FEATURES]
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
    return trace_of_samples(
        trace.time_s,
        np.column_stack(channels),
        stability_active=trace.stability_active,
        gnss=trace.gnss,
        quality=trace.quality,
    )

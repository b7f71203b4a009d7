"""The whole onboard client as one pure function: a trace and a map in, a kinematic summary or a refusal out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.records import KinematicSummary, QualityFlag, Reason, Rejected
from vehicle_client.estimation.gaps import believable, bridged, longest_gap_s, missing_frac
from vehicle_client.estimation.grip.evidence import grip_evidence
from vehicle_client.estimation.grip.lesson import passage_lesson
from vehicle_client.estimation.grip.memory import CarMemory, remembered
from vehicle_client.estimation.grip.motion import silent_without
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE, GripNoise
from vehicle_client.estimation.grip.recall import Sensed, recalled
from vehicle_client.estimation.handling import XC90_HANDLING, Handling
from vehicle_client.estimation.mounting import in_car_axes
from vehicle_client.estimation.observer import XC90_PARAMETERS, ObserverParameters
from vehicle_client.estimation.offsets import SensorOffsets, sensor_offsets
from vehicle_client.estimation.plausibility import Sensor, findings
from vehicle_client.estimation.signals import (
    inertial_signals,
    kinematic_signals,
    unmapped_speed_mps,
    unmapped_velocity_y_mps,
)
from vehicle_client.estimation.summary import KinematicSignals, kinematic_summary
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry
from vehicle_client.estimation.vertical import vertical_velocity_mps
from vehicle_client.mapmatch.driven_line import driven_line, with_course
from vehicle_client.mapmatch.match import MatchMethod, SectionMatch
from vehicle_client.mapmatch.placing import placed

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import BoolArray, FloatArray
    from vehicle_client.estimation.trace import Trace

GAP_LIMIT_S = 0.3
"""Longer gaps inside the section lose a peak that matters."""
MISSING_LIMIT_FRAC = 0.05
SAMPLES_MIN_COUNT = 100
"""Fewer are no bag to take statistics of."""
SPEED_MIN_MPS = 2.0
"""Below it a vehicle says nothing about the road, and angles of its velocity mean nothing."""


@dataclass(frozen=True, slots=True)
class Summarised:
    """A passage that the vehicle can report.

    Attributes:
        summary: What is sent.
        match: When the vehicle was inside the section.
        signals: What was estimated at every sample, for plots and comparisons.
        sensed: What the physical inverse looked at, for the car to learn from.
    """

    summary: KinematicSummary
    match: SectionMatch
    signals: KinematicSignals
    sensed: Sensed

    @property
    def offsets(self) -> SensorOffsets:
        """What was subtracted from the sensors."""
        return self.sensed.offsets

    @property
    def left_at_s(self) -> float:
        """When the vehicle left the section, on the clock of the trace."""
        return self.match.exit_s


def summarise_passage(
    trace: Trace,
    section: RoadSection,
    *,
    vehicle: VehicleGeometry = XC90,
    parameters: ObserverParameters = XC90_PARAMETERS,
    handling: Handling = XC90_HANDLING,
    noise: GripNoise = AUTOMOTIVE_NOISE,
    memory: CarMemory | None = None,
) -> Summarised | Rejected:
    """Return what a vehicle makes of one drive over a section, or why it keeps it to itself.

    Refused are: fewer than 100 samples, or so many inside the section (TOO_SHORT); gaps over 0.3 s or 5 % inside the
    section, or gaps that prevent the match (TOO_MANY_GAPS); less than 2 m/s inside the section (TOO_SLOW); a drive
    elsewhere (WRONG_ROAD); a passage without its start or end (PASSAGE_ABORTED); a sensor that the others, the map or
    the receiver contradict gravely (SENSOR_FAULT; lesser contradictions are a flag, SENSORS_DOUBTFUL).

    Args:
        trace: The drive, best with a few seconds of approach and exit.
        section: The map from the road side unit.
        vehicle: The own car.
        parameters: Constants of the estimation.
        handling: What is declared of its masses, springs and tyres.
        noise: What is declared of its sensors.
        memory: What the car has learned of itself, for the physical inverse.

    Raises:
        TraceError: The trace's arrays do not fit each other.
    """
    valid = believable(trace)
    if int(valid.sum()) < SAMPLES_MIN_COUNT:
        return Rejected(Reason.TOO_SHORT, f"{int(valid.sum())} samples")
    sensed = bridged(trace, valid)
    # Before anything else: a tilted sensor's share of gravity is neither a climb nor a slide nor an offset.
    trace = in_car_axes(sensed, vehicle)
    rough = unmapped_speed_mps(trace, vehicle=vehicle, parameters=parameters)
    climbing = vertical_velocity_mps(trace.accel_x_mps2, rough, trace.yaw_rate_radps)
    line = with_course(
        driven_line(rough, trace.yaw_rate_radps, vertical_velocity_mps=climbing),
        speed_mps=rough,
        velocity_y_mps=unmapped_velocity_y_mps(trace, vehicle=vehicle, parameters=parameters),
    )
    placing = placed(trace.gnss, line, trace.time_s, section)
    match = placing.outcome
    if isinstance(match, Rejected):
        return _not_found(sensed, rough, vehicle, refusal=match)
    inside = match.inside(trace.time_s)
    refusal = _refusal(inside=inside, valid=valid, speed_mps=rough)
    if refusal is not None:
        return refusal
    found = (
        *placing.findings,
        *findings(sensed, rough, from_s=match.entry_s, to_s=match.exit_s, vehicle=vehicle),
    )
    faults = [finding for finding in found if finding.grave]
    if faults:
        return Rejected(Reason.SENSOR_FAULT, "; ".join(map(str, faults)))
    offsets = sensor_offsets(
        trace.accel_y_mps2,
        trace.yaw_rate_radps,
        trace.steer_rad,
        rough,
        valid & (trace.time_s < match.entry_s),
        accel_x_mps2=trace.accel_x_mps2,
        climb_rad=float(np.arctan(section.profile.grade_ratio[0])),
        wheelbase_m=vehicle.wheelbase_m,
    )
    signals = kinematic_signals(
        trace, section, station_m=match.station_m, vehicle=vehicle, parameters=parameters, offsets=offsets
    )
    counted = inside & valid
    sensed_inside = Sensed(
        section=section,
        measured=inertial_signals(trace, vehicle, offsets, parameters),
        offsets=offsets,
        station_m=match.station_m,
        inside=inside,
        speed_mps=signals.speed_mps,
        steer_rad=trace.steer_rad - offsets.steer_rad,
        wheel_speed_mps=trace.wheel_speed_mps,
        absent=trace.absent,
    )
    summary = kinematic_summary(
        signals,
        counted,
        grip_features=grip_features(sensed_inside, vehicle=vehicle, handling=handling, noise=noise, memory=memory),
        duration_s=match.exit_s - match.entry_s,
        quality=_quality(
            trace,
            match,
            offsets,
            missing=bool((inside & ~valid).any()),
            gnss_poor=placing.gnss_poor,
            doubtful=any(finding.doubtful for finding in found),
        ),
    )
    return Summarised(summary=summary, match=match, signals=signals, sensed=sensed_inside)


def grip_features(
    sensed: Sensed, *, vehicle: VehicleGeometry, handling: Handling, noise: GripNoise, memory: CarMemory | None
) -> FloatArray:
    """Return what the physical inverse makes of a passage, in the order of the feature table.

    Args:
        sensed: Over the section.
        vehicle: The own car.
        handling: What is declared of its masses, springs and tyres.
        noise: What is declared of its sensors.
        memory: What the car has learned of itself.
    """
    seen = recalled(sensed, handling=handling, noise=noise, memory=memory)
    return grip_evidence(seen.motion, handling=seen.handling, geometry=vehicle, noise=seen.noise)


def memory_after(
    sensed: Sensed,
    memory: CarMemory,
    *,
    friction_mu: float,
    vehicle: VehicleGeometry,
    handling: Handling,
    noise: GripNoise,
) -> CarMemory:
    """Return what a car remembers of itself after a passage. Takes as long as the summary; nobody waits for it.

    A car that lacks a sensor of those it would learn from learns nothing.

    Args:
        sensed: Over the section.
        memory: Before the passage.
        friction_mu: That explained the passage best (`grip_all_best_mu`) with that memory.
        vehicle: The own car.
        handling: What is declared of its masses, springs and tyres.
        noise: What is declared of its sensors.
    """
    if silent_without(sensed.absent):
        return memory
    lesson = passage_lesson(
        sensed, friction_mu=friction_mu, handling=handling, geometry=vehicle, noise=noise, memory=memory
    )
    return remembered(memory, lesson)


def _not_found(trace: Trace, speed_mps: FloatArray, vehicle: VehicleGeometry, *, refusal: Rejected) -> Rejected:
    """Return why a drive was not found: its gaps or its gyro may be to blame, else what the match says."""
    there = np.flatnonzero(trace.valid)
    # Channels that begin late, or end early, hide nothing that lies between.
    gap = longest_gap_s(trace.valid[there[0] : there[-1] + 1])
    if gap > GAP_LIMIT_S or missing_frac(trace.valid) > MISSING_LIMIT_FRAC:
        return Rejected(Reason.TOO_MANY_GAPS, f"longest gap {gap:.2f} s; {refusal.detail}")
    whole = findings(trace, speed_mps, from_s=float(trace.time_s[0]), to_s=float(trace.time_s[-1]), vehicle=vehicle)
    blamed = [finding for finding in whole if finding.grave and finding.sensor is Sensor.GYRO]
    if blamed:
        return Rejected(Reason.SENSOR_FAULT, f"{'; '.join(map(str, blamed))}; {refusal.detail}")
    return refusal


def _refusal(*, inside: BoolArray, valid: BoolArray, speed_mps: FloatArray) -> Rejected | None:
    count = int(np.count_nonzero(inside))
    if count < SAMPLES_MIN_COUNT:
        return Rejected(Reason.TOO_SHORT, f"{count} samples inside the section")
    gap, missing = longest_gap_s(valid[inside]), missing_frac(valid[inside])
    if gap > GAP_LIMIT_S or missing > MISSING_LIMIT_FRAC:
        return Rejected(Reason.TOO_MANY_GAPS, f"longest gap {gap:.2f} s, {missing:.1%} of the samples missing")
    slowest = float(speed_mps[inside].min())
    if slowest < SPEED_MIN_MPS:
        return Rejected(Reason.TOO_SLOW, f"slowed to {slowest:.1f} m/s inside the section")
    return None


def _quality(
    trace: Trace, match: SectionMatch, offsets: SensorOffsets, *, missing: bool, gnss_poor: bool, doubtful: bool
) -> QualityFlag:
    quality = trace.quality
    if match.method is not MatchMethod.GNSS:
        quality |= QualityFlag.NO_GNSS
    if offsets.uncertain:
        quality |= QualityFlag.OFFSETS_UNCERTAIN
    if missing:
        quality |= QualityFlag.SAMPLES_MISSING
    if gnss_poor:
        quality |= QualityFlag.GNSS_POOR
    if doubtful:
        quality |= QualityFlag.SENSORS_DOUBTFUL
    if trace.stability_active is not None and bool(trace.stability_active[match.inside(trace.time_s)].any()):
        quality |= QualityFlag.STABILITY_ACTIVE
    return quality

"""The steps that are written three times: what goes in, and what has to come out of each way alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadgrip.features import NEWEST_TABLE, PAPER_TABLE, summary_for
from roadgrip.section import RoadSection
from roadgrip.units import BoolArray, FloatArray
from vehicle_client.estimation.grip.evidence import grip_evidence
from vehicle_client.estimation.grip.motion import motion_over
from vehicle_client.estimation.grip.noise import AUTOMOTIVE_NOISE
from vehicle_client.estimation.handling import XC90_HANDLING
from vehicle_client.estimation.observer import ObserverParameters
from vehicle_client.estimation.offsets import SensorOffsets
from vehicle_client.estimation.signals import inertial_signals, kinematic_signals
from vehicle_client.estimation.summary import KinematicSignals, kinematic_summary
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry
from vehicle_client.pipeline import Summarised
from vehicle_client.vehicle_profile import PAPER_VEHICLE

_NO_GRIP = np.zeros(len(NEWEST_TABLE.kinematic) - len(PAPER_TABLE.kinematic))


@dataclass(frozen=True, slots=True)
class Steps:
    """Estimation and statistics of one drive: everything after the section has been found.

    The sensor sits level at the centre of gravity and no sample is missing, so nothing is turned, moved or bridged.

    Attributes:
        trace: What was recorded.
        section: The map.
        station_m: Position along it. (n,)
        inside: Which samples count. (n,)
        offsets: To subtract from the sensors.
        vehicle: The car.
        parameters: Constants of the estimation.
    """

    trace: Trace
    section: RoadSection
    station_m: FloatArray
    inside: BoolArray
    offsets: SensorOffsets
    vehicle: VehicleGeometry = XC90
    parameters: ObserverParameters = PAPER_VEHICLE.parameters


def steps_of(trace: Trace, section: RoadSection, result: Summarised) -> Steps:
    """Return what remains to be done once a drive has been matched."""
    return Steps(
        trace=trace,
        section=section,
        station_m=result.match.station_m,
        inside=result.match.inside(trace.time_s),
        offsets=result.offsets,
    )


def our_values(steps: Steps) -> FloatArray:
    """Return the paper's kinematic features by the client's own code. (55,)"""
    signals = kinematic_signals(
        steps.trace,
        steps.section,
        station_m=steps.station_m,
        vehicle=steps.vehicle,
        parameters=steps.parameters,
        offsets=steps.offsets,
    )
    return statistics_alone(signals, steps)


def statistics_alone(signals: KinematicSignals, steps: Steps) -> FloatArray:
    """Return the statistics of what was estimated, the paper's part of the table. (55,)"""
    summary = kinematic_summary(signals, steps.inside, grip_features=_NO_GRIP, duration_s=1.0)
    return np.array(summary_for(summary, PAPER_TABLE).values)


def our_grip(steps: Steps, signals: KinematicSignals) -> FloatArray:
    """Return the grip features by the client's own code; they are made in one way only. (49,)

    Args:
        steps: Of the drive.
        signals: What was estimated of it.
    """
    motion = motion_over(
        steps.section,
        inertial_signals(steps.trace, steps.vehicle, steps.offsets, steps.parameters),
        station_m=steps.station_m,
        inside=steps.inside,
        speed_mps=signals.speed_mps,
        steer_rad=steps.trace.steer_rad - steps.offsets.steer_rad,
        wheel_speed_mps=steps.trace.wheel_speed_mps,
        handling=XC90_HANDLING,
        level_gain_ratio=AUTOMOTIVE_NOISE.level_gain_ratio,
    )
    return grip_evidence(motion, handling=XC90_HANDLING, geometry=steps.vehicle, noise=AUTOMOTIVE_NOISE)

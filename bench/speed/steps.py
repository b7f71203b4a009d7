"""The steps that are written three times: what goes in, and what has to come out of each way alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from roadgrip.section import RoadSection
from roadgrip.units import BoolArray, FloatArray
from vehicle_client.estimation.observer import ObserverParameters
from vehicle_client.estimation.offsets import SensorOffsets
from vehicle_client.estimation.signals import kinematic_signals
from vehicle_client.estimation.summary import kinematic_summary
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import XC90, VehicleGeometry
from vehicle_client.pipeline import Summarised
from vehicle_client.vehicle_profile import PAPER_VEHICLE


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
    """Return the kinematic features by the client's own code. (55,)"""
    signals = kinematic_signals(
        steps.trace,
        steps.section,
        station_m=steps.station_m,
        vehicle=steps.vehicle,
        parameters=steps.parameters,
        offsets=steps.offsets,
    )
    return np.array(kinematic_summary(signals, steps.inside, duration_s=1.0).values)

"""A real curve: the map from one lap of a race track, the drive from the next."""

from __future__ import annotations

import numpy as np

from roadgrip.section import RoadSection, build_section
from tests.replay.recordings import FERRARI, cut, recording
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import VehicleGeometry
from vehicle_client.mapmatch.dead_reckoning import DrivenLine, driven_line

FERRARI_GEOMETRY = VehicleGeometry(wheelbase_m=2.40, track_m=1.35, front_axle_m=1.34)
"""Ferrari 250 LM; the centre of gravity of the mid-engined car is an estimate."""

CURVE_M = (2030.0, 2330.0)
"""A right-hander of 40 m radius and 190 degrees, in metres since the recording began."""
DRIVE_SAMPLES = (16100, 18050)
"""The same place one lap later, with 130 m of approach and 90 m of exit."""
NODE_STEP_M = 5.0


def recorded_line() -> DrivenLine:
    """Return the line of the whole recording, from the reference velocities."""
    drive = recording(FERRARI)
    return driven_line(drive.reference["velocity_x_mps"], drive.trace.yaw_rate_radps, drive.reference["velocity_y_mps"])


def section_of_line(line: DrivenLine, *, start_m: float, end_m: float, section_id: str) -> RoadSection:
    """Return a section along a driven line; a flat one, since the recording knows neither heights nor bank."""
    at = np.arange(start_m, end_m + NODE_STEP_M / 2.0, NODE_STEP_M)
    east = np.interp(at, line.distance_m, line.x_m)
    north = np.interp(at, line.distance_m, line.y_m)
    nodes = np.column_stack([east - east[0], north - north[0], np.zeros_like(at)])
    return build_section(section_id=section_id, name="A curve of a race track", nodes_m=nodes, speed_limit_mps=25.0)


def curve_section_and_trace() -> tuple[RoadSection, Trace]:
    """Return the curve as driven in one lap, and the trace of the next lap; skips where the recording is absent."""
    section = section_of_line(recorded_line(), start_m=CURVE_M[0], end_m=CURVE_M[1], section_id="ferrari-hairpin")
    return section, cut(recording(FERRARI).trace, *DRIVE_SAMPLES)

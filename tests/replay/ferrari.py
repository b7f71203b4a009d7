"""A real curve: the map from one lap of a race track, the drive from the next."""

from __future__ import annotations

from roadgrip.section import RoadSection
from roadgrip.units import SAMPLE_S
from tests.replay.recordings import FERRARI, recording
from vehicle_client.estimation.trace import Trace, part_of
from vehicle_client.mapmatch.driven_line import DrivenLine, driven_line
from vehicle_client.mapmatch.survey import section_of_line
from vehicle_client.recording.public import FERRARI_250LM

FERRARI_GEOMETRY = FERRARI_250LM.vehicle
CURVE_M = (2030.0, 2330.0)
"""A right-hander of 40 m radius and 190 degrees, in metres since the recording began."""
DRIVE_SAMPLES = (16100, 18050)
"""The same place one lap later, with 130 m of approach and 90 m of exit."""


def recorded_line() -> DrivenLine:
    """Return the line of the whole recording, from the reference velocities."""
    drive = recording(FERRARI)
    return driven_line(drive.reference["velocity_x_mps"], drive.trace.yaw_rate_radps, drive.reference["velocity_y_mps"])


def curve_section_and_trace() -> tuple[RoadSection, Trace]:
    """Return the curve as driven in one lap, and the trace of the next lap; skips where the recording is absent."""
    section = section_of_line(
        recorded_line(),
        start_m=CURVE_M[0],
        end_m=CURVE_M[1],
        section_id="ferrari-hairpin",
        name="A curve of a race track",
        speed_limit_mps=25.0,
    )
    first, beyond = DRIVE_SAMPLES
    return section, part_of(recording(FERRARI).trace, from_s=first * SAMPLE_S, to_s=(beyond - 1) * SAMPLE_S)

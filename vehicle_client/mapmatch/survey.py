"""A map from a drive: the line a vehicle took becomes a section, for a road that nobody has surveyed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.errors import SectionError
from roadgrip.section import RoadSection, build_section

if TYPE_CHECKING:
    from vehicle_client.mapmatch.driven_line import DrivenLine

NODE_STEP_M = 5.0


def section_of_line(
    line: DrivenLine, *, start_m: float, end_m: float, section_id: str, name: str, speed_limit_mps: float
) -> RoadSection:
    """Return a section along a driven line.

    It is flat and its bank unknown, since a line in the plane tells neither; it lies in coordinates of its own, so it
    has no anchors and vehicles match it by their motion.

    Args:
        line: The drive.
        start_m: Where the section begins, in metres driven.
        end_m: Where it ends.
        section_id: Its id.
        name: What people call it.
        speed_limit_mps: Its speed limit.

    Raises:
        SectionError: The drive has no such stretch, or no section can be made of it.
    """
    driven_m = float(line.distance_m[-1])
    if not 0.0 <= start_m < end_m <= driven_m:
        message = f"{start_m:.0f} to {end_m:.0f} m is no stretch of a drive of {driven_m:.0f} m"
        raise SectionError(message)
    at = np.linspace(start_m, end_m, round((end_m - start_m) / NODE_STEP_M) + 1)
    east = np.interp(at, line.distance_m, line.x_m)
    north = np.interp(at, line.distance_m, line.y_m)
    nodes = np.column_stack([east - east[0], north - north[0], np.zeros_like(at)])
    return build_section(section_id=section_id, name=name, nodes_m=nodes, speed_limit_mps=speed_limit_mps)

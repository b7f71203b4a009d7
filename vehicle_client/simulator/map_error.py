"""How the map that a vehicle is given differs from the road that it drives.

Bank and grade of a map come from a survey: right on average, wrong here by a little. The line itself is taken as
right, since a survey's decimetre changes no curvature that matters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from roadgrip.section import CROSS_SLOPE_LIMIT, build_section

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray
    from vehicle_client.simulator.amplitudes import Sensors

_LASTING_FRAC = 0.5
"""Share of the variance that is one constant error of the whole road: a datum, a sensor's tilt."""


def map_as_surveyed(section: RoadSection, *, rng: np.random.Generator, sensors: Sensors) -> RoadSection:
    """Return the map of a road as a survey brings it home: the same line with slightly wrong bank and grade.

    Either angle is off by a normal error of the stated standard deviation. One half of its variance is the same
    all along the road, the other half wanders as a first-order Gauss-Markov process with `map_memory_m`. The errors of
    bank and grade are independent. Heights follow from the wrong grade, the first one being right.

    The result is a section of its own, with its own version. One draw makes the map of one road: all vehicles are given
    the same one. A grade without map errors returns the section itself.

    Args:
        section: The road as it is.
        rng: Source of chance; take one that depends on the road alone.
        sensors: For the size of the errors.

    Raises:
        SectionError: With the errors the road would be none, such as one with a grade of several hundred per cent.
    """
    if sensors.map_bank_rad == sensors.map_grade_rad == 0.0:
        return section
    nodes = section.nodes_m.copy()
    steps = np.hypot(np.diff(nodes[:, 0]), np.diff(nodes[:, 1]))
    bank_error, grade_error = _wandering(rng, steps, memory_m=sensors.map_memory_m).T
    slope = np.tan(np.arctan(section.cross_slope_ratio) + sensors.map_bank_rad * bank_error)
    # Small angles: the surveyed rise between two nodes is off by the mean error of the grade between them.
    rise = steps * sensors.map_grade_rad * 0.5 * (grade_error[1:] + grade_error[:-1])
    nodes[1:, 2] += np.cumsum(rise)
    return build_section(
        section_id=section.section_id,
        name=section.name,
        nodes_m=nodes,
        speed_limit_mps=section.speed_limit_mps,
        cross_slope_ratio=np.clip(slope, -CROSS_SLOPE_LIMIT, CROSS_SLOPE_LIMIT),
        bank_origin=section.bank_origin,
        direction=section.direction,
        crs=section.crs,
        origin_m=section.origin_m,
        bank_cap_ratio=section.bank_cap_ratio,
        anchors=section.anchors,
    )


def _wandering(rng: np.random.Generator, steps_m: FloatArray, *, memory_m: float) -> FloatArray:
    """Return errors of unit size at the nodes: a part that lasts, and one that fades over `memory_m`. (n, 2)"""
    lasting, draws = rng.standard_normal(2), rng.standard_normal((len(steps_m) + 1, 2))
    keep = np.exp(-steps_m / memory_m)
    error = draws.copy()
    for k, kept in enumerate(keep, start=1):
        error[k] = kept * error[k - 1] + np.sqrt(1.0 - kept**2) * draws[k]
    mixed: FloatArray = np.sqrt(_LASTING_FRAC) * lasting + np.sqrt(1.0 - _LASTING_FRAC) * error
    return mixed

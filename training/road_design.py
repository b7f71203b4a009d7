"""A road as a designer describes it, and the section it becomes."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from roadgrip.alignment import CentreLine, Element, GradePoint, centre_line, runoff_sigma_m, smoothed_along
from roadgrip.geodesy import anchors_of
from roadgrip.section import BankOrigin, RoadSection, build_section, cross_slope_of_bank, inferred_bank_ratio

if TYPE_CHECKING:
    from roadgrip.units import FloatArray

CRS = "EPSG:25833"
_GRID_M = 0.5


@dataclass(frozen=True, slots=True)
class RoadDesign:
    """A road as design elements.

    Attributes:
        section_id: Also the name of its file.
        name: What people call it.
        elements: Plan, in the direction of travel.
        grades: Profile.
        start_heading_rad: Counter-clockwise from east.
        origin_m: East, north and height of the start in UTM zone 33.
        rated_speed_mps: Speed limit.
        node_step_m: About how far apart the nodes of the map lie.
    """

    section_id: str
    name: str
    elements: tuple[Element, ...]
    grades: tuple[GradePoint, ...]
    start_heading_rad: float
    origin_m: tuple[float, float, float]
    rated_speed_mps: float
    node_step_m: float


def designed_section(road: RoadDesign) -> RoadSection:
    """Return the section of a designed road, banked by the book and marked so.

    The bank follows the paper's formula, capped, and eases in and out along the road as a carriageway does.
    """
    line = _line_of(road)
    fine = centre_line(road.elements, node_step_m=_GRID_M)
    bank = inferred_bank_ratio(fine.curvature_1pm, speed_limit_mps=road.rated_speed_mps)
    cross_slope = smoothed_along(
        cross_slope_of_bank(bank, fine.curvature_1pm),
        step_m=float(fine.station_m[1]),
        sigma_m=runoff_sigma_m(road.rated_speed_mps),
    )
    cross_slope_at_nodes = np.interp(line.station_m, fine.station_m, cross_slope)
    return _section_of(road, line, cross_slope_ratio=cross_slope_at_nodes, bank_origin=BankOrigin.INFERRED)


def flat_section(road: RoadDesign) -> RoadSection:
    """Return the section of a designed line on a flat place, such as a proving ground: no cross slope, and known so."""
    line = _line_of(road)
    return _section_of(road, line, cross_slope_ratio=np.zeros_like(line.station_m), bank_origin=BankOrigin.MEASURED)


def _line_of(road: RoadDesign) -> CentreLine:
    return centre_line(
        road.elements, node_step_m=road.node_step_m, start_heading_rad=road.start_heading_rad, grades=road.grades
    )


def _section_of(
    road: RoadDesign, line: CentreLine, *, cross_slope_ratio: FloatArray, bank_origin: BankOrigin
) -> RoadSection:
    section = build_section(
        section_id=road.section_id,
        name=road.name,
        nodes_m=line.nodes_m,
        speed_limit_mps=road.rated_speed_mps,
        cross_slope_ratio=cross_slope_ratio,
        bank_origin=bank_origin,
        crs=CRS,
        origin_m=road.origin_m,
    )
    return dataclasses.replace(section, anchors=anchors_of(section))

"""The paper's three roads, reconstructed as design elements, since its own data are no longer to be had.

What the paper says of each road (length, range of radii, rated speed) is met; everything else is our reconstruction:
the order of the elements, the direction of the turns, the transitions, the heights, and the place, which is a
mountain valley in Norway where no such road lies. The smallest radii the paper quotes need up to 0.7 g at the rated
speed; they are taken for short extremes of turns that are mostly gentler.

The bank is inferred by the paper's own formula, capped at 8 %, as the paper did for its simulation: for a simulated
drive it *is* the bank of the road, yet it is marked as inferred and advice never counts on it.

`python -m training.paper_roads` writes the section files anew, byte for byte the same.
"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import roadgrip
from roadgrip.alignment import Element, GradePoint, centre_line, clothoid, runoff_sigma_m, smoothed_along, straight
from roadgrip.geodesy import anchors_of
from roadgrip.section import BankOrigin, RoadSection, build_section, cross_slope_of_bank, inferred_bank_ratio
from roadgrip.section_file import section_to_json
from roadgrip.units import deg_to_rad, kph_to_mps

SECTIONS_FOLDER = Path(roadgrip.__file__).parent / "sections"
CRS = "EPSG:25833"
_GRID_M = 0.5


@dataclass(frozen=True, slots=True)
class PaperRoad:
    """One road of the paper.

    Attributes:
        section_id: Also the name of its file.
        name: The paper's word for it.
        elements: Plan, in the direction of travel.
        grades: Profile.
        start_heading_rad: Counter-clockwise from east.
        origin_m: East, north and height of the start in UTM zone 33.
        rated_speed_mps: The paper's rated speed.
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


def _turn(*arcs: tuple[float, float], transitions_m: tuple[float, ...], sign: float = 1.0) -> tuple[Element, ...]:
    """Return a turn from straight to straight.

    Args:
        arcs: Length and radius of each arc.
        transitions_m: Lengths of the clothoids before, between and after the arcs; one more than there are arcs.
        sign: 1 for a left turn, -1 for a right turn.
    """
    curvature = [0.0, *(sign / radius for _, radius in arcs), 0.0]
    elements: list[Element] = []
    for i, length_m in enumerate(transitions_m):
        elements.append(clothoid(length_m, start_curvature_1pm=curvature[i], end_curvature_1pm=curvature[i + 1]))
        if i < len(arcs):
            elements.append(Element(arcs[i][0], curvature[i + 1], curvature[i + 1]))
    return tuple(elements)


ROADS: tuple[PaperRoad, ...] = (
    # 600 m, turning portions of radius 100 to 150 m, 80 km/h. Two portions with a gentler stretch between them.
    PaperRoad(
        section_id="long-turn",
        name="Long turn",
        elements=(
            straight(40.0),
            *_turn(
                (50.0, 150.0),
                (25.0, 100.0),
                (55.0, 130.0),
                (60.0, 450.0),
                (60.0, 140.0),
                (30.0, 115.0),
                transitions_m=(45.0, 20.0, 20.0, 35.0, 35.0, 20.0, 45.0),
            ),
            straight(60.0),
        ),
        grades=(GradePoint(0.0, -0.03), GradePoint(250.0, -0.01), GradePoint(400.0, 0.015), GradePoint(600.0, 0.03)),
        start_heading_rad=deg_to_rad(-70.0),
        origin_m=(251_200.0, 6_834_600.0, 905.0),
        rated_speed_mps=kph_to_mps(80.0),
        node_step_m=8.0,
    ),
    # Two curves, each close to 300 m with its transitions, radius 55 to 187 m, 70 km/h.
    PaperRoad(
        section_id="s-turn",
        name="S-turn",
        elements=(
            straight(20.0),
            *_turn(
                (50.0, 187.0), (25.0, 90.0), (12.0, 55.0), (30.0, 100.0), transitions_m=(50.0, 30.0, 18.0, 20.0, 45.0)
            ),
            *_turn(
                (40.0, 120.0),
                (15.0, 70.0),
                (15.0, 60.0),
                (25.0, 110.0),
                (15.0, 187.0),
                transitions_m=(45.0, 25.0, 10.0, 30.0, 20.0, 40.0),
                sign=-1.0,
            ),
            straight(20.0),
        ),
        grades=(GradePoint(0.0, -0.04), GradePoint(200.0, -0.05), GradePoint(350.0, -0.02), GradePoint(600.0, 0.01)),
        start_heading_rad=deg_to_rad(-120.0),
        origin_m=(238_900.0, 6_839_900.0, 780.0),
        rated_speed_mps=kph_to_mps(70.0),
        node_step_m=7.0,
    ),
    # 100 m of sharp curve, radius 20 to 43 m, 20 km/h.
    PaperRoad(
        section_id="sharp-turn",
        name="Sharp turn",
        elements=_turn(
            (16.0, 43.0), (12.0, 30.0), (6.0, 20.0), (14.0, 35.0), transitions_m=(12.0, 8.0, 6.0, 8.0, 18.0), sign=-1.0
        ),
        grades=(GradePoint(0.0, 0.04), GradePoint(50.0, 0.05), GradePoint(100.0, 0.03)),
        start_heading_rad=deg_to_rad(150.0),
        origin_m=(240_500.0, 6_845_000.0, 890.0),
        rated_speed_mps=kph_to_mps(20.0),
        node_step_m=2.5,
    ),
)


def paper_section(road: PaperRoad) -> RoadSection:
    """Return the section of one of the paper's roads."""
    line = centre_line(
        road.elements, node_step_m=road.node_step_m, start_heading_rad=road.start_heading_rad, grades=road.grades
    )
    fine = centre_line(road.elements, node_step_m=_GRID_M)
    bank = inferred_bank_ratio(fine.curvature_1pm, speed_limit_mps=road.rated_speed_mps)
    cross_slope = smoothed_along(
        cross_slope_of_bank(bank, fine.curvature_1pm),
        step_m=float(fine.station_m[1]),
        sigma_m=runoff_sigma_m(road.rated_speed_mps),
    )
    section = build_section(
        section_id=road.section_id,
        name=road.name,
        nodes_m=line.nodes_m,
        speed_limit_mps=road.rated_speed_mps,
        cross_slope_ratio=np.interp(line.station_m, fine.station_m, cross_slope),
        bank_origin=BankOrigin.INFERRED,
        crs=CRS,
        origin_m=road.origin_m,
    )
    return dataclasses.replace(section, anchors=anchors_of(section))


def main() -> None:
    """Write the section files."""
    SECTIONS_FOLDER.mkdir(exist_ok=True)
    for road in ROADS:
        section = paper_section(road)
        path = SECTIONS_FOLDER / f"{road.section_id}.json"
        path.write_text(section_to_json(section), encoding="utf-8")
        sys.stdout.write(
            f"{path.name}: {section.length_m:.1f} m, tightest radius {section.tightest_radius_m:.1f} m, "
            f"{len(section.nodes_m)} nodes, version {section.version}\n"
        )


if __name__ == "__main__":
    main()

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

import sys
from pathlib import Path

import roadgrip
from roadgrip.alignment import Element, GradePoint, clothoid, straight
from roadgrip.section_file import section_to_json
from roadgrip.units import deg_to_rad, kph_to_mps
from training.road_design import RoadDesign, designed_section

SECTIONS_FOLDER = Path(roadgrip.__file__).parent / "sections"


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


ROADS: tuple[RoadDesign, ...] = (
    # 600 m, turning portions of radius 100 to 150 m, 80 km/h. Two portions with a gentler stretch between them.
    RoadDesign(
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
    RoadDesign(
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
    RoadDesign(
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


def main() -> None:
    """Write the section files."""
    SECTIONS_FOLDER.mkdir(exist_ok=True)
    for road in ROADS:
        section = designed_section(road)
        path = SECTIONS_FOLDER / f"{road.section_id}.json"
        path.write_text(section_to_json(section), encoding="utf-8")
        sys.stdout.write(
            f"{path.name}: {section.length_m:.1f} m, tightest radius {section.tightest_radius_m:.1f} m, "
            f"{len(section.nodes_m)} nodes, version {section.version}\n"
        )


if __name__ == "__main__":
    main()

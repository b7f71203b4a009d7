"""Roads for tests: the packaged ones, and any road hypothesis can think of."""

import dataclasses

import numpy as np
from hypothesis import strategies as st

from roadgrip.alignment import Element, centre_line
from roadgrip.geodesy import anchors_of
from roadgrip.section import BankOrigin, Direction, RoadSection, build_section
from roadgrip.sections import read_section

PAPER_ROADS = ("long-turn", "s-turn", "sharp-turn")


def packaged(name: str) -> RoadSection:
    return read_section(name)


def circle_section(radius_m: float = 100.0, turn_rad: float = 2.0, step_m: float = 8.0, **changes) -> RoadSection:
    """A piece of a circle, left for a positive radius; everything about it is known in closed form."""
    count = max(4, round(abs(radius_m) * turn_rad / step_m) + 1)
    angle = np.linspace(0.0, turn_rad, count)
    nodes = np.column_stack([abs(radius_m) * np.sin(angle), radius_m * (1.0 - np.cos(angle)), 0.0 * angle])
    given = {
        "section_id": "circle",
        "name": "Circle",
        "nodes_m": nodes,
        "speed_limit_mps": 20.0,
        "cross_slope_ratio": None,
    }
    return build_section(**{**given, **changes})


@st.composite
def sections(draw) -> RoadSection:
    """Roads of a few elements with anything else a map may hold."""
    curvatures = draw(st.lists(st.floats(-0.04, 0.04), min_size=1, max_size=5))
    elements = [
        Element(draw(st.floats(20.0, 120.0)), a, b) for a, b in zip([0.0, *curvatures], [*curvatures, 0.0], strict=True)
    ]
    line = centre_line(elements, node_step_m=draw(st.floats(3.0, 10.0)), start_heading_rad=draw(st.floats(-4.0, 4.0)))
    height = draw(st.floats(-0.1, 0.1)) * line.station_m
    slopes = draw(st.floats(-0.1, 0.1)) * np.sin(line.station_m / 50.0)
    section = build_section(
        section_id=draw(st.text("abcdefghijklmnopqrstuvwxyz0123456789-", min_size=1, max_size=48)),
        name=draw(st.text(max_size=80).filter(str.isprintable)),
        nodes_m=np.column_stack([line.nodes_m[:, :2], height]),
        speed_limit_mps=draw(st.floats(1.0, 60.0)),
        cross_slope_ratio=slopes,
        bank_origin=draw(st.sampled_from(BankOrigin)),
        direction=draw(st.sampled_from(Direction)),
        crs=draw(st.sampled_from(["EPSG:25833", "EPSG:5973", "EPSG:32632"])),
        origin_m=(draw(st.floats(2e5, 8e5)), draw(st.floats(1e5, 8e6)), draw(st.floats(-100.0, 2000.0))),
        bank_cap_ratio=draw(st.floats(0.0, 0.25)),
    )
    return dataclasses.replace(section, anchors=anchors_of(section)) if draw(st.booleans()) else section

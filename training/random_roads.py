"""Roads that nobody has driven: random curved sections within the range the paper calls risky.

The paper picks its roads by a road authority's accident report: curves of 50 to 600 m with radii of 20 to 500 m. A
model that has seen three roads knows three roads; these are for everything that must hold on the next one.
"""

from __future__ import annotations

import numpy as np

from roadgrip.alignment import Element, GradePoint, clothoid, straight
from roadgrip.section import BANK_CAP_RATIO, SIDE_FRICTION, RoadSection
from roadgrip.units import kph_to_mps
from training.road_design import RoadDesign, designed_section

LENGTH_RANGE_M = (50.0, 600.0)
RADIUS_RANGE_M = (20.0, 500.0)
_SPEED_RANGE_KPH = (20.0, 80.0)
_SPEED_STEP_KPH = 10.0
_HASTE_RANGE = (0.9, 1.4)
"""Rated speed over the one the tightest radius is designed for: the paper's roads lie between 1.0 and 1.6."""
_CLEARANCE_M = 8.0
"""A road comes no nearer to itself than a carriageway is wide."""
_APART_M = 30.0
"""Along the road; nearer places are neighbours even in the tightest bend."""
_TRIES_COUNT = 200


def random_section(rng: np.random.Generator, *, section_id: str) -> RoadSection:
    """Return a curved section drawn at random.

    One to four turns; radii log-uniform, so that tight ones are as frequent as they matter; each turn eased in and
    out by clothoids; the rated speed rounded to 10 km/h. It keeps clear of itself.

    Args:
        rng: Source of chance.
        section_id: Its id and name.

    Raises:
        RuntimeError: No road within the range was drawn in many tries, which the ranges do not let happen.
    """
    for _ in range(_TRIES_COUNT):
        design = _draw_design(rng, section_id=section_id)
        length_m = sum(element.length_m for element in design.elements)
        if LENGTH_RANGE_M[0] <= length_m <= LENGTH_RANGE_M[1]:
            section = designed_section(design)
            if not _meets_itself(section):
                return section
    raise RuntimeError("no random road within the range of lengths that keeps clear of itself")


def drawn_rated_speed_mps(rng: np.random.Generator, *, tightest_radius_m: float) -> float:
    """Return a rated speed for a road: what bank and side friction of road design carry, and some haste on top.

    A multiple of 10 km/h from 20 to 80.

    Args:
        rng: Source of chance; one draw.
        tightest_radius_m: Of the road.
    """
    design_kph = np.sqrt(127.0 * tightest_radius_m * (BANK_CAP_RATIO + SIDE_FRICTION))
    rated_kph = round(design_kph * rng.uniform(*_HASTE_RANGE) / _SPEED_STEP_KPH) * _SPEED_STEP_KPH
    return kph_to_mps(float(np.clip(rated_kph, *_SPEED_RANGE_KPH)))


def _meets_itself(section: RoadSection) -> bool:
    """Return whether two places far apart along a road lie on top of each other."""
    profile = section.profile
    station_m = profile.station_m[::2]
    place = profile.x_m[::2] + 1j * profile.y_m[::2]
    near = np.abs(place[:, None] - place) < _CLEARANCE_M
    far = np.abs(station_m[:, None] - station_m) > _APART_M
    return bool((near & far).any())


def _draw_design(rng: np.random.Generator, *, section_id: str) -> RoadDesign:
    turns_count = int(rng.integers(1, 5))
    low_m, high_m = RADIUS_RANGE_M
    radii_m = np.exp(rng.uniform(np.log(low_m), np.log(high_m), turns_count))
    tightest_m = float(radii_m.min())
    rated_speed_mps = drawn_rated_speed_mps(rng, tightest_radius_m=tightest_m)
    elements: list[Element] = [straight(rng.uniform(5.0, 40.0))]
    sign = rng.choice([-1.0, 1.0])
    for radius_m in radii_m:
        angle_rad = rng.uniform(0.25, 1.9)
        easing_m = float(np.clip(rng.uniform(0.2, 0.6) * radius_m, 6.0, 60.0))
        arc_m = max(4.0, angle_rad * radius_m - easing_m)
        curvature_1pm = sign / radius_m
        elements += [
            clothoid(easing_m, start_curvature_1pm=0.0, end_curvature_1pm=curvature_1pm),
            Element(arc_m, curvature_1pm, curvature_1pm),
            clothoid(easing_m, start_curvature_1pm=curvature_1pm, end_curvature_1pm=0.0),
        ]
        # Two turns in a row go the other way more often than the same way.
        sign = sign if rng.random() < 0.35 else -sign
    elements.append(straight(rng.uniform(5.0, 30.0)))
    length_m = sum(element.length_m for element in elements)
    return RoadDesign(
        section_id=section_id,
        name=section_id,
        elements=tuple(elements),
        grades=(GradePoint(0.0, rng.uniform(-0.06, 0.06)), GradePoint(length_m, rng.uniform(-0.06, 0.06))),
        start_heading_rad=rng.uniform(-np.pi, np.pi),
        origin_m=(250_000.0, 6_830_000.0, 800.0),
        rated_speed_mps=rated_speed_mps,
        node_step_m=float(np.clip(tightest_m / 12.0, 2.0, 8.0)),
    )

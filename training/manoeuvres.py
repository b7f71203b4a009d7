"""What no ordinary driver does on an ordinary road: extreme manoeuvres, and pedals on a straight.

The paper tests its regressor on manoeuvres that its training never saw, after Lampe and Ziaukas: slalom, tight lane
change, ninety degree turn at relatively high speed, sine wave driving, at frictions from 0.2 to 1. It gives no
dimensions; ours are those of well-known tests where there is one. They lie on a flat proving ground. The centre line of
such a section is the path that is to be driven; its rated speed asks for nearly all that a dry road gives where it
bends most.

Straights are for the straight case of the sideslip observer, and for the brakes.

References:
    Langstrand and Rabi, Learning to cooperatively estimate road surface friction, section "Testing with extreme
    manoeuvres, unseen in training". ISO 3888-2:2011, Test track for a severe lane-change manoeuvre, obstacle avoidance
    (lanes of 12, 11 and 12 m, gates of 13.5 and 12.5 m between them, 61 m in all).
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import StrEnum
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from roadgrip.alignment import Element, clothoid, mirrored_elements, straight
from roadgrip.units import kph_to_mps, mps_to_kph
from training.road_design import RoadDesign, flat_section
from vehicle_client.simulator.plan import (
    ALL_SYSTEMS,
    NO_SYSTEMS,
    Braking,
    Driver,
    PassagePlan,
    SensorGrade,
    draw_driver,
    draw_plan,
)
from vehicle_client.simulator.vehicle import XC90, Vehicle

if TYPE_CHECKING:
    from roadgrip.section import RoadSection
    from roadgrip.units import FloatArray

MANOEUVRE_FRICTIONS_MU = tuple(round(0.20 + 0.05 * i, 2) for i in range(17))
"""The paper's range for extreme manoeuvres, 0.2 to 1, in the steps of its test matrix."""
RATED_ACCEL_MPS2 = 9.0
"""Lateral acceleration that the rated speed asks for at the tightest point of a manoeuvre."""
WITHOUT_SYSTEMS_FRAC = 0.5
"""Share of the test drives with the stability systems switched off, as far as they can be on a proving ground."""
_SPEED_STEP_KPH = 5.0
_HARDLY_MPS2 = 0.01
"""An order to brake that is fulfilled before it is felt."""
_PLACE_M = (262_000.0, 6_826_000.0, 520.0)
"""In the mountain valley of the paper's roads, where no proving ground lies."""
FADE_HALF_WAVES = 2.0
"""Over so many half waves a swerve swells and fades; over one alone its ends would bend half as much again."""
_NODE_STEP_M = 2.0
_PIECE_M = 0.5


class Manoeuvre(StrEnum):
    """The extreme manoeuvres of the paper."""

    SLALOM = "slalom"
    LANE_CHANGE = "lane-change"
    NINETY_DEGREES = "ninety-degrees"
    SINE = "sine"


class StraightCase(StrEnum):
    """What the pedals do on a straight."""

    CONSTANT_SPEED = "constant-speed"
    SOFT_BRAKING = "soft-braking"
    FULL_BRAKING = "full-braking"
    ACCELERATION = "acceleration"


class Swerve(NamedTuple):
    """A path that sways to and fro about a straight line.

    Attributes:
        half_wave_m: Distance between two crossings of the line.
        amplitude_m: Largest distance from it.
        half_waves_count: How often it sways, the swelling and the fading included.
    """

    half_wave_m: float
    amplitude_m: float
    half_waves_count: int


class LaneChange(NamedTuple):
    """A path to the next lane and back.

    Attributes:
        offset_m: From the middle of one lane to that of the other.
        there_m: Length of the way over. Longer than the gap between the lanes, for a car uses the width of them.
        beside_m: Length straight on in the other lane.
        back_m: Length of the way back.
    """

    offset_m: float
    there_m: float
    beside_m: float
    back_m: float


class Corner(NamedTuple):
    """A turn by ninety degrees.

    Attributes:
        radius_m: Of its arc.
        easing_m: Length of the clothoid before and behind the arc.
    """

    radius_m: float
    easing_m: float


Shape = Swerve | LaneChange | Corner

SHAPES: dict[Manoeuvre, Shape] = {
    # Cones 18 m apart, the distance of the tests of European magazines and clubs; a car two metres wide passes a
    # cone with 0.3 m to spare when its middle is 1.4 m beside it.
    Manoeuvre.SLALOM: Swerve(half_wave_m=18.0, amplitude_m=1.4, half_waves_count=9),
    # ISO 3888-2 for a car 2 m wide: lanes 2.45 m and 3 m wide, 1 m apart, so 3.7 m from middle to middle, of which a
    # car needs 3.5 m.
    Manoeuvre.LANE_CHANGE: LaneChange(offset_m=3.5, there_m=25.0, beside_m=3.0, back_m=24.0),
    Manoeuvre.NINETY_DEGREES: Corner(radius_m=20.0, easing_m=10.0),
    Manoeuvre.SINE: Swerve(half_wave_m=30.0, amplitude_m=3.0, half_waves_count=7),
}
"""One of each kind, driven by name."""
_LEAD_M = {Manoeuvre.SLALOM: 5.0, Manoeuvre.LANE_CHANGE: 12.0, Manoeuvre.NINETY_DEGREES: 15.0, Manoeuvre.SINE: 5.0}
"""Straight stretch at either end of the section, beyond the easing of the path itself."""


@cache
def manoeuvre_section(kind: Manoeuvre) -> RoadSection:
    """Return the section of the named manoeuvre; its id is the kind's name."""
    return _section_of(kind, SHAPES[kind], section_id=kind.value, to_the_left=True)


def manoeuvre_sections() -> tuple[RoadSection, ...]:
    """Return the sections of all four named manoeuvres."""
    return tuple(manoeuvre_section(kind) for kind in Manoeuvre)


def draw_manoeuvre(rng: np.random.Generator, kind: Manoeuvre, *, section_id: str) -> RoadSection:
    """Return a variant of a manoeuvre: cones 18 to 36 m apart, lanes 3 to 3.7 m apart, radii of 15 to 25 m, mirrored.

    Args:
        rng: Source of chance.
        kind: Which manoeuvre.
        section_id: Its id and name.
    """
    shape: Shape
    if kind is Manoeuvre.SLALOM:
        shape = Swerve(
            half_wave_m=rng.uniform(18.0, 36.0),
            amplitude_m=rng.uniform(1.2, 1.7),
            half_waves_count=int(rng.integers(6, 11)),
        )
    elif kind is Manoeuvre.LANE_CHANGE:
        shape = LaneChange(
            offset_m=rng.uniform(3.0, 3.7),
            there_m=rng.uniform(22.0, 32.0),
            beside_m=rng.uniform(2.0, 11.0),
            back_m=rng.uniform(20.0, 30.0),
        )
    elif kind is Manoeuvre.NINETY_DEGREES:
        shape = Corner(radius_m=rng.uniform(15.0, 25.0), easing_m=rng.uniform(7.0, 12.0))
    else:
        half_wave_m = rng.uniform(22.0, 40.0)
        shape = Swerve(
            half_wave_m=half_wave_m,
            amplitude_m=rng.uniform(0.07, 0.11) * half_wave_m,
            half_waves_count=int(rng.integers(5, 10)),
        )
    return _section_of(kind, shape, section_id=section_id, to_the_left=bool(rng.random() < 0.5))


@cache
def straight_section() -> RoadSection:
    """Return 300 m of flat straight road, rated 80 km/h. Only a vehicle with position fixes recognises it."""
    return flat_section(
        RoadDesign(
            section_id="straight",
            name="Straight",
            elements=(straight(300.0),),
            grades=(),
            start_heading_rad=0.3,
            origin_m=_PLACE_M,
            rated_speed_mps=kph_to_mps(80.0),
            node_step_m=10.0,
        )
    )


def draw_test_driver(rng: np.random.Generator, *, base_friction_mu: float) -> Driver:
    """Return a driver who tries what the car can do.

    He sees the surface as everybody does, through a lognormal error of 35 %, and uses 80 to 110 % of what he sees; he
    shuns no lateral acceleration that tyres can give, brakes late, looks at the next gate rather than far ahead, and
    is not put off by tyres that begin to slide. The true friction enters nowhere else.

    Args:
        rng: Source of chance; every call takes the same number of draws.
        base_friction_mu: What the surface offers a new tyre.
    """
    return draw_driver(rng, base_friction_mu=base_friction_mu)._replace(
        grip_share_ratio=rng.uniform(0.8, 1.1),
        comfort_accel_mps2=rng.uniform(9.0, 12.0),
        braking_mps2=rng.uniform(2.5, 4.5),
        preview_s=rng.uniform(0.45, 0.75),
        steer_lag_s=rng.uniform(0.06, 0.12),
        slide_feeling_ratio=rng.uniform(0.8, 1.2),
    )


def draw_extreme_plan(
    rng: np.random.Generator,
    *,
    section: RoadSection,
    base_friction_mu: float,
    grade: SensorGrade = SensorGrade.AUTOMOTIVE,
    with_gnss: bool = True,
    vehicle: Vehicle = XC90,
) -> PassagePlan:
    """Return the plan of one extreme drive.

    Speed and wear are drawn as in the paper's matrix, the driver by `draw_test_driver`. Half of the drives are without
    stability systems, which keep the sideslip small where they work.

    Args:
        rng: Source of chance; every call takes the same number of draws.
        section: A manoeuvre.
        base_friction_mu: What the surface offers a new tyre.
        grade: Which sensors the vehicle carries.
        with_gnss: Whether the trace shall hold position fixes. Without, a car that slides far is not recognised on so
            short a section.
        vehicle: The car.
    """
    plan = draw_plan(
        rng, section=section, base_friction_mu=base_friction_mu, grade=grade, with_gnss=with_gnss, vehicle=vehicle
    )
    driver = draw_test_driver(rng, base_friction_mu=base_friction_mu)
    stability = NO_SYSTEMS if rng.random() < WITHOUT_SYSTEMS_FRAC else ALL_SYSTEMS
    return replace(plan, driver=driver, stability=stability)


def draw_straight_plan(
    rng: np.random.Generator,
    *,
    case: StraightCase,
    base_friction_mu: float,
    grade: SensorGrade = SensorGrade.AUTOMOTIVE,
    vehicle: Vehicle = XC90,
) -> PassagePlan:
    """Return the plan of one drive over `straight_section`, with position fixes.

    Soft braking asks for 1 to 2.5 m/s2 and is not softer for a slippery road; full braking for all that the brakes
    have. Both end at a fifth to a half of the speed before, so that the drive goes on. Who accelerates starts at two
    thirds of the drawn speed and is ordered to go on with the whole of it: an order to brake that is fulfilled at once.

    Args:
        rng: Source of chance; every call takes the same number of draws.
        case: What the pedals do.
        base_friction_mu: What the surface offers a new tyre.
        grade: Which sensors the vehicle carries.
        vehicle: The car.
    """
    plan = draw_plan(
        rng,
        section=straight_section(),
        base_friction_mu=base_friction_mu,
        grade=grade,
        with_gnss=True,
        vehicle=vehicle,
    )
    station_m, soft_mps2, end_frac = rng.uniform(30.0, 80.0), rng.uniform(1.0, 2.5), rng.uniform(0.2, 0.5)
    speed_mps = plan.target_speed_mps or straight_section().speed_limit_mps
    if case is StraightCase.SOFT_BRAKING:
        order = Braking(station_m=station_m, decel_mps2=soft_mps2, end_speed_mps=end_frac * speed_mps)
    elif case is StraightCase.FULL_BRAKING:
        order = Braking(station_m=station_m, decel_mps2=vehicle.brake_limit_mps2, end_speed_mps=end_frac * speed_mps)
    elif case is StraightCase.ACCELERATION:
        speed_mps *= 2.0 / 3.0
        order = Braking(station_m=station_m, decel_mps2=_HARDLY_MPS2, end_speed_mps=1.5 * speed_mps)
    else:
        return plan
    return replace(plan, target_speed_mps=speed_mps, braking=order)


def _section_of(kind: Manoeuvre, shape: Shape, *, section_id: str, to_the_left: bool) -> RoadSection:
    lead = straight(_LEAD_M[kind])
    elements = (lead, *_elements_of(shape), lead)
    if not to_the_left:
        elements = mirrored_elements(elements)
    sharpest_1pm = max(max(abs(e.start_curvature_1pm), abs(e.end_curvature_1pm)) for e in elements)
    rated_kph = mps_to_kph(math.sqrt(RATED_ACCEL_MPS2 / sharpest_1pm))
    return flat_section(
        RoadDesign(
            section_id=section_id,
            name=section_id.replace("-", " ").capitalize(),
            elements=elements,
            grades=(),
            start_heading_rad=0.3,
            origin_m=_PLACE_M,
            rated_speed_mps=kph_to_mps(_SPEED_STEP_KPH * round(rated_kph / _SPEED_STEP_KPH)),
            node_step_m=_NODE_STEP_M,
        )
    )


def _elements_of(shape: Shape) -> tuple[Element, ...]:
    if isinstance(shape, Corner):
        curvature = 1.0 / shape.radius_m
        # The clothoids turn by half of what an arc as long as they would turn.
        arc_m = shape.radius_m * math.pi / 2.0 - shape.easing_m
        return (
            clothoid(shape.easing_m, start_curvature_1pm=0.0, end_curvature_1pm=curvature),
            Element(arc_m, curvature, curvature),
            clothoid(shape.easing_m, start_curvature_1pm=curvature, end_curvature_1pm=0.0),
        )
    if isinstance(shape, LaneChange):
        way_m = shape.there_m + shape.beside_m + shape.back_m
        x_m = np.linspace(0.0, way_m, _points_count(way_m))
        there = _swell(x_m / shape.there_m)
        back = _swell((x_m - shape.there_m - shape.beside_m) / shape.back_m)
        return _elements_of_path(x_m, shape.offset_m * (there - back))
    way_m = shape.half_wave_m * shape.half_waves_count
    x_m = np.linspace(0.0, way_m, _points_count(way_m))
    fade_m = FADE_HALF_WAVES * shape.half_wave_m
    swell = _swell(x_m / fade_m) * _swell((way_m - x_m) / fade_m)
    return _elements_of_path(x_m, shape.amplitude_m * swell * np.sin(np.pi * x_m / shape.half_wave_m))


def _swell(part: FloatArray) -> FloatArray:
    """Return the smooth step from 0 to 1 whose slope and curvature vanish at both ends."""
    t = np.clip(part, 0.0, 1.0)
    step: FloatArray = t**3 * (10.0 - 15.0 * t + 6.0 * t**2)
    return step


def _points_count(way_m: float) -> int:
    return round(way_m / 0.02) + 1


def _elements_of_path(x_m: FloatArray, y_m: FloatArray) -> tuple[Element, ...]:
    """Return a path that is given by its distance from a straight line, in short pieces of linear curvature."""
    heading = np.arctan(np.gradient(y_m, x_m))
    station = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x_m), np.diff(y_m)))])
    curvature = np.gradient(heading, station)
    ends = np.linspace(0.0, station[-1], round(float(station[-1]) / _PIECE_M) + 1)
    at_ends = np.interp(ends, station, curvature)
    at_ends[0] = at_ends[-1] = 0.0
    piece_m = float(ends[1])
    return tuple(
        clothoid(piece_m, start_curvature_1pm=float(a), end_curvature_1pm=float(b)) for a, b in pairwise(at_ends)
    )

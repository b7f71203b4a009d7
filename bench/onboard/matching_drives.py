"""Drives over roads that nobody has driven, as dead reckoning sees them: whole, torn off, or ten minutes long."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from roadgrip.records import Reason, Rejected
from roadgrip.section import RoadSection
from roadgrip.units import SAMPLE_S, BoolArray, FloatArray
from training.random_roads import random_section
from vehicle_client.estimation.observer import XC90_PARAMETERS
from vehicle_client.estimation.signals import unmapped_speed_mps, unmapped_velocity_y_mps
from vehicle_client.estimation.trace import Trace
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.estimation.vertical import vertical_velocity_mps
from vehicle_client.mapmatch.driven_line import DrivenLine, driven_line, with_course
from vehicle_client.pipeline import summarise_passage
from vehicle_client.simulator.amplitudes import AUTOMOTIVE
from vehicle_client.simulator.map_error import map_as_surveyed
from vehicle_client.simulator.run import draw_plan, simulate_passage

SEED = 20270811
"""Of all roads and drives here. The weights of the matching come from roads of another seed."""
FRICTION_RANGE_MU = (0.2, 0.8)
TURN_RADIUS_M, TURN_SPEED_MPS = 6.0, 4.0


@dataclass(frozen=True)
class Leg:
    """A drive, or a piece of one, from sensors to what dead reckoning needs. All arrays (n,).

    Attributes:
        speed_mps: From the encoders.
        yaw_rate_radps: As the gyro says.
        climb_mps: Vertical velocity from the forward accelerometer.
        velocity_y_mps: Lateral velocity, estimated as on a level road.
        station_m: True, along the road driven; NaN where it is no part of that road.
    """

    speed_mps: FloatArray
    yaw_rate_radps: FloatArray
    climb_mps: FloatArray
    velocity_y_mps: FloatArray
    station_m: FloatArray

    @cached_property
    def time_s(self) -> FloatArray:
        """Every 10 ms."""
        return SAMPLE_S * np.arange(len(self.speed_mps), dtype=np.float64)

    @cached_property
    def line(self) -> DrivenLine:
        """It as a line, with heights."""
        line = driven_line(self.speed_mps, self.yaw_rate_radps, None, self.climb_mps)
        return with_course(line, speed_mps=self.speed_mps, velocity_y_mps=self.velocity_y_mps)

    @cached_property
    def plane_line(self) -> DrivenLine:
        """It as a line without heights."""
        return replace(self.line, height_m=None)

    def where(self, kept: BoolArray) -> Leg:
        """Return a piece of it."""
        return Leg(
            self.speed_mps[kept],
            self.yaw_rate_radps[kept],
            self.climb_mps[kept],
            self.velocity_y_mps[kept],
            self.station_m[kept],
        )

    def elsewhere(self) -> Leg:
        """Return it as a drive over a road that is not asked about."""
        return replace(self, station_m=np.full_like(self.station_m, np.nan))


@dataclass(frozen=True, slots=True)
class Driven:
    """One road, its map, and one drive over it.

    Attributes:
        section: As it is.
        road_map: As surveyed.
        leg: The drive.
        completed: Whether it passed the section.
        client_refusal: Why the whole client refuses it, if it does.
    """

    section: RoadSection
    road_map: RoadSection
    leg: Leg
    completed: bool
    client_refusal: Reason | None


def driven_road(number: int) -> Driven:
    """Return the road and the drive of a number."""
    rng = np.random.default_rng([SEED, number])
    section = random_section(rng, section_id=f"road-{number}")
    plan = draw_plan(rng, section=section, base_friction_mu=rng.uniform(*FRICTION_RANGE_MU), with_gnss=False)
    drive = simulate_passage(section, plan)
    road_map = surveyed(section, number)
    outcome = summarise_passage(drive.trace, road_map)
    return Driven(
        section=section,
        road_map=road_map,
        leg=leg_of(drive.trace, drive.truth.station_m),
        completed=drive.completed,
        client_refusal=outcome.reason if isinstance(outcome, Rejected) else None,
    )


def surveyed(section: RoadSection, number: int) -> RoadSection:
    """Return the map of a road, the errors of the survey drawn for this number."""
    return map_as_surveyed(section, rng=np.random.default_rng([SEED, 1, number]), sensors=AUTOMOTIVE)


def leg_of(trace: Trace, station_m: FloatArray) -> Leg:
    """Return a drive as the client reckons it before it knows the section."""
    speed = unmapped_speed_mps(trace, vehicle=XC90, parameters=XC90_PARAMETERS)
    climb = vertical_velocity_mps(trace.accel_x_mps2, speed, trace.yaw_rate_radps)
    aside = unmapped_velocity_y_mps(trace, vehicle=XC90, parameters=XC90_PARAMETERS)
    if aside is None:
        message = "a simulated car has a lateral accelerometer"
        raise ValueError(message)
    return Leg(speed, trace.yaw_rate_radps, climb, aside, station_m)


def joined(legs: Sequence[Leg]) -> Leg:
    """Return drives one after the other; each keeps the offsets of its own sensors."""
    return Leg(
        np.concatenate([leg.speed_mps for leg in legs]),
        np.concatenate([leg.yaw_rate_radps for leg in legs]),
        np.concatenate([leg.climb_mps for leg in legs]),
        np.concatenate([leg.velocity_y_mps for leg in legs]),
        np.concatenate([leg.station_m for leg in legs]),
    )


def wandering(driven: Driven, rng: np.random.Generator, *, wander_m: float, cut_m: float) -> Leg:
    """Return the drive of a driver who does not keep to the middle of his lane.

    The simulated driver stays within centimetres of the line, people do not. To his motion is added that of a smooth
    random distance from it, and of cutting every bend in proportion to its curvature.

    Args:
        driven: The drive.
        rng: Source of chance.
        wander_m: Standard deviation of the random part; waves of some 100 m.
        cut_m: Distance by which the sharpest bend is cut.
    """
    # The course turns with the nose: whoever wanders slides no more for it.
    leg, profile = driven.leg, driven.section.profile
    at = np.arange(leg.station_m.min() - 200.0, leg.station_m.max() + 200.0)
    curvature = np.interp(at, profile.station_m, profile.curvature_1pm, left=0.0, right=0.0)
    bend = np.convolve(curvature, _bell(15.0) / _bell(15.0).sum(), mode="same")
    noise = np.convolve(rng.standard_normal(len(at)), _bell(25.0) / np.sqrt((_bell(25.0) ** 2).sum()), mode="same")
    aside = wander_m * noise + cut_m * bend / float(np.abs(bend).max())
    turned = np.interp(leg.station_m, at, np.gradient(aside, at))
    shorter = np.interp(leg.station_m, at, curvature * aside)
    return replace(
        leg,
        speed_mps=leg.speed_mps * (1.0 - shorter),
        yaw_rate_radps=leg.yaw_rate_radps + np.gradient(turned, SAMPLE_S),
    )


def _bell(width_m: float) -> FloatArray:
    reach = int(4.0 * width_m)
    return np.exp(-0.5 * (np.arange(-reach, reach + 1) / width_m) ** 2)


def ended(driven: Driven, share: float) -> Leg:
    """Return the drive up to a share of the section."""
    return driven.leg.where(driven.leg.station_m < share * driven.section.length_m)


def begun(driven: Driven, share: float) -> Leg:
    """Return the drive from a share of the section on."""
    return driven.leg.where(driven.leg.station_m >= share * driven.section.length_m)


def left_for(driven: Driven, other: Driven, share: float) -> Leg:
    """Return the drive up to a share of the section, a turn by sixty degrees off it, and another road from there."""
    on_it = ended(driven, share)
    return joined(
        [on_it, _turn(np.pi / 3.0, side=1.0 if other.leg.line.heading_rad[-1] > 0.0 else -1.0), other.leg.elsewhere()]
    )


def turned_round(driven: Driven, share: float) -> Leg:
    """Return the drive up to a share of the section, a turn on the spot, and the way back."""
    there = ended(driven, share)
    back = Leg(
        there.speed_mps[::-1],
        -there.yaw_rate_radps[::-1],
        -there.climb_mps[::-1],
        there.velocity_y_mps[::-1],
        np.full_like(there.station_m, np.nan),
    )
    return joined([there, _turn(np.pi, side=1.0), back])


def _turn(angle_rad: float, *, side: float) -> Leg:
    rate = TURN_SPEED_MPS / TURN_RADIUS_M
    count = round(angle_rad / rate / SAMPLE_S)
    still = np.zeros(count)
    return Leg(np.full(count, TURN_SPEED_MPS), np.full(count, side * rate), still, still, np.full(count, np.nan))


def long_drive(
    drives: Sequence[Driven], rng: np.random.Generator, *, about: int, times_count: int, duration_s: float
) -> Leg:
    """Return a drive of some minutes over many roads, one of them so many times.

    Args:
        drives: To choose from, all completed.
        rng: Source of chance.
        about: Which road is asked about.
        times_count: How often it is driven.
        duration_s: Of the whole.
    """
    legs = [drives[about].leg] * times_count
    spent_s = sum(len(leg.speed_mps) for leg in legs) * SAMPLE_S
    while spent_s < duration_s:
        other = int(rng.integers(len(drives)))
        if other != about:
            legs.append(drives[other].leg.elsewhere())
            spent_s += len(legs[-1].speed_mps) * SAMPLE_S
    return joined([legs[k] for k in rng.permutation(len(legs))])

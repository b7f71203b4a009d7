"""Other ways of estimating the sideslip, beside the one that runs in the vehicle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bench.onboard.drives import Watched
from roadgrip.section import RoadSection, build_section
from vehicle_client.estimation.observer import PAPER_PARAMETERS, XC90_PARAMETERS, ObserverParameters
from vehicle_client.estimation.offsets import NO_OFFSETS
from vehicle_client.estimation.signals import kinematic_signals
from vehicle_client.estimation.summary import KinematicSignals
from vehicle_client.pipeline import Summarised


def with_widths(parameters: ObserverParameters, factor: float) -> ObserverParameters:
    """Return the constants with the six widths of F(t) multiplied: 0 makes F zero in motion, infinity makes it one."""
    names = (
        "sigma_yaw_rate_radps",
        "sigma_yaw_accel_radps2",
        "sigma_steer_rad",
        "sigma_steer_rate_radps",
        "sigma_sideslip_rate_radps",
        "sigma_sideslip_accel_radps2",
    )
    return replace(parameters, **{name: factor * getattr(parameters, name) for name in names})


@dataclass(frozen=True, slots=True)
class Variant:
    """One way of estimating beside the default.

    Attributes:
        words: For a reader.
        parameters: Of the observer.
        with_offsets: Whether what the straight approach tells is subtracted.
        map_of: The map used, from the vehicle's and the true one.
    """

    words: str
    parameters: ObserverParameters = XC90_PARAMETERS
    with_offsets: bool = True
    map_of: Callable[[Watched, RoadSection], RoadSection] = lambda watched, _: watched.road_map


def without_bank(section: RoadSection) -> RoadSection:
    """Return the map of a road that says nothing of its bank."""
    return build_section(
        section_id=section.section_id,
        name=section.name,
        nodes_m=section.nodes_m,
        speed_limit_mps=section.speed_limit_mps,
        cross_slope_ratio=np.zeros(len(section.nodes_m)),
        direction=section.direction,
        crs=section.crs,
        origin_m=section.origin_m,
        bank_cap_ratio=section.bank_cap_ratio,
        anchors=section.anchors,
    )


def of_another_car(factor: float) -> ObserverParameters:
    """Return the constants with the slip gradient of the rear axle wrong by a factor."""
    return replace(XC90_PARAMETERS, rear_slip_gradient_s2pm=factor * XC90_PARAMETERS.rear_slip_gradient_s2pm)


VARIANTS: Mapping[str, Variant] = {
    "pull_to_zero": Variant("F pulls to zero, as in the paper", PAPER_PARAMETERS),
    "f_zero": Variant("F = 0: nothing is pulled", with_widths(XC90_PARAMETERS, 1e-6)),
    "f_one": Variant("F = 1: pulled all the time", with_widths(XC90_PARAMETERS, 1e6)),
    "f_one_to_zero": Variant("F = 1, to zero", with_widths(PAPER_PARAMETERS, 1e6)),
    "stiffer_tyres": Variant("rear tyres taken for 30 % stiffer than they are", of_another_car(0.7)),
    "softer_tyres": Variant("rear tyres taken for 30 % softer than they are", of_another_car(1.3)),
    "no_offsets": Variant("no offsets subtracted", with_offsets=False),
    "no_bank": Variant("a map without bank", map_of=lambda watched, _: without_bank(watched.road_map)),
    "true_map": Variant("a map without error", map_of=lambda _, section: section),
}


def varied_signals(watched: Watched, result: Summarised, variant: Variant, *, section: RoadSection) -> KinematicSignals:
    """Return the signals of a drive estimated another way.

    Args:
        watched: The drive.
        result: What the client made of it.
        variant: The other way.
        section: The road as it is.
    """
    return kinematic_signals(
        watched.drive.trace,
        variant.map_of(watched, section),
        station_m=result.match.station_m,
        vehicle=watched.run.geometry,
        parameters=variant.parameters,
        offsets=result.offsets if variant.with_offsets else NO_OFFSETS,
    )

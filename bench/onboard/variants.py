"""Other ways of estimating the sideslip, beside the one that runs in the vehicle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bench.onboard.drives import Watched
from roadgrip.section import RoadSection, build_section
from roadgrip.units import FloatArray
from vehicle_client.estimation.filters import smoothed
from vehicle_client.estimation.observer import (
    PAPER_PARAMETERS,
    ObserverParameters,
    observed_velocity_mps,
    sideslip_rad,
)
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
    parameters: ObserverParameters = PAPER_PARAMETERS
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


VARIANTS: Mapping[str, Variant] = {
    "f_zero": Variant("F = 0: nothing pulls the lateral velocity to zero", with_widths(PAPER_PARAMETERS, 1e-6)),
    "f_one": Variant("F = 1: it is always pulled", with_widths(PAPER_PARAMETERS, 1e6)),
    "no_offsets": Variant("no offsets subtracted", with_offsets=False),
    "no_bank": Variant("a map without bank", map_of=lambda watched, _: without_bank(watched.road_map)),
    "true_map": Variant("a map without error", map_of=lambda _, section: section),
}
STEADY = "steady"
STEADY_WORDS = "F pulls to the sideslip of this car in a steady bend"
REAR_COMPLIANCE_S2PM = 0.007
"""Rear slip angle per lateral acceleration while the tyres are far from their limit, of the simulated car: its rear
tyres give 15 times their load per radian."""


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


def steadied_sideslip_rad(watched: Watched, signals: KinematicSignals) -> FloatArray:
    """Return the sideslip of an observer whose F pulls to that of a steady bend, on this car's tyres, not to zero. (n,)

    In a steady bend far from the limit the rear axle runs along its circle but for the slip angle that its tyres need:
    V_y = b_rear omega_z - c V A_y. The observer is linear in its inputs, so what F times that adds is its answer to
    that input alone.
    """
    car, zero = watched.run.geometry, np.zeros_like(signals.yaw_rate_radps)
    accel_y = signals.yaw_rate_radps * signals.speed_mps
    steady = (
        car.wheelbase_m - car.front_axle_m
    ) * signals.yaw_rate_radps - REAR_COMPLIANCE_S2PM * signals.speed_mps * accel_y
    _, added = observed_velocity_mps(
        zero,
        signals.straightness_1ps * steady,
        signals.yaw_rate_radps,
        zero,
        signals.straightness_1ps,
        parameters=PAPER_PARAMETERS,
    )
    return sideslip_rad(signals.velocity_x_mps, signals.velocity_y_mps + smoothed(added))

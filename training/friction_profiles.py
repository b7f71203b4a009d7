"""Friction that is not the same all along a road: two turns of different friction, and patches under single wheels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vehicle_client.simulator.plan import FrictionProfile

if TYPE_CHECKING:
    from roadgrip.section import RoadSection

HIGHER_BY_MU = 0.2
"""How much more friction the grippier turn offers. At every base friction of the test matrix it is more than what tyre
wear spreads: a worn tyre in the grippier turn finds more than a new one in the other."""
TRANSITION_M = 20.0
"""Length over which one friction passes into the other, about the point where the road turns over."""
TURN_MIN_RAD = 0.05
"""What turns less is no turn."""
LIKE_TURNS_RATIO = 0.6
"""Of their largest curvatures: turns that are like each other."""
PATCH_LENGTHS_M = (3.0, 30.0)
PATCH_RATIOS = (0.3, 0.8)
"""Friction of a patch over that of the road around it: from ice on asphalt to a little slush."""
PATCH_EDGE_M = 1.0
_GRID_M = 0.5


def two_frictions(section: RoadSection, *, base_friction_mu: float, slippery_first: bool = False) -> FrictionProfile:
    """Return the friction of the paper's fourth scenario: higher in the first turn, the base friction in the second.

    The paper drives the S-turn "with lower friction in one turn and a higher friction in the other", and calls the
    lesser one the truth. Which turn, and by how much, it does not say. Our reading: grip first, then less. Drivers then
    enter the slippery turn as fast as the grippy one let them, which is the case such a system is for; and both turns
    tell of their friction, whereas a driver who has slid in the first turn would creep through a grippy second one. The
    lowest friction experienced is the base friction times wear, as on the same road with one friction.

    Args:
        section: A road that turns over at least once.
        base_friction_mu: What the slippery turn offers a new tyre.
        slippery_first: The other way round: the base friction in the first turn, more in the second.

    Raises:
        ValueError: The road never turns over.
    """
    station_m = turnover_m(section)
    at_m = np.array([station_m - TRANSITION_M / 2.0, station_m + TRANSITION_M / 2.0])
    mu = np.array([base_friction_mu + HIGHER_BY_MU, base_friction_mu])
    if slippery_first:
        mu = mu[::-1].copy()
    return FrictionProfile(station_m=at_m, left_mu=mu, right_mu=mu)


def has_like_turns(section: RoadSection) -> bool:
    """Return whether a road turns over, with turns about as sharp on both sides of that place.

    A turn that is much gentler asks so little of the road that its friction shows in nothing, neither to a driver nor
    to a sensor; nobody could learn to tell it.
    """
    try:
        station_m = turnover_m(section)
    except ValueError:
        return False
    profile = section.profile
    sharpness = np.abs(profile.curvature_1pm)
    first, second = (sharpness[part].max() for part in (profile.station_m < station_m, profile.station_m >= station_m))
    return bool(min(first, second) >= LIKE_TURNS_RATIO * max(first, second))


def turnover_m(section: RoadSection) -> float:
    """Return the station where a road passes from one turn to the next, the one that parts the most turning.

    Args:
        section: A road that turns over at least once.

    Raises:
        ValueError: The road never turns over.
    """
    profile = section.profile
    curvature = profile.curvature_1pm
    heading = profile.heading_rad
    after = np.flatnonzero(curvature[1:] * curvature[:-1] < 0.0) + 1
    parted = np.minimum(np.abs(heading[after] - heading[0]), np.abs(heading[-1] - heading[after]))
    # On a straight the curvature of a map changes its sign all the time, by the rounding of its nodes.
    if len(after) == 0 or parted.max() < TURN_MIN_RAD:
        message = f"section {section.section_id!r} turns one way only"
        raise ValueError(message)
    i = int(after[np.argmax(parted)])
    part = curvature[i - 1] / (curvature[i - 1] - curvature[i])
    return float(profile.station_m[i - 1] + part * (profile.station_m[i] - profile.station_m[i - 1]))


def patches(
    rng: np.random.Generator, *, section: RoadSection, base_friction_mu: float, patches_count: int = 3
) -> FrictionProfile:
    """Return a road with slippery patches, each under the left wheels, the right ones, or both.

    Where patches overlap the slipperier one counts. Before and behind the section the road is whole.

    Args:
        rng: Source of chance.
        section: The road.
        base_friction_mu: What it offers a new tyre beside the patches.
        patches_count: Number of patches.
    """
    station = np.arange(-PATCH_EDGE_M, section.length_m + PATCH_EDGE_M + _GRID_M, _GRID_M)
    ratios = np.ones((2, len(station)))
    for _ in range(patches_count):
        length_m = min(rng.uniform(*PATCH_LENGTHS_M), section.length_m)
        start_m = rng.uniform(0.0, section.length_m - length_m)
        ratio = rng.uniform(*PATCH_RATIOS)
        edges = [start_m - PATCH_EDGE_M, start_m, start_m + length_m, start_m + length_m + PATCH_EDGE_M]
        patch = np.interp(station, edges, [1.0, ratio, ratio, 1.0])
        tracks = ((0,), (1,), (0, 1))[int(rng.integers(3))]
        for track in tracks:
            ratios[track] = np.minimum(ratios[track], patch)
    return FrictionProfile(
        station_m=station, left_mu=base_friction_mu * ratios[0], right_mu=base_friction_mu * ratios[1]
    )

"""Random roads, whatever the chance: within the paper's range of risk, and such that they can be built and driven."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from roadgrip.section import BANK_CAP_RATIO, BankOrigin, RoadSection
from roadgrip.units import FloatArray, kph_to_mps
from training.random_roads import LENGTH_RANGE_M, RADIUS_RANGE_M, random_section

seeds = st.integers(0, 2**32)


def section_of(seed: int) -> RoadSection:
    return random_section(np.random.default_rng(seed), section_id=f"road-{seed}")


@given(seeds)
def test_length_and_radii_are_those_that_the_paper_calls_risky(seed: int) -> None:
    section = section_of(seed)
    assert LENGTH_RANGE_M[0] - 0.5 <= section.length_m <= LENGTH_RANGE_M[1] + 0.5
    # The spline through the nodes bends a little more than the design at the ends of an arc.
    assert 0.93 * RADIUS_RANGE_M[0] <= section.tightest_radius_m <= 1.01 * RADIUS_RANGE_M[1]


@given(seeds)
def test_the_rated_speed_is_one_that_a_sign_shows_and_a_dry_road_carries(seed: int) -> None:
    section = section_of(seed)
    speed_mps = section.speed_limit_mps
    assert min(abs(speed_mps - kph_to_mps(10.0 * tens)) for tens in range(2, 9)) < 0.01
    assert speed_mps**2 / section.tightest_radius_m < 0.65 * 9.81


@given(seeds)
def test_a_road_starts_and_ends_straight_so_that_it_can_be_entered(seed: int) -> None:
    curvature = section_of(seed).profile.curvature_1pm
    assert abs(curvature[0]) < 1.0 / RADIUS_RANGE_M[1]
    assert abs(curvature[-1]) < 1.0 / RADIUS_RANGE_M[1]


@given(seeds)
@example(156)
def test_a_road_never_crosses_itself(seed: int) -> None:
    profile = section_of(seed).profile
    assert not crosses_itself(np.column_stack([profile.x_m, profile.y_m])[::3])


@given(seeds)
def test_its_bank_is_the_books_and_says_so(seed: int) -> None:
    section = section_of(seed)
    assert section.bank_origin is BankOrigin.INFERRED
    assert np.abs(section.profile.cross_slope_ratio).max() <= 1.05 * BANK_CAP_RATIO


def test_a_loop_would_be_noticed() -> None:
    angle = np.linspace(0.0, 2.0, 40) * np.pi * 1.5
    assert crosses_itself(np.column_stack([np.sin(angle), np.cos(angle) + 0.02 * angle]))


def crosses_itself(points: FloatArray) -> bool:
    start, end = points[:-1], points[1:]
    a, b, c, d = start[:, None], end[:, None], start[None], end[None]
    apart = (side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0)
    i, j = np.nonzero(apart)
    return bool((np.abs(i - j) > 1).any())


def side(a: FloatArray, b: FloatArray, p: FloatArray) -> FloatArray:
    """On which side of the line from a to b a point lies: the sign of the cross product."""
    across: FloatArray = (b - a)[..., 0] * (p - a)[..., 1] - (b - a)[..., 1] * (p - a)[..., 0]
    return across

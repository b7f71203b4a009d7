"""Extreme manoeuvres: their paths, who drives them, that the car can, and that they are extreme."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadgrip.records import Rejected
from roadgrip.section import BankOrigin, RoadSection
from roadgrip.section_file import section_from_json, section_to_json
from roadgrip.sections import read_section
from roadgrip.units import FloatArray
from training.manoeuvres import (
    MANOEUVRE_FRICTIONS_MU,
    RATED_ACCEL_MPS2,
    Manoeuvre,
    StraightCase,
    draw_extreme_plan,
    draw_manoeuvre,
    draw_straight_plan,
    draw_test_driver,
    manoeuvre_section,
    manoeuvre_sections,
    straight_section,
)
from vehicle_client.pipeline import summarise_passage
from vehicle_client.simulator.plan import ALL_SYSTEMS, NO_SYSTEMS, draw_driver, draw_plan
from vehicle_client.simulator.run import Drive, simulate_passage

kinds = st.sampled_from(Manoeuvre)
seeds = st.integers(0, 2**32)
DRIVES_COUNT = 16


def lateral_m(section: RoadSection) -> FloatArray:
    """Distance of the path from the straight line along which it starts."""
    profile = section.profile
    east_m, north_m = profile.x_m - profile.x_m[0], profile.y_m - profile.y_m[0]
    heading = np.arctan2(north_m[5], east_m[5])
    across_m: FloatArray = north_m * np.cos(heading) - east_m * np.sin(heading)
    return across_m


def test_frictions_go_from_a_fifth_to_one() -> None:
    assert (MANOEUVRE_FRICTIONS_MU[0], MANOEUVRE_FRICTIONS_MU[-1]) == (0.2, 1.0)
    assert np.diff(MANOEUVRE_FRICTIONS_MU) == pytest.approx(0.05)


@pytest.mark.parametrize("section", [*manoeuvre_sections(), straight_section()], ids=lambda s: s.section_id)
def test_a_proving_ground_is_flat_and_known_to_be(section: RoadSection) -> None:
    assert not section.profile.cross_slope_ratio.any()
    assert not section.profile.grade_ratio.any()
    assert section.bank_origin is BankOrigin.MEASURED
    assert len(section.anchors) >= 2
    assert section_from_json(section_to_json(section)) == section


def test_the_slalom_passes_cones_18_m_apart_on_alternate_sides() -> None:
    section = manoeuvre_section(Manoeuvre.SLALOM)
    y_m = lateral_m(section)
    x_m = np.hypot(section.profile.x_m - section.profile.x_m[0], section.profile.y_m - section.profile.y_m[0])
    swings = np.flatnonzero((np.diff(y_m)[1:] * np.diff(y_m)[:-1] < 0.0) & (np.abs(y_m[1:-1]) > 1.2)) + 1
    assert len(swings) >= 5
    assert np.diff(x_m[swings]) == pytest.approx(18.0, abs=2.1)  # the profile has a point per metre
    assert (np.diff(np.sign(y_m[swings])) != 0.0).all()


def test_the_lane_change_leads_to_the_next_lane_and_back() -> None:
    y_m = lateral_m(manoeuvre_section(Manoeuvre.LANE_CHANGE))
    assert y_m.max() == pytest.approx(3.5, abs=0.1)
    assert y_m[-1] == pytest.approx(0.0, abs=0.1)


def test_the_ninety_degrees_are_ninety_degrees() -> None:
    heading = manoeuvre_section(Manoeuvre.NINETY_DEGREES).profile.heading_rad
    assert np.rad2deg(heading[-1] - heading[0]) == pytest.approx(90.0, abs=0.2)


@given(kind=kinds, seed=seeds)
def test_every_variant_asks_for_nearly_all_that_a_dry_road_gives(kind: Manoeuvre, seed: int) -> None:
    section = draw_manoeuvre(np.random.default_rng(seed), kind, section_id="variant")
    accel_mps2 = section.speed_limit_mps**2 / section.tightest_radius_m
    assert accel_mps2 == pytest.approx(RATED_ACCEL_MPS2, rel=0.2)  # speeds are rounded to 5 km/h
    assert section.tightest_radius_m > 10.0


@given(kind=kinds, seed=seeds)
def test_every_variant_begins_and_ends_straight(kind: Manoeuvre, seed: int) -> None:
    curvature = draw_manoeuvre(np.random.default_rng(seed), kind, section_id="variant").profile.curvature_1pm
    assert abs(curvature[0]) < 2e-3
    assert abs(curvature[-1]) < 2e-3


def test_variants_turn_either_way_first() -> None:
    turns = set()
    for seed in range(30):
        section = draw_manoeuvre(np.random.default_rng(seed), Manoeuvre.NINETY_DEGREES, section_id="variant")
        turns.add(bool(section.profile.heading_rad[-1] > section.profile.heading_rad[0]))
    assert turns == {True, False}


@given(seed=seeds, friction_mu=st.floats(0.2, 1.0))
def test_a_test_driver_pushes_harder_than_anybody_and_sees_the_surface_no_better(seed: int, friction_mu: float) -> None:
    tester = draw_test_driver(np.random.default_rng(seed), base_friction_mu=friction_mu)
    usual = draw_driver(np.random.default_rng(seed), base_friction_mu=friction_mu)
    assert tester.friction_guess_mu == usual.friction_guess_mu
    assert 0.8 <= tester.grip_share_ratio <= 1.1
    assert 9.0 <= tester.comfort_accel_mps2 <= 12.0


def test_half_of_the_drives_are_without_stability_systems() -> None:
    section = manoeuvre_section(Manoeuvre.SINE)
    plans = [
        draw_extreme_plan(np.random.default_rng(seed), section=section, base_friction_mu=0.5) for seed in range(200)
    ]
    assert {plan.stability for plan in plans} == {ALL_SYSTEMS, NO_SYSTEMS}
    assert np.mean([plan.stability == NO_SYSTEMS for plan in plans]) == pytest.approx(0.5, abs=0.15)


@pytest.fixture(scope="module")
def dry_drives() -> dict[Manoeuvre, list[Drive]]:
    """Drives of every kind on a dry road."""
    return {
        kind: [
            simulate_passage(
                manoeuvre_section(kind),
                draw_extreme_plan(
                    np.random.default_rng([11, number]), section=manoeuvre_section(kind), base_friction_mu=1.0
                ),
            )
            for number in range(DRIVES_COUNT)
        ]
        for kind in Manoeuvre
    }


@pytest.fixture(scope="module")
def usual_drives() -> list[Drive]:
    """Ordinary drives on a dry road."""
    road = read_section("long-turn")
    return [
        simulate_passage(road, draw_plan(np.random.default_rng([11, number]), section=road, base_friction_mu=1.0))
        for number in range(5)
    ]


@pytest.mark.sim
@pytest.mark.parametrize("kind", Manoeuvre)
def test_most_complete_a_manoeuvre_on_a_dry_road(kind: Manoeuvre, dry_drives: dict[Manoeuvre, list[Drive]]) -> None:
    assert np.mean([drive.completed for drive in dry_drives[kind]]) > 0.5


@pytest.mark.sim
@pytest.mark.parametrize("kind", Manoeuvre)
def test_the_vehicles_own_client_recognises_and_reports_it(
    kind: Manoeuvre, dry_drives: dict[Manoeuvre, list[Drive]]
) -> None:
    completed = [drive for drive in dry_drives[kind] if drive.completed][:6]
    assert completed
    for drive in completed:
        assert not isinstance(summarise_passage(drive.trace, manoeuvre_section(kind)), Rejected)


@pytest.mark.sim
@pytest.mark.parametrize("kind", Manoeuvre)
def test_it_is_extreme_beside_an_ordinary_drive_at_the_same_friction(
    kind: Manoeuvre, dry_drives: dict[Manoeuvre, list[Drive]], usual_drives: list[Drive]
) -> None:
    extreme = [drive for drive in dry_drives[kind] if drive.completed]
    assert np.median([peak_steer_rad(drive) for drive in extreme]) > 3.0 * max(peak_steer_rad(d) for d in usual_drives)
    used = [drive.peak_utilisation_ratio for drive in extreme]
    assert np.median(used) > 1.3 * np.median([drive.peak_utilisation_ratio for drive in usual_drives])


def peak_steer_rad(drive: Drive) -> float:
    return float(np.abs(drive.truth.steer_rad).max())


@pytest.mark.sim
@pytest.mark.parametrize("case", StraightCase)
@pytest.mark.parametrize("friction_mu", [0.3, 0.9])
def test_on_the_straight_the_pedals_do_what_the_case_says(case: StraightCase, friction_mu: float) -> None:
    section = straight_section()
    plan = draw_straight_plan(np.random.default_rng(2), case=case, base_friction_mu=friction_mu)
    drive = simulate_passage(section, plan)
    assert drive.completed
    assert not isinstance(summarise_passage(drive.trace, section), Rejected)
    speed_mps, accel_mps2 = drive.truth.velocity_x_mps, drive.truth.accel_x_mps2
    if case is StraightCase.CONSTANT_SPEED:
        assert np.ptp(speed_mps) < 1.0
    elif case is StraightCase.SOFT_BRAKING:
        assert -3.0 < accel_mps2.min() < -0.8
        assert not drive.truth.abs_active.any()
    elif case is StraightCase.FULL_BRAKING:
        assert accel_mps2.min() < -0.8 * friction_mu * plan.wear_factor * 9.81
        assert drive.truth.abs_active.any()
    else:
        assert accel_mps2.min() > -0.5
        assert speed_mps[-1] > 1.3 * speed_mps[0]

"""The map that a vehicle is given: the same line, slightly wrong bank and grade."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.section import RoadSection, build_section
from roadgrip.section_file import section_from_json, section_to_json
from roadgrip.sections import read_section
from vehicle_client.simulator.amplitudes import AUTOMOTIVE, IDEAL, scaled
from vehicle_client.simulator.map_error import map_as_surveyed

ROADS = ("long-turn", "s-turn", "sharp-turn")
DRAWS = 300


def straight(*, length_m=600.0, step_m=20.0) -> RoadSection:
    x = np.arange(0.0, length_m + 1.0, step_m)
    nodes = np.column_stack([x, 0.0 * x, 0.02 * x])
    return build_section(
        section_id="straight", name="straight", nodes_m=nodes, speed_limit_mps=20.0, cross_slope_ratio=0.03 + 0.0 * x
    )


def angle_errors(section, rng, *, sensors=AUTOMOTIVE):
    """Return the errors of bank and grade along the profile of one map."""
    true, wrong = section.profile, map_as_surveyed(section, rng=rng, sensors=sensors).profile
    bank = np.arctan(wrong.cross_slope_ratio) - np.arctan(true.cross_slope_ratio)
    return bank, np.arctan(wrong.grade_ratio) - np.arctan(true.grade_ratio)


@pytest.mark.parametrize("name", ROADS)
def test_an_exact_survey_returns_the_road_itself(rng, name):
    section = read_section(name)
    assert map_as_surveyed(section, rng=rng, sensors=IDEAL) is section


@pytest.mark.parametrize("name", ROADS)
def test_line_limits_and_words_stay_and_the_version_does_not(rng, name):
    section = read_section(name)
    surveyed = map_as_surveyed(section, rng=rng, sensors=AUTOMOTIVE)
    assert surveyed.version != section.version
    assert np.array_equal(surveyed.nodes_m[:, :2], section.nodes_m[:, :2])
    assert np.array_equal(surveyed.profile.curvature_1pm, section.profile.curvature_1pm)
    assert surveyed.nodes_m[0, 2] == section.nodes_m[0, 2]
    for attribute in ("section_id", "name", "direction", "crs", "origin_m", "bank_origin", "speed_limit_mps"):
        assert getattr(surveyed, attribute) == getattr(section, attribute), attribute
    assert surveyed.anchors == section.anchors


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_survey_is_a_function_of_road_and_chance_and_comes_back_from_its_file(seed):
    section = read_section("s-turn")
    one, two = (map_as_surveyed(section, rng=np.random.default_rng(seed), sensors=AUTOMOTIVE) for _ in range(2))
    assert one == two
    assert section_from_json(section_to_json(one)) == one


def test_errors_over_many_roads_have_the_stated_size():
    rng, section = np.random.default_rng(2), straight()
    errors = np.array([angle_errors(section, rng) for _ in range(DRAWS)])
    bank, grade = errors[:, 0], errors[:, 1]
    assert np.sqrt((bank**2).mean()) == pytest.approx(AUTOMOTIVE.map_bank_rad, rel=0.1)
    # Heights say the mean grade between two nodes, so a little of what varies is lost.
    assert np.sqrt((grade**2).mean()) == pytest.approx(AUTOMOTIVE.map_grade_rad, rel=0.12)
    assert abs(bank.mean()) < 0.15 * AUTOMOTIVE.map_bank_rad
    assert abs(grade.mean()) < 0.15 * AUTOMOTIVE.map_grade_rad
    assert abs(np.corrcoef(bank.ravel(), grade.ravel())[0, 1]) < 0.15


def test_half_of_the_error_lasts_and_half_forgets_itself_over_a_hundred_metres():
    rng, section = np.random.default_rng(4), straight()
    bank = np.array([angle_errors(section, rng)[0] for _ in range(3 * DRAWS)]) / AUTOMOTIVE.map_bank_rad
    for apart_m in (0, 100, 400):
        related = float((bank[:, : -apart_m or None] * bank[:, apart_m:]).mean())
        assert related == pytest.approx(0.5 + 0.5 * np.exp(-apart_m / 100.0), abs=0.1), apart_m


def test_a_survey_twice_as_bad_is_twice_as_wrong():
    section = straight()
    once = angle_errors(section, np.random.default_rng(8))
    twice = angle_errors(section, np.random.default_rng(8), sensors=scaled(AUTOMOTIVE, 2.0))
    # Slopes are rounded to 1e-4 and heights to millimetres.
    assert np.allclose(twice[0], 2.0 * once[0], atol=3e-4)
    assert np.allclose(twice[1], 2.0 * once[1], atol=6e-4)


def test_no_survey_makes_a_bank_that_no_map_can_hold(rng):
    nodes = np.column_stack([np.arange(0.0, 101.0, 10.0), np.zeros(11), np.zeros(11)])
    steep = build_section(
        section_id="steep", name="steep", nodes_m=nodes, speed_limit_mps=20.0, cross_slope_ratio=np.full(11, 0.25)
    )
    for _ in range(20):
        assert np.abs(map_as_surveyed(steep, rng=rng, sensors=AUTOMOTIVE).cross_slope_ratio).max() <= 0.25

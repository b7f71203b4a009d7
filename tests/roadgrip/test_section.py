import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from roadgrip.errors import SectionError
from roadgrip.section import (
    GnssAnchor,
    build_section,
    cross_slope_of_bank,
    ideal_bank_ratio,
    inferred_bank_ratio,
    road_difficulty_ratio,
)
from roadgrip.spline import evaluate, second_derivatives
from tests.roadgrip.roads import circle_section, sections


@pytest.mark.parametrize("radius_m", [25.0, -25.0, 100.0, -400.0])
def test_a_circle_has_its_curvature_everywhere_and_left_is_positive(radius_m):
    section = circle_section(radius_m, step_m=min(8.0, abs(radius_m) / 8.0))
    # Whole millimetres at nodes 8 m apart are worth up to 1e-4 of curvature.
    assert section.profile.curvature_1pm == pytest.approx(1.0 / radius_m, rel=0.02, abs=1e-4)


def test_a_circle_has_its_length_and_turns_by_its_angle():
    section = circle_section(100.0, turn_rad=2.0)
    assert section.length_m == pytest.approx(200.0, abs=0.01)
    assert np.ptp(section.profile.heading_rad) == pytest.approx(2.0, abs=1e-3)
    assert section.tightest_radius_m == pytest.approx(100.0, rel=0.01)


def test_a_full_turn_does_not_wrap_the_heading():
    heading = circle_section(50.0, turn_rad=9.0, step_m=5.0).profile.heading_rad
    assert np.ptp(heading) == pytest.approx(9.0, abs=0.01)


@given(sections())
@settings(max_examples=25)
def test_stations_are_even_and_the_heading_is_the_integral_of_the_curvature(section):
    profile = section.profile
    step = np.diff(profile.station_m)
    assert np.ptp(step) < 1e-9
    assert step[0] == pytest.approx(1.0, abs=0.05)
    turned = np.sum((profile.curvature_1pm[1:] + profile.curvature_1pm[:-1]) / 2.0 * step)
    assert profile.heading_rad[-1] - profile.heading_rad[0] == pytest.approx(turned, abs=2e-3)
    assert np.hypot(np.diff(profile.x_m), np.diff(profile.y_m)) == pytest.approx(step, rel=2e-3)


@given(sections())
@settings(max_examples=25)
def test_the_mirrored_road_has_the_mirrored_curvature_and_the_same_bank(section):
    mirrored = dataclasses.replace(
        section, nodes_m=section.nodes_m * [1.0, -1.0, 1.0], cross_slope_ratio=-section.cross_slope_ratio
    )
    assert mirrored.profile.curvature_1pm == pytest.approx(-section.profile.curvature_1pm)
    assert mirrored.profile.bank_ratio == pytest.approx(section.profile.bank_ratio)
    assert mirrored.profile.road_difficulty_ratio == pytest.approx(section.profile.road_difficulty_ratio)


def test_grade_is_rise_over_horizontal_distance():
    nodes = np.column_stack([np.arange(0.0, 100.0, 10.0), np.zeros(10), 0.06 * np.arange(0.0, 100.0, 10.0)])
    section = circle_section(nodes_m=nodes)
    assert section.profile.grade_ratio == pytest.approx(0.06, abs=1e-4)


def test_only_the_inward_bank_counts_and_not_beyond_the_cap():
    inward = circle_section(100.0, cross_slope_ratio=np.full(26, -0.05))
    assert inward.profile.bank_ratio == pytest.approx(0.05)
    outward = circle_section(100.0, cross_slope_ratio=np.full(26, 0.05))
    assert outward.profile.bank_ratio == pytest.approx(0.0)
    assert outward.profile.cross_slope_ratio == pytest.approx(0.05)
    steep = circle_section(100.0, cross_slope_ratio=np.full(26, -0.2))
    assert steep.profile.bank_ratio == pytest.approx(0.08)


def test_ideal_bank_of_the_paper_by_hand():
    # V = 80 km/h, R = 150 m: 6400 / (127 150) - 0.14
    assert ideal_bank_ratio(np.array([1 / 150, -1 / 150]), speed_limit_mps=80 / 3.6) == pytest.approx(
        0.195958, abs=1e-6
    )
    assert ideal_bank_ratio(np.array([0.0]), speed_limit_mps=20.0) == pytest.approx(-0.14)


def test_inferred_bank_lies_within_zero_and_the_cap():
    curvature = np.array([0.0, 1 / 1000, 1 / 300, -1 / 300, 1 / 50])
    bank = inferred_bank_ratio(curvature, speed_limit_mps=80 / 3.6)
    assert bank == pytest.approx([0.0, 0.0, 6400 / 127 / 300 - 0.14, 6400 / 127 / 300 - 0.14, 0.08])


def test_a_left_turn_lifts_the_right_edge():
    assert cross_slope_of_bank(np.array([0.05, 0.05]), np.array([0.01, -0.01])).tolist() == [-0.05, 0.05]


@given(st.floats(-0.14, 2.0), st.floats(0.0, 0.1))
def test_road_difficulty_is_the_tangent_of_the_difference_of_angles(ideal, bank):
    # tan(a - b) = (tan a - tan b) / (1 + tan a tan b)
    expected = (ideal - bank) / (1.0 + ideal * bank)
    assert road_difficulty_ratio(np.array([ideal]), np.array([bank]))[0] == pytest.approx(expected, abs=1e-12)


def test_the_spline_is_the_cubic_one_with_parabolic_ends(rng):
    knots = np.cumsum(rng.uniform(1.0, 10.0, 12))
    values = rng.normal(size=(12, 3))
    at = np.linspace(knots[0], knots[-1], 200)
    value, first, second = evaluate(knots, values, second_derivatives(knots, values), at)
    # A zero third derivative at both ends says the same.
    zero = np.zeros(3)
    oracle = CubicSpline(
        knots, values, bc_type=((1, _end_slope(knots, values)), (1, _end_slope(knots, values, last=True)))
    )
    assert zero == pytest.approx(value[0] - values[0])
    assert value == pytest.approx(oracle(at), abs=1e-9)
    assert first == pytest.approx(oracle(at, 1), abs=1e-9)
    assert second == pytest.approx(oracle(at, 2), abs=1e-8)


def _end_slope(knots, values, *, last=False):
    _, first, second = evaluate(knots, values, second_derivatives(knots, values), knots)
    end, inner = (-1, -2) if last else (0, 1)
    assert second[end] == pytest.approx(second[inner])
    return first[end]


def test_a_parabola_is_reproduced_to_its_ends():
    knots = np.array([0.0, 3.0, 4.0, 9.0, 15.0])
    values = (0.5 * knots**2 - knots)[:, None]
    _, first, second = evaluate(knots, values, second_derivatives(knots, values), np.linspace(0.0, 15.0, 50))
    assert second == pytest.approx(1.0)
    assert first[:, 0] == pytest.approx(np.linspace(0.0, 15.0, 50) - 1.0)


def test_the_version_names_everything_in_the_map():
    section = circle_section()
    changed = [
        circle_section(name="Ring"),
        circle_section(speed_limit_mps=20.02),
        circle_section(crs="EPSG:25833"),
        circle_section(origin_m=(0.0, 0.0, 0.002)),
        circle_section(anchors=[GnssAnchor(0.0, 60.0, 10.0)]),
        circle_section(bank_cap_ratio=0.06),
        circle_section(nodes_m=section.nodes_m + np.array([0.0, 0.0, 0.001])),
    ]
    assert len({section.version, *(s.version for s in changed)}) == len(changed) + 1


def test_equal_maps_are_equal_and_hash_alike():
    assert circle_section() == circle_section()
    assert hash(circle_section()) == hash(circle_section())
    assert circle_section() != circle_section(100.5)
    assert circle_section() != "circle"


def test_negative_zero_does_not_change_the_version():
    plus = circle_section(anchors=[GnssAnchor(0.0, 0.0, 0.0)], origin_m=(0.0, 0.0, 0.0))
    minus = circle_section(anchors=[GnssAnchor(-0.0, -1e-9, -0.0)], origin_m=(-0.0, -0.0, -1e-6))
    assert plus.version == minus.version


def test_a_map_cannot_be_changed():
    section = circle_section()
    with pytest.raises(ValueError, match="read-only"):
        section.nodes_m[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        section.profile.curvature_1pm[0] = 1.0


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"section_id": "Has Capitals"}, "lower-case"),
        ({"section_id": ""}, "lower-case"),
        ({"section_id": "x" * 49}, "lower-case"),
        ({"name": "x" * 81}, "80 characters"),
        ({"name": "two\nlines"}, "printable"),
        ({"crs": ""}, "coordinate reference"),
        ({"crs": "EPSG:25833\n"}, "coordinate reference"),
        ({"nodes_m": [[0, 0], [10, 0]]}, "east, north, up"),
        ({"nodes_m": [[0, 0, 0], [10, 0, 0], [20, 0, 0]]}, "3 nodes"),
        ({"nodes_m": [[0, 0, 0], [10, 0, 0], [20, 0, float("nan")], [30, 0, 0]]}, "finite"),
        ({"nodes_m": [[0, 0, 0], [10, 0, 0], [20, 0, 0], [51, 0, 0]]}, "apart"),
        ({"nodes_m": [[0, 0, 0], [10, 0, 0], [10.2, 0, 0], [20, 0, 0]]}, "apart"),
        ({"nodes_m": [[0, 0, 0], [2, 0, 0], [4, 0, 0], [6, 0, 0]]}, "length"),
        ({"nodes_m": [[0, 0, 0], [20, 0, 0], [0.5, 0.5, 0], [20, 1, 0], [40, 0, 0]]}, "radius|turns back"),
        ({"nodes_m": np.zeros((1001, 3))}, "1001 nodes"),
        ({"nodes_m": [[1e300, 0, 0], [-1e300, 0, 0], [0, 0, 0], [1, 0, 0]]}, "outside the world"),
        ({"cross_slope_ratio": [0.0, 0.0]}, "cross slopes"),
        ({"cross_slope_ratio": np.full(26, 0.3)}, "25 %"),
        ({"speed_limit_mps": 0.0}, "speed limit"),
        ({"speed_limit_mps": float("nan")}, "speed limit"),
        ({"bank_cap_ratio": 0.3}, "cap"),
        ({"origin_m": (float("inf"), 0.0, 0.0)}, "finite"),
        ({"origin_m": (1e12, 0.0, 0.0)}, "outside the world"),
        ({"anchors": [GnssAnchor(0.0, 91.0, 0.0)]}, "anchor"),
        ({"anchors": [GnssAnchor(float("nan"), 60.0, 0.0)]}, "anchor"),
        ({"anchors": [GnssAnchor(0.0, 60.0, 0.0)] * 201}, "anchors"),
    ],
)
def test_what_cannot_be_a_road_is_refused_with_its_id_and_the_reason(changes, told):
    with pytest.raises(SectionError, match=told):
        circle_section(**changes)


@given(
    st.lists(
        st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 3) | st.tuples(*[st.floats(-60.0, 60.0)] * 3),
        max_size=12,
    )
)
def test_any_nodes_give_a_finite_section_or_a_section_error(nodes):
    try:
        section = build_section(section_id="x", name="x", nodes_m=np.array(nodes).reshape(-1, 3), speed_limit_mps=20.0)
    except SectionError:
        return
    for field in dataclasses.fields(section.profile):
        assert np.isfinite(getattr(section.profile, field.name)).all()

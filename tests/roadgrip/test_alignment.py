import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d
from scipy.special import fresnel

from roadgrip.alignment import (
    Element,
    GradePoint,
    arc,
    centre_line,
    clothoid,
    mirrored_elements,
    smoothed_along,
    straight,
)
from roadgrip.errors import SectionError


def test_a_clothoid_is_the_fresnel_integral():
    length, end = 90.0, 1 / 60
    line = centre_line([clothoid(length, start_curvature_1pm=0.0, end_curvature_1pm=end)], node_step_m=5.0)
    scale = np.sqrt(np.pi * length / end)
    sine, cosine = fresnel(line.station_m / scale)
    assert line.nodes_m[:, 0] == pytest.approx(scale * cosine, abs=1e-6)
    assert line.nodes_m[:, 1] == pytest.approx(scale * sine, abs=1e-6)


def test_an_arc_is_a_circle_and_a_negative_radius_turns_right():
    line = centre_line([arc(np.pi * 50.0, radius_m=-50.0)], node_step_m=4.0)
    assert np.hypot(line.nodes_m[:, 0], line.nodes_m[:, 1] + 50.0) == pytest.approx(50.0, abs=1e-6)
    assert line.nodes_m[-1, :2] == pytest.approx([0.0, -100.0], abs=1e-6)
    assert line.heading_rad[-1] == pytest.approx(-np.pi)


@given(
    st.lists(st.tuples(st.floats(5.0, 80.0), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)), min_size=1, max_size=6)
)
def test_a_mirrored_alignment_is_the_mirrored_line(rows):
    elements = [Element(*row) for row in rows]
    line = centre_line(elements, node_step_m=6.0)
    mirror = centre_line(mirrored_elements(elements), node_step_m=6.0)
    assert mirror.nodes_m[:, 1] == pytest.approx(-line.nodes_m[:, 1], abs=1e-9)
    assert mirror.nodes_m[:, 0] == pytest.approx(line.nodes_m[:, 0], abs=1e-9)


@given(
    st.lists(st.tuples(st.floats(5.0, 80.0), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)), min_size=1, max_size=6)
)
def test_the_sampling_does_not_move_the_line(rows):
    elements = [Element(*row) for row in rows]
    coarse = centre_line(elements, node_step_m=20.0)
    fine = centre_line(elements, node_step_m=0.7)
    assert coarse.nodes_m[-1] == pytest.approx(fine.nodes_m[-1], abs=1e-6)
    assert coarse.station_m[-1] == pytest.approx(sum(e.length_m for e in elements))


def test_heights_are_the_integral_of_the_grades():
    grades = [GradePoint(0.0, 0.04), GradePoint(100.0, -0.04)]
    line = centre_line([straight(150.0)], node_step_m=10.0, grades=grades)
    # A parabola up to 100 m (back at zero), then 4 % down.
    assert line.nodes_m[5, 2] == pytest.approx(0.04 * 50.0 - 0.0004 * 50.0**2)
    assert line.nodes_m[10, 2] == pytest.approx(0.0, abs=1e-12)
    assert line.nodes_m[15, 2] == pytest.approx(-2.0)
    assert line.grade_ratio[[0, 5, 15]] == pytest.approx([0.04, 0.0, -0.04])


@pytest.mark.parametrize(
    ("elements", "grades"),
    [([], ()), ([straight(0.0)], ()), ([straight(float("nan"))], ()), ([straight(50.0)], (GradePoint(5.0, 0.0),) * 2)],
)
def test_alignments_that_cannot_be_are_refused(elements, grades):
    with pytest.raises(SectionError):
        centre_line(elements, node_step_m=5.0, grades=grades)


def test_smoothing_is_a_gaussian_away_from_the_ends(rng):
    values = rng.normal(size=(300, 2))
    mine = smoothed_along(values, step_m=0.5, sigma_m=4.0)
    oracle = gaussian_filter1d(values, 8.0, axis=0, truncate=4.0)
    assert mine[40:-40] == pytest.approx(oracle[40:-40], abs=1e-12)


@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(0.0, 30.0), st.integers(2, 80))
def test_smoothing_keeps_straight_lines_and_both_ends(offset, slope, sigma, count):
    values = offset + slope * np.arange(count)
    assert smoothed_along(values, step_m=1.0, sigma_m=sigma) == pytest.approx(values, abs=1e-9)
    bent = np.sin(np.arange(count) / 3.0)
    assert smoothed_along(bent, step_m=1.0, sigma_m=sigma)[[0, -1]] == pytest.approx(bent[[0, -1]], abs=1e-9)

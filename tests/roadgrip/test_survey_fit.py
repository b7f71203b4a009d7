import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadgrip.errors import SectionError
from roadgrip.geodesy import frame_of
from roadgrip.section import BankOrigin, Direction, inferred_bank_ratio
from roadgrip.section_file import section_from_json, section_to_json
from roadgrip.survey import survey_line
from roadgrip.survey_fit import ImportRequest, section_of_survey, surveyed_course
from rsu_app.road_import.reading import survey_of_bytes
from tests.rsu_app.road_import.surveys import ROADS, arc_points, needs_roads, ringebu_reference, ringebu_vertices

RINGEBU = ("long_turn_ringebu", "s_turn_ringebu_a", "sharp_turn_ringebu")


def _request(**changes) -> ImportRequest:
    return ImportRequest(**{"section_id": "bend", "name": "Bend", "speed_limit_kph": 60.0, **changes})


def _survey(points=None, crs="EPSG:25833", **extra):
    return survey_line(arc_points() if points is None else points, crs=crs, **extra)


@pytest.mark.parametrize(("radius_m", "turn_rad"), [(30.0, 5.0), (80.0, 2.5), (250.0, 1.0)])
@pytest.mark.parametrize("spacing_m", [2.0, 8.0, 15.0])
def test_an_arc_of_rounded_vertices_gives_its_radius_back(radius_m, turn_rad, spacing_m):
    section, report = section_of_survey(_survey(arc_points(radius_m, turn_rad, spacing_m)), _request(smoothing_m=10.0))
    # Decimetres leave noise of some 2e-4; smoothing reaches four standard deviations in from the ends.
    inner = section.profile.curvature_1pm[40:-40]
    assert inner == pytest.approx(1.0 / radius_m, rel=0.03, abs=6e-4)
    assert report.deviation_max_m < 0.6
    assert section.profile.grade_ratio[20:-20] == pytest.approx(0.05, abs=0.012)


def test_the_fit_reports_what_smoothing_cost():
    survey = _survey(arc_points(25.0, 2.5, 5.0))
    costs = [section_of_survey(survey, _request(smoothing_m=s))[1].deviation_rms_m for s in (0.0, 5.0, 10.0, 20.0)]
    assert costs == sorted(costs)
    assert costs[0] < 0.03
    assert costs[-1] > 0.5


def test_the_default_smoothing_depends_on_the_spacing_and_is_stated():
    for spacing_m, expected_m in ((1.0, 3.0), (4.0, 6.0), (12.0, 10.0)):
        _, report = section_of_survey(_survey(arc_points(spacing_m=spacing_m)), _request())
        assert report.smoothing_m == pytest.approx(expected_m, rel=0.02)


def test_a_section_lies_where_it_was_surveyed():
    points = arc_points()
    section, _ = section_of_survey(_survey(points), _request())
    assert section.origin_m == pytest.approx(points[0], abs=0.2)
    assert np.hypot(*(section.nodes_m[-1] + section.origin_m - points[-1])[:2]) < 0.2
    assert section.nodes_m[0].tolist() == [0.0, 0.0, 0.0]
    assert frame_of(section).residual_m < 0.05
    assert section_from_json(section_to_json(section)) == section


def test_a_local_line_has_no_anchors_and_works_all_the_same():
    section, _ = section_of_survey(_survey(crs="local"), _request())
    assert (section.crs, section.anchors) == ("local", ())


def test_an_unknown_speed_limit_is_an_error_unless_given():
    with pytest.raises(SectionError, match="--speed-limit"):
        section_of_survey(_survey(), _request(speed_limit_kph=None))
    with pytest.raises(SectionError, match="--speed-limit"):
        section_of_survey(_survey(speed_limits_kph=[0.0, 0.0]), _request(speed_limit_kph=None))
    known, _ = section_of_survey(_survey(speed_limits_kph=[0.0, 80.0, 80.0]), _request(speed_limit_kph=None))
    assert known.speed_limit_mps == pytest.approx(22.22)
    told, _ = section_of_survey(_survey(speed_limits_kph=[80.0]), _request())
    assert told.speed_limit_mps == pytest.approx(16.67)
    with pytest.raises(SectionError, match="60, 80 km/h"):
        section_of_survey(_survey(speed_limits_kph=[60.0, 80.0]), _request(speed_limit_kph=None))


def test_a_missing_bank_is_inferred_by_the_book_and_marked():
    section, _ = section_of_survey(_survey(arc_points(150.0)), _request(bank_cap_ratio=0.06))
    assert section.bank_origin is BankOrigin.INFERRED
    expected = inferred_bank_ratio(np.array([1 / 150.0]), speed_limit_mps=60 / 3.6, bank_cap_ratio=0.06)[0]
    assert 0.02 < expected < 0.06
    assert section.profile.bank_ratio[60:-60] == pytest.approx(expected, abs=0.012)
    assert section.profile.cross_slope_ratio[100] < 0.0  # a left turn: the left edge is lower


def test_a_measured_bank_is_kept_and_inward_means_inward():
    points = arc_points(100.0, spacing_m=5.0)
    given_bank, _ = section_of_survey(_survey(points, bank_ratio=[0.05] * len(points)), _request())
    assert given_bank.bank_origin is BankOrigin.MEASURED
    assert given_bank.profile.bank_ratio[20:-20] == pytest.approx(0.05, abs=1e-3)
    slope, _ = section_of_survey(_survey(points, cross_slope_ratio=[-0.05] * len(points)), _request())
    assert slope.profile.bank_ratio[20:-20] == pytest.approx(0.05, abs=1e-3)
    back, _ = section_of_survey(
        _survey(points, cross_slope_ratio=[-0.05] * len(points)), _request(direction=Direction.AGAINST)
    )
    assert back.profile.curvature_1pm[50] < 0.0
    assert back.profile.bank_ratio[20:-20] == pytest.approx(0.05, abs=1e-3)


def test_against_drives_backwards_unless_the_file_is_backwards_already():
    with_, _ = section_of_survey(_survey(), _request())
    against, _ = section_of_survey(_survey(), _request(direction=Direction.AGAINST))
    both, _ = section_of_survey(_survey(), _request(direction=Direction.AGAINST, reverse=True))
    assert against.profile.curvature_1pm[80] == pytest.approx(-with_.profile.curvature_1pm[-81], rel=0.05)
    assert both.nodes_m.tolist() == with_.nodes_m.tolist()
    assert {against.direction, both.direction} == {Direction.AGAINST}
    assert with_.direction is Direction.WITH
    assert against.version != both.version != with_.version


def test_a_stretch_is_cut_along_the_travel_and_keeps_its_curvature_at_the_ends():
    whole, _ = section_of_survey(_survey(), _request())
    part, report = section_of_survey(_survey(), _request(from_m=30.0, to_m=110.0))
    assert part.length_m == pytest.approx(80.0, abs=0.7)
    assert part.profile.curvature_1pm == pytest.approx(whole.profile.curvature_1pm[30:111], rel=0.1)
    assert report.survey_length_m == pytest.approx(whole.length_m, abs=0.5)
    assert report.survey_points_count == 9


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"from_m": 50.0, "to_m": 40.0}, "do not lie"),
        ({"from_m": -1.0}, "do not lie"),
        ({"to_m": 900.0}, "do not lie"),
        ({"from_m": float("nan")}, "do not lie"),
        ({"from_m": 50.0, "to_m": 60.0}, "shorter"),
        ({"smoothing_m": -1.0}, "smoothing"),
        ({"smoothing_m": 99.0}, "smoothing"),
        ({"speed_limit_kph": 0.0}, "kilometres per hour"),
        ({"speed_limit_kph": float("nan")}, "kilometres per hour"),
        ({"section_id": "No Id"}, "lower-case"),
        ({"bank_cap_ratio": 8.0}, "cap"),
    ],
)
def test_impossible_requests_are_refused(changes, told):
    with pytest.raises(SectionError, match=told):
        section_of_survey(_survey(), _request(**changes))


@pytest.mark.parametrize(
    ("points", "told"),
    [
        ([[0, 0], [10, 0]], "long"),
        ([[0, 0], [100, 0], [500, 0]], "apart; the road between"),
        ([[0, 0], [30, 0], [0, 1], [30, 2], [0, 3]], "apart|radius|turns back"),
    ],
)
def test_lines_that_are_no_road_are_refused(points, told):
    with pytest.raises(SectionError, match=told):
        section_of_survey(_survey(points, crs="local"), _request(smoothing_m=2.0))


def test_two_points_are_a_straight():
    section, _ = section_of_survey(_survey([[0.0, 0.0], [100.0, 0.0]], crs="local"), _request())
    assert section.length_m == pytest.approx(100.0, abs=0.01)
    assert np.abs(section.profile.curvature_1pm).max() < 1e-4


_COORDINATE = st.floats(-300.0, 300.0)


@given(
    st.lists(st.tuples(_COORDINATE, _COORDINATE, st.floats(-100.0, 100.0)), min_size=2, max_size=12),
    st.floats(0.0, 20.0),
)
@settings(max_examples=40)
def test_any_line_is_a_finite_section_or_a_section_error(points, smoothing_m):
    try:
        survey = survey_line(np.array(points), crs="local")
        section, report = section_of_survey(survey, _request(smoothing_m=smoothing_m))
    except SectionError:
        return
    assert np.isfinite(section.profile.curvature_1pm).all()
    assert np.isfinite([report.deviation_max_m, report.deviation_rms_m]).all()


def _compared(section, reference):
    """Curvature of the section at the points of the reference."""
    profile = section.profile
    x, y = profile.x_m + section.origin_m[0], profile.y_m + section.origin_m[1]
    nearest = [
        int(np.argmin((x - e) ** 2 + (y - n) ** 2))
        for e, n in zip(reference["east_utm33"], reference["north_utm33"], strict=True)
    ]
    return profile.curvature_1pm[nearest]


@needs_roads
@pytest.mark.parametrize("name", RINGEBU)
def test_a_fitted_real_road_is_imported_as_it_is(name):
    reference = ringebu_reference(name)
    survey = survey_of_bytes((ROADS / f"section_{name}.csv").read_bytes())
    with pytest.raises(SectionError, match="--speed-limit"):  # the register's 0 means unknown
        section_of_survey(survey, _request(speed_limit_kph=None))
    section, report = section_of_survey(survey, _request())
    curvature = _compared(section, reference)
    assert np.corrcoef(curvature, reference["curvature_1pm"])[0, 1] > 0.998
    assert np.abs(curvature).max() == pytest.approx(np.abs(reference["curvature_1pm"]).max(), rel=0.04)
    assert report.deviation_max_m < 0.03
    assert section.length_m == pytest.approx(reference["s_m"][-1], abs=0.5)


@needs_roads
@pytest.mark.parametrize("name", RINGEBU)
def test_the_registers_own_vertices_give_the_curvature_that_somebody_else_fitted(name):
    reference = ringebu_reference(name)
    section, report = section_of_survey(_survey(ringebu_vertices(name)), _request())
    curvature = _compared(section, reference)
    assert np.corrcoef(curvature, reference["curvature_1pm"])[0, 1] > 0.995
    assert np.abs(curvature).max() == pytest.approx(np.abs(reference["curvature_1pm"]).max(), rel=0.05)
    assert report.deviation_rms_m < 0.15
    assert report.deviation_max_m < 0.6


@needs_roads
def test_a_genuine_nvdb_answer_becomes_a_section():
    survey = survey_of_bytes((ROADS / "nvdb_v3_segmentert_sample.json").read_bytes())
    section, report = section_of_survey(survey, _request())
    assert section.length_m == pytest.approx(614.2, abs=1.0)
    assert report.deviation_rms_m < 0.25
    assert len(section.anchors) == 7
    assert 59.0 < section.anchors[0].lat_deg < 60.5


@pytest.mark.parametrize("radius_m", [40.0, 120.0])
def test_the_course_of_a_whole_line_bends_as_the_sections_cut_from_it(radius_m):
    survey = _survey(arc_points(radius_m, 6.0, 8.0))
    course = surveyed_course(survey)
    assert course.vertex_station_m[[0, -1]] == pytest.approx(course.station_m[[0, -1]])
    assert course.curvature_1pm[40:-40] == pytest.approx(1.0 / radius_m, rel=0.04, abs=1.2e-3)
    section, report = section_of_survey(survey, _request(from_m=50.0, to_m=150.0))
    assert report.smoothing_m == course.smoothing_m
    there = np.interp(50.0 + section.profile.station_m, course.station_m, course.curvature_1pm)
    assert section.profile.curvature_1pm == pytest.approx(there, abs=8e-4)

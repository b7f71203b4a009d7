import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Transformer

from roadgrip.errors import SectionError
from roadgrip.survey import reversed_survey, survey_line
from rsu_app.road_import.reading import BYTES_LIMIT, RoadFormat, survey_of_bytes
from tests.rsu_app.road_import.surveys import ROADS, arc_points, csv_of, needs_roads, wkt_of

POINTS = arc_points()
TO_WGS84 = Transformer.from_crs(32633, 4326, always_xy=True)


def _read(text: str, road_format: RoadFormat = RoadFormat.AUTO, crs: str | None = None):
    return survey_of_bytes(text.encode(), road_format=road_format, crs=crs)


def _nvdb(*pieces, head="LINESTRING Z(", **extra):
    return json.dumps(
        {"objekter": [{"geometri": {"wkt": wkt_of(np.array(p), head), "srid": "5973"}, **extra} for p in pieces]}
    )


def _geojson(points, **feature):
    lon, lat = TO_WGS84.transform(points[:, 0], points[:, 1])
    line = {"type": "LineString", "coordinates": np.column_stack([lon, lat, points[:, 2]]).tolist()}
    return json.dumps({"type": "Feature", "geometry": line, "properties": feature})


@pytest.mark.parametrize("head", ["LINESTRING Z(", "LINESTRING Z (", "linestring z(", "LINESTRING(", "LINESTRINGZ ("])
def test_wkt_with_and_without_the_space(head):
    survey = _read(wkt_of(POINTS, head), crs="EPSG:25833")
    assert survey.points_m == pytest.approx(POINTS)
    assert (survey.crs, survey.has_heights) == ("EPSG:25833", True)


def test_wkt_names_its_reference_or_is_told():
    assert _read("SRID=5973;" + wkt_of(POINTS)).crs == "EPSG:5973"
    assert _read("SRID=5973;" + wkt_of(POINTS), crs="local").crs == "local"
    with pytest.raises(SectionError, match="--crs"):
        _read(wkt_of(POINTS))


def test_a_measure_is_no_height():
    flat = _read("LINESTRING M (0 0 7, 10 0 8, 20 1 9)", crs="local")
    assert not flat.has_heights
    assert flat.points_m[:, 2].tolist() == [0.0, 0.0, 0.0]
    both = _read("LINESTRING ZM (0 0 7 1, 10 0 8 2, 20 1 9 3)", crs="local")
    assert both.points_m[:, 2].tolist() == [7.0, 8.0, 9.0]


def test_the_pieces_of_a_multilinestring_are_joined():
    survey = _read("MULTILINESTRING ((0 0, 10 0), (20 0, 10 0), (20 0, 30 5))", crs="local")
    assert survey.points_m[:, 0].tolist() == [0.0, 10.0, 20.0, 30.0]


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (0, 2, 1), (1, 2, 0)])
@pytest.mark.parametrize("flipped", [False, True])
def test_nvdb_segments_are_joined_whatever_their_order_and_direction(order, flipped):
    pieces = [POINTS[:6], POINTS[5:9], POINTS[8:]]
    pieces = [pieces[i][::-1] if flipped and i != order[0] else pieces[i] for i in order]
    survey = _read(_nvdb(*pieces))
    assert survey.points_m == pytest.approx(POINTS)
    assert survey.crs == "EPSG:5973"


def test_the_first_nvdb_segment_gives_the_direction():
    assert _read(_nvdb(POINTS[5::-1], POINTS[5:])).points_m == pytest.approx(POINTS[::-1])


def test_nvdb_segments_that_have_ended_are_history():
    live = json.loads(_nvdb(POINTS))
    dead = json.loads(_nvdb(POINTS + 500.0, metadata={"sluttdato": "2019-01-01"}, head="LINESTRING Z ("))
    both = {"objekter": [*dead["objekter"], *live["objekter"]]}
    assert _read(json.dumps(both)).points_m == pytest.approx(POINTS)
    with pytest.raises(SectionError, match="no live segment"):
        _read(json.dumps(dead))


def test_a_gap_between_segments_is_told_in_metres():
    with pytest.raises(SectionError, match=r"1 of 2 remain, the nearest .* m away"):
        _read(_nvdb(POINTS[:6], POINTS[8:]))


def test_geojson_in_degrees_becomes_metres():
    survey = _read(_geojson(POINTS, speed_limit_kmh=80))
    assert survey.crs == "EPSG:32632"  # the zone its longitude lies in, 10 degrees east
    lon, lat = TO_WGS84.transform(POINTS[:, 0], POINTS[:, 1])
    east, north = Transformer.from_crs(4326, 32632, always_xy=True).transform(lon, lat)
    assert survey.points_m == pytest.approx(np.column_stack([east, north, POINTS[:, 2]]), abs=1e-3)
    assert survey.speed_limit_kph == (80.0,)


def test_geojson_collections_are_joined_and_old_crs_members_understood():
    line = {"type": "LineString", "coordinates": POINTS[:6].tolist()}
    rest = {"type": "MultiLineString", "coordinates": [POINTS[5:9].tolist(), POINTS[8:].tolist()]}
    features = [{"type": "Feature", "geometry": g, "properties": None} for g in (line, rest)]
    raw = {
        "type": "FeatureCollection",
        "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25833"}},
        "features": features,
    }
    survey = _read(json.dumps(raw))
    assert survey.points_m == pytest.approx(POINTS)
    assert survey.crs == "EPSG:25833"


@pytest.mark.parametrize(
    ("columns", "crs", "found"),
    [
        ("east_utm33,north_utm33,height", None, "EPSG:25833"),
        ("East_UTM32,North_UTM32,z_m", None, "EPSG:25832"),
        ("east_utm17,north_utm17,height_m", None, "EPSG:32617"),
        ("east_m,north_m,height_m", "EPSG:25833", "EPSG:25833"),
        ("x_m,y_m,z_m", None, "local"),
        ("x_m,y_m,other", None, "local"),
    ],
)
def test_the_header_of_a_table_says_where_it_lies(columns, crs, found):
    survey = _read(csv_of(POINTS, columns), crs=crs)
    assert survey.crs == found
    assert survey.points_m[:, :2] == pytest.approx(POINTS[:, :2])
    assert survey.has_heights == ("other" not in columns)


def test_tables_may_use_semicolons_tabs_a_byte_order_mark_and_degrees():
    lon, lat = TO_WGS84.transform(POINTS[:, 0], POINTS[:, 1])
    text = csv_of(np.column_stack([lat, lon, POINTS[:, 2]]), "lat_deg,lon_deg,height")
    plain = _read(text)
    for other in ("\ufeff" + text, text.replace(",", ";"), text.replace(",", "\t"), text.replace("\n", "\r\n")):
        assert _read(other).points_m == pytest.approx(plain.points_m)


def test_tables_bring_bank_and_speed_limits():
    rows = np.column_stack([POINTS, np.full(len(POINTS), -0.04), np.full(len(POINTS), 60.0)])
    survey = _read(csv_of(rows, "x_m,y_m,z_m,cross_slope_ratio,speed_limit_kmh"))
    assert survey.cross_slope_ratio == pytest.approx(-0.04)
    assert survey.speed_limit_kph == (60.0,)


def test_the_other_way_round_left_is_right():
    line = survey_line(POINTS, crs="local", cross_slope_ratio=np.linspace(-0.05, 0.02, len(POINTS)).tolist())
    back = reversed_survey(line)
    assert back.points_m[0].tolist() == line.points_m[-1].tolist()
    assert back.cross_slope_ratio is not None
    assert back.cross_slope_ratio[0] == pytest.approx(-0.02)
    again = reversed_survey(back)
    assert again.points_m == pytest.approx(line.points_m)


def test_points_that_repeat_their_predecessor_are_dropped():
    assert len(_read("LINESTRING(0 0, 0 0, 10 0, 10 0.01, 20 0)", crs="local").points_m) == 3


GEO = '{"type": "LineString", "coordinates": %s}'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "empty"),
        ("  \n", "empty"),
        ("POLYGON((0 0, 1 1))", "column"),
        ("LINESTRING EMPTY", "not a LINESTRING"),
        ("LINESTRING (1, 2, 3)", "point 1 is '1'"),
        ("LINESTRING (0 0, 1 x)", "point 2"),
        ("LINESTRING Z (0 0, 1 1)", "does not fit"),
        ("LINESTRING (0 0, 1 1 1)", "all have"),
        ("LINESTRING (0 0, 0 0)", "no length"),
        ("LINESTRING (0 0, 1e400 0)", "finite"),
        ("LINESTRING Z (0 0 0, 1 1 -999999)", "no height"),
        ("{", "not JSON"),
        ('{"a": NaN}', "NaN"),
        ("[" * 100_000, "not JSON"),
        ('{"objekter": 7}', "objekter"),
        ('{"objekter": []}', "no live segment"),
        ('{"objekter": [7]}', "not an object"),
        ('{"objekter": [{}]}', r"objekter\[0\] has no geometri"),
        ('{"objekter": [{"geometri": {"wkt": "LINESTRING(0 0, 9 9)", "srid": 3857}}]}', "EPSG:3857"),
        ("[]", "object"),
        ('{"type": "Point"}', "not Point"),
        ('{"type": "FeatureCollection"}', "features"),
        ('{"type": "FeatureCollection", "features": []}', "no line"),
        ('{"type": "FeatureCollection", "features": [7]}', "Features"),
        ('{"type": "Feature"}', "geometry"),
        (GEO % "7", "LineString"),
        (GEO % "[]", "positions"),
        (GEO % "[[1], [2]]", "position 1"),
        (GEO % '[[1, 2], [1, "3"]]', "position 2"),
        (GEO % "[[1, 2], [1, true]]", "position 2"),
        (GEO % "[[1, 2], [1, 1e999]]", "position 2"),
        (GEO % "[[61.5, 100], [61.6, 100]]", "longitude first"),
        (GEO % "[[10, 60], [80, 60]]", "half the globe"),
        ('{"type": "LineString", "coordinates": [[0, 1], [1, 1]], "crs": {"properties": {"name": "x"}}}', "crs"),
        ("a,b\n1,2\n", "no position among the columns a, b"),
        ("x_m,y_m\n", "two or all|no length|points"),
        ("x_m,y_m\n0,0\n1\n", "line 3, column y_m"),
        ("x_m,y_m\n0,0\n1,nan\n", "'nan' is not a number"),
        ("x_m,y_m\n0,0\n1,1,5\n", None),
        ("x_m,x_m,y_m\n0,0,0\n", "same name"),
        ('x_m,y_m\n"0,0\n', "not a CSV"),
        ("x_m,y_m,bank_ratio\n0,0,5\n9,0,5\n", "not per cent"),
        ("x_m,y_m,bank_ratio,cross_slope_ratio\n0,0,0,0\n9,0,0,0\n", "leave one out"),
        ("east_m,north_m\n0,0\n9,9\n", "--crs"),
        ("east_utm33,north_utm33\n6834042,250908\n6834062,250908\n", "east comes first"),
        ("lat_deg,lon_deg\n-30,10\n-30.001,10\n", "latitudes"),
    ],
)
def test_what_is_wrong_is_said_in_plain_words(text, told):
    crs = "local" if text.startswith("LINESTRING") else None
    if told is None:
        assert len(_read(text, crs=crs).points_m) == 2  # a field too many is nobody's business
        return
    with pytest.raises(SectionError, match=told):
        _read(text, crs=crs)


def test_binary_and_oversized_files_are_refused():
    with pytest.raises(SectionError, match="compressed"):
        survey_of_bytes(b"\x1f\x8b\x08\xff")
    with pytest.raises(SectionError, match="bytes"):
        survey_of_bytes(bytes(BYTES_LIMIT + 1))


def test_more_points_than_any_road_has_are_refused():
    with pytest.raises(SectionError, match="50000"):
        _read("LINESTRING (" + "0 0," * 50_001 + "1 1)", crs="local")
    with pytest.raises(SectionError, match="50000"):
        _read("x_m,y_m\n" + "1,2\n" * 50_001)


GOOD = [wkt_of(POINTS), _nvdb(POINTS[:6], POINTS[5:]), _geojson(POINTS, speed_limit_kmh=80), csv_of(POINTS)]


@given(st.data())
@settings(max_examples=150)
def test_damaged_files_are_a_section_error_at_worst(data):
    text = data.draw(st.sampled_from(GOOD))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        cut = data.draw(st.integers(0, 30))
        put = data.draw(st.text(st.sampled_from('0123456789.,-+eE()[]{}":; \n\x00naNZM"\ufeffå'), max_size=6))
        text = text[:at] + put + text[at + cut :]
    _survives(text.encode("utf-8"), data.draw(st.sampled_from(RoadFormat)), data.draw(st.sampled_from([None, "local"])))


@given(st.binary(max_size=200), st.sampled_from(RoadFormat), st.none() | st.text(max_size=12))
@settings(max_examples=150)
def test_any_bytes_are_a_section_error_at_worst(data, road_format, crs):
    _survives(data, road_format, crs)


_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.sampled_from(["LineString", "Feature", "EPSG:25833"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(
                ["type", "coordinates", "geometry", "features", "properties", "crs", "objekter", "geometri"]
            ),
            inner,
            max_size=4,
        )
    ),
)


@given(_JSON)
@settings(max_examples=150)
def test_any_json_is_a_section_error_at_worst(value):
    _survives(json.dumps(value).encode(), RoadFormat.GEOJSON, None)
    _survives(json.dumps({"objekter": [{"geometri": value}, value]}).encode(), RoadFormat.NVDB, None)


def _survives(data, road_format, crs):
    try:
        survey = survey_of_bytes(data, road_format=road_format, crs=crs)
    except SectionError as error:
        told = str(error)
    else:
        told = ""
        assert np.isfinite(survey.points_m).all()
    assert len(told) < 400


@needs_roads
def test_a_genuine_nvdb_answer_is_read_and_joined():
    survey = survey_of_bytes((ROADS / "nvdb_v3_segmentert_sample.json").read_bytes())
    assert survey.crs == "EPSG:5973"
    length = np.hypot(*np.diff(survey.points_m[:, :2], axis=0).T).sum()
    assert length == pytest.approx(536 + 41 + 38, abs=2.0)  # the register's own `lengde`

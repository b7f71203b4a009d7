import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS, Transformer

from roadgrip.alignment import Element, centre_line
from roadgrip.errors import SectionError
from roadgrip.geodesy import (
    anchors_of,
    frame_of,
    lat_lon_to_utm,
    utm_to_lat_lon,
    utm_zone_of_crs,
    utm_zone_of_lon,
)
from roadgrip.section import GnssAnchor, build_section
from tests.roadgrip.roads import PAPER_ROADS, circle_section, packaged

UTM33 = Transformer.from_crs(4326, 32633, always_xy=True)


def test_utm_agrees_with_proj_to_a_micrometre(rng):
    lat, lon = rng.uniform(0.0, 84.0, 2000), rng.uniform(-5.0, 35.0, 2000)
    east, north = lat_lon_to_utm(lat, lon, zone=33)
    proj_east, proj_north = UTM33.transform(lon, lat)
    assert np.abs(east - proj_east).max() < 1e-5
    assert np.abs(north - proj_north).max() < 1e-5


def test_the_inverse_agrees_with_proj(rng):
    east, north = rng.uniform(0.0, 1e6, 2000), rng.uniform(0.0, 9.2e6, 2000)
    lat, lon = utm_to_lat_lon(east, north, zone=33)
    proj_lon, proj_lat = UTM33.transform(east, north, direction="INVERSE")
    assert np.abs(lat - proj_lat).max() < 1e-10
    assert np.abs(np.where(np.abs(lat) < 83.0, lon - proj_lon, 0.0)).max() < 1e-9


def test_published_coordinates_of_the_cn_tower():
    # 43 deg 38' 33.24" N, 79 deg 23' 13.7" W is published as 17T 630084 4833438.
    east, north = lat_lon_to_utm(43 + 38 / 60 + 33.24 / 3600, -(79 + 23 / 60 + 13.7 / 3600), zone=17)
    assert float(east) == pytest.approx(630_084, abs=1.0)
    assert float(north) == pytest.approx(4_833_438, abs=1.0)


def test_on_the_central_meridian_east_is_the_false_easting_and_north_the_scaled_meridian_arc():
    # Quarter meridian of WGS 84: 10,001,965.729 m (published).
    east, north = lat_lon_to_utm(45.0, 15.0, zone=33)
    assert float(east) == pytest.approx(500_000.0, abs=1e-6)
    # Meridian arc from the equator to 45 degrees on WGS 84: 4,984,944.378 m (published).
    assert float(north) == pytest.approx(0.9996 * 4_984_944.378, abs=0.001)


@given(st.floats(0.0, 83.9), st.floats(-180.0, 180.0))
def test_there_and_back_again(lat, lon):
    zone = utm_zone_of_lon(lon)
    again_lat, again_lon = utm_to_lat_lon(*lat_lon_to_utm(lat, lon, zone=zone), zone=zone)
    assert float(again_lat) == pytest.approx(lat, abs=1e-9)
    assert math.cos(math.radians(float(again_lon) - lon)) == pytest.approx(1.0, abs=1e-12)


def test_nan_and_points_out_of_reach_come_out_as_nan():
    assert np.isnan(lat_lon_to_utm([math.nan, 89.0, 60.0], [10.0, 10.0, -100.0], zone=33)).all()
    assert np.isnan(utm_to_lat_lon([math.nan, 1e12, 5e5], [6e6, 6e6, -1e300], zone=33)).all()


@pytest.mark.parametrize("code", [25828, 25832, 25833, 25838, 32601, 32633, 32660, 5971, 5973, 5976, 6171, 6173, 6176])
def test_every_known_reference_is_the_zone_that_proj_says(code):
    name = CRS.from_epsg(code).name
    assert f"zone {utm_zone_of_crs(f'EPSG:{code}')}N" in name


@pytest.mark.parametrize("crs", ["local", "", "EPSG:4326", "EPSG:32733", "EPSG:5941", "epsg", "EPSG:25833 "])
def test_other_references_are_refused(crs):
    with pytest.raises(SectionError, match="no northern UTM zone"):
        utm_zone_of_crs(crs)


@pytest.mark.parametrize("east_m", [150_000.0, 500_000.0, 845_000.0])
@pytest.mark.parametrize("curvature", [0.0, 1 / 300])
def test_a_frame_is_good_to_a_few_centimetres_over_a_kilometre_anywhere_in_the_zone(east_m, curvature):
    line = centre_line([Element(1000.0, curvature, curvature)], node_step_m=10.0, start_heading_rad=0.7)
    section = build_section(
        section_id="far",
        name="far",
        nodes_m=line.nodes_m,
        speed_limit_mps=20.0,
        crs="EPSG:25833",
        origin_m=(east_m, 7_000_000.0, 0.0),
    )
    section = dataclasses.replace(section, anchors=anchors_of(section))
    profile = section.profile
    lon, lat = UTM33.transform(east_m + profile.x_m, 7e6 + profile.y_m, direction="INVERSE")
    frame = frame_of(section)
    x, y = frame.to_local(lat, lon)
    assert np.hypot(x - profile.x_m, y - profile.y_m).max() < 0.05
    again_lat, again_lon = frame.to_lat_lon(x, y)
    assert np.abs(again_lat - lat).max() < 1e-9
    assert np.abs(again_lon - lon).max() < 1e-9


@pytest.mark.parametrize("name", PAPER_ROADS)
def test_packaged_roads_know_where_they_lie(name):
    section = packaged(name)
    frame = frame_of(section)
    assert frame.residual_m < 0.05
    first = section.anchors[0]
    x, y = frame.to_local(first.lat_deg, first.lon_deg)
    assert math.hypot(float(x), float(y)) < 0.05
    assert 57.0 < first.lat_deg < 72.0


def test_anchors_stand_at_both_ends_and_about_every_hundred_metres():
    stations = [a.station_m for a in packaged("long-turn").anchors]
    assert stations == pytest.approx([0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0], abs=0.11)


def test_two_anchors_carry_a_local_plane_that_is_turned_and_scaled():
    straight = circle_section(nodes_m=[[0, 0, 0], [20, 0, 0], [40, 0, 0], [60, 0, 0]])
    # The plane's "east" runs due north in truth; 60 m are 5.3859e-4 degrees of latitude at 60 degrees.
    north_deg = 60.0 / 111_412.0
    turned = dataclasses.replace(
        straight, anchors=(GnssAnchor(0.0, 60.0, 10.0), GnssAnchor(60.0, 60.0 + north_deg, 10.0))
    )
    frame = frame_of(turned)
    x, y = frame.to_local(60.0 + north_deg / 2.0, 10.0)
    assert float(x) == pytest.approx(30.0, abs=0.01)
    assert float(y) == pytest.approx(0.0, abs=0.01)
    lat, lon = frame.to_lat_lon(0.0, 10.0)  # ten metres to the left of northbound: west
    assert float(lat) == pytest.approx(60.0, abs=1e-6)
    assert float(lon) < 10.0


@pytest.mark.parametrize(
    ("anchors", "told"),
    [
        ((), "has 0 GNSS anchors"),
        ((GnssAnchor(0.0, 60.0, 10.0),), "has 1 GNSS anchors"),
        ((GnssAnchor(0.0, 60.0, 10.0), GnssAnchor(60.0, 60.0, 10.0)), "coincide"),
        ((GnssAnchor(0.0, 60.0, 10.0), GnssAnchor(60.0, 61.0, 10.0)), "contradict"),
        ((GnssAnchor(0.0, 60.0, 10.0), GnssAnchor(60.0, 60.0, 170.0)), "coincide or are nowhere"),
    ],
)
def test_anchors_that_cannot_carry_a_position_are_refused(anchors, told):
    section = dataclasses.replace(circle_section(), anchors=anchors)
    with pytest.raises(SectionError, match=told):
        frame_of(section)


def test_a_local_section_has_no_anchors_of_its_own():
    with pytest.raises(SectionError, match="local"):
        anchors_of(circle_section())

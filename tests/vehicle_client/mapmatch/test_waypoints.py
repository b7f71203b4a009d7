"""Points of greatest curvature."""

import numpy as np
import pytest

from tests.vehicle_client.synthetic import bump, negative, road, s_turn
from vehicle_client.mapmatch.waypoints import curvature_extremes, section_waypoints


def test_an_s_turn_has_two_of_opposite_sign():
    found = section_waypoints(road(s_turn))
    assert np.allclose(found.station_m, [125.0, 285.0], atol=2.0)
    # Means over 15 m are a little below the peaks of 1/80 and 1/60.
    assert found.curvature_1pm == pytest.approx([1 / 80, -1 / 60], rel=0.05)


def test_the_mirror_has_the_opposite_ones():
    here, there = section_waypoints(road(s_turn)), section_waypoints(road(negative(s_turn)))
    assert np.allclose(there.station_m, here.station_m)
    assert np.allclose(there.curvature_1pm, -here.curvature_1pm, atol=1e-9)


def test_two_bends_the_same_way_are_two():
    def twice(station_m):
        return bump(station_m, start_m=50, length_m=100, peak_1pm=0.01) + bump(
            station_m, start_m=220, length_m=100, peak_1pm=0.008
        )

    found = section_waypoints(road(twice))
    assert np.allclose(found.station_m, [100.0, 270.0], atol=2.0)


def test_a_straight_has_none():
    station = np.arange(0.0, 300.0)
    assert len(curvature_extremes(station, np.full(300, 1e-6)).station_m) == 0


def test_a_plain_arc_has_one():
    assert len(section_waypoints(road(lambda s: np.full_like(s, 1 / 100.0), length_m=150.0)).station_m) == 1

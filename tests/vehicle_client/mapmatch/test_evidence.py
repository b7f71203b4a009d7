"""What speaks for a place, and how much."""

from dataclasses import replace

import numpy as np
import pytest

from vehicle_client.mapmatch.evidence import PLANE_WEIGHTS, SPATIAL_WEIGHTS, Evidence
from vehicle_client.mapmatch.waypoints import VOTE_MIN, vote_of_waypoints

GOOD = Evidence(
    vote_ratio=1.6,
    curvature_misfit_frac=0.04,
    lateral_rms_m=0.15,
    height_rms_m=0.05,
    length_m=300.0,
    places_count=1.5,
    position_std_m=1.0,
)


def test_a_good_place_convinces_with_height_and_without():
    assert GOOD.convincing
    assert replace(GOOD, height_rms_m=None).convincing


@pytest.mark.parametrize(
    ("name", "worse"),
    [
        ("vote_ratio", -4.0),
        ("curvature_misfit_frac", 0.5),
        ("lateral_rms_m", 2.0),
        ("height_rms_m", 3.0),
        ("places_count", 40.0),
    ],
)
def test_whatever_fits_worse_lowers_the_confidence(name, worse):
    assert replace(GOOD, **{name: worse}).confidence_frac < GOOD.confidence_frac


@pytest.mark.parametrize("weights", [PLANE_WEIGHTS, SPATIAL_WEIGHTS])
def test_every_weight_has_the_sign_of_its_meaning(weights):
    assert weights.vote_ratio > 0.0
    assert max(weights.curvature_ratio, weights.lateral_ratio, weights.places_ratio) < 0.0
    assert weights.height_ratio <= 0.0


def test_an_unknown_position_does_not_convince():
    assert not replace(GOOD, position_std_m=40.0).convincing


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"curvature_misfit_frac": 0.8}, "curvature differs by 80%"),
        ({"lateral_rms_m": 5.0}, "5.0 m apart"),
        ({"height_rms_m": 4.0}, "heights differ by 4.0 m"),
        ({"position_std_m": 60.0}, "to 60 m"),
        ({"places_count": 30.0}, "too few and too gentle bends"),
    ],
)
def test_a_refusal_says_what_is_worst(changed, word):
    assert word in replace(GOOD, **changed).told


def test_every_waypoint_that_is_there_speaks_for_the_road():
    mapped = np.array([0.01, -0.02, 0.015])
    votes = [vote_of_waypoints(mapped[:k], mapped_1pm=mapped[:k]) for k in range(4)]
    assert votes[0] == 0.0
    assert (np.diff(votes) > 0.5).all()


def test_a_bend_the_other_way_speaks_against_it_but_not_without_end():
    mapped = np.array([0.02])
    assert vote_of_waypoints(-mapped, mapped_1pm=mapped) == VOTE_MIN
    assert vote_of_waypoints(np.array([1.0]), mapped_1pm=mapped) == VOTE_MIN


def test_left_and_right_weigh_the_same():
    mapped, driven = np.array([0.01, -0.02]), np.array([0.012, -0.015])
    assert vote_of_waypoints(-driven, mapped_1pm=-mapped) == vote_of_waypoints(driven, mapped_1pm=mapped)

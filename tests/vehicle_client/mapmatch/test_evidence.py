"""What speaks for a place, and how much."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from tests.vehicle_client.synthetic import clock_s, drive_over, road, s_turn
from vehicle_client.mapmatch.alignment import alignments, mapped_stretch, metred_drive
from vehicle_client.mapmatch.driven_line import DrivenLine, driven_line
from vehicle_client.mapmatch.evidence import (
    CONFIDENCE_MIN_FRAC,
    PLANE_WEIGHTS,
    SPATIAL_WEIGHTS,
    Evidence,
    Weights,
    evidence_of,
)
from vehicle_client.mapmatch.waypoints import VOTE_MIN, section_waypoints, vote_of_waypoints

GOOD = Evidence(
    vote_ratio=1.6,
    curvature_misfit_frac=0.04,
    lateral_rms_m=0.15,
    height_rms_m=0.05,
    length_m=300.0,
    turned_rad=2.0,
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


MEASURED = [
    (True, 2.1, 0.4, 0.63, 0.13, 600.0, 3.0, 1.2),
    (True, 2.0, 0.25, 0.45, 0.49, 600.0, 4.6, 1.2),
    (True, 2.1, 0.35, 0.91, 0.3, 600.0, 3.0, 1.2),
    (True, 1.0, 0.08, 0.11, 0.01, 81.0, 0.4, 20.7),
    (True, 1.0, 0.03, 0.07, 0.02, 117.0, 1.3, 91.6),
    (True, 2.0, 0.03, 1.1, 0.18, 600.0, 4.6, 1.2),
    (True, 1.0, 0.08, 0.11, 0.1, 495.0, 2.3, 22.2),
    (True, 1.9, 0.62, 0.63, 0.37, 600.0, 3.0, 1.2),
    (True, 0.9, 0.12, 0.2, 0.03, 75.0, 1.6, 2.9),
    (True, 1.0, 0.06, 0.08, 0.03, 124.0, 1.7, 84.5),
    (True, 1.0, 0.08, 0.29, 0.03, 345.0, 2.0, 4.8),
    (True, 3.0, 0.62, 0.32, 0.08, 90.0, 0.9, 2.6),
    (False, 0.9, 0.22, 0.45, 0.01, 108.0, 1.2, 2.2),
    (False, 4.0, 0.88, 1.03, 0.08, 144.0, 2.2, 2.0),
    (False, 0.8, 0.44, 1.41, 0.08, 192.0, 1.7, 3.1),
    (False, 0.7, 0.63, 0.91, 0.39, 252.0, 1.6, 2.2),
    (False, 0.5, 1.18, 0.68, 0.08, 272.0, 1.6, 1.7),
    (False, 0.7, 0.43, 1.65, 0.45, 102.0, 1.3, 2.1),
    (False, 3.9, 0.31, 3.42, 0.14, 393.0, 3.7, 1.3),
    (False, 4.5, 0.49, 0.7, 0.05, 192.0, 3.0, 1.5),
    (False, 0.8, 0.23, 0.42, 0.01, 45.0, 1.0, 4.3),
    (False, 1.1, 0.32, 2.06, 0.1, 598.0, 1.0, 1.1),
    (False, 1.0, 0.25, 0.33, 0.12, 185.0, 1.3, 56.9),
    (False, 1.1, 0.71, 0.31, 0.13, 157.0, 0.8, 4.7),
]
"""Right or not; vote, curvature misfit, metres apart, difference in height, length, angle turned, places: doubtful
cases of development roads, both kinds as often."""


def loss(weights: Weights) -> float:
    """Return minus the mean logarithm of the probability given to what was the case."""
    total = 0.0
    for right, vote, curvature, lateral, height, length, turned, places in MEASURED:
        seen = (1.0, vote, *np.log([curvature + 0.02, lateral + 0.1, height + 0.05, length, turned, places]))
        log_odds = float(np.dot(weights, seen))
        total += float(np.logaddexp(0.0, -log_odds if right else log_odds))
    return total / len(MEASURED)


@pytest.mark.parametrize("weights", [PLANE_WEIGHTS, SPATIAL_WEIGHTS])
def test_no_two_weights_are_exchanged(weights):
    assert loss(weights) < 0.5
    for i, j in combinations(range(len(weights)), 2):
        swapped = list(weights)
        swapped[i], swapped[j] = swapped[j], swapped[i]
        assert loss(Weights(*swapped)) > loss(weights), (Weights._fields[i], Weights._fields[j])


@pytest.mark.parametrize("with_height", [True, False])
def test_each_weight_meets_what_it_is_named_for(with_height):
    weights = SPATIAL_WEIGHTS if with_height else PLANE_WEIGHTS
    for right, vote, curvature, lateral, height, length, turned, places in MEASURED:
        evidence = Evidence(vote, curvature, lateral, height if with_height else None, length, turned, places, 1.0)
        seen = (1.0, vote, *np.log([curvature + 0.02, lateral + 0.1, height + 0.05, length, turned, places]))
        # Without heights their weight is zero.
        assert evidence.log_odds == pytest.approx(float(np.dot(weights, seen))), right


def test_the_probability_is_that_of_the_odds():
    for vote in (-8.0, 0.0, 3.0, 8.0):
        evidence = replace(GOOD, vote_ratio=vote)
        frac = evidence.confidence_frac
        assert np.log(frac / (1.0 - frac)) == pytest.approx(evidence.log_odds)
        assert evidence.convincing == (frac >= CONFIDENCE_MIN_FRAC)
    assert replace(GOOD, vote_ratio=-1e4).confidence_frac >= 0.0


SECTION = road(s_turn)
TRACE, _ = drive_over(s_turn)
SPEED_MPS = TRACE.wheel_speed_mps[:, 2:].mean(axis=1)


def shown(line: DrivenLine, section=SECTION, *, length_m=400.0) -> Evidence | None:
    """Return what the best place of a drive shows."""
    drive = metred_drive(line, clock_s(len(line.distance_m)))
    assert drive is not None
    stretch = mapped_stretch(section.profile, length_m=length_m)
    place = min(alignments(drive, stretch), key=lambda one: one.residual_rms_rad)
    return evidence_of(drive, stretch, section_waypoints(section), place)


def test_sideslip_that_the_accelerometer_takes_for_a_climb_is_no_difference_in_height():
    accel_y = TRACE.yaw_rate_radps * SPEED_MPS
    line = driven_line(SPEED_MPS, TRACE.yaw_rate_radps, None, 0.02 * accel_y**2)
    climbing = driven_line(SPEED_MPS, TRACE.yaw_rate_radps, None, np.abs(np.sin(np.arange(len(SPEED_MPS)) * 0.002)))
    as_slid, as_hilly = shown(line), shown(climbing)
    assert as_slid is not None
    assert as_hilly is not None
    assert line.height_m is not None
    assert np.ptp(line.height_m) > 1.0
    assert as_slid.height_rms_m is not None
    assert as_slid.height_rms_m < 0.1
    assert as_hilly.height_rms_m is not None
    assert as_hilly.height_rms_m > 0.3


def test_only_the_waypoints_of_the_stretch_are_asked():
    line = driven_line(SPEED_MPS, TRACE.yaw_rate_radps)
    whole, half = shown(line), shown(line, length_m=200.0)
    assert whole is not None
    assert half is not None
    assert half.vote_ratio == pytest.approx(whole.vote_ratio / 2.0, rel=0.2)
    assert half.turned_rad == pytest.approx(whole.turned_rad / 2.0, rel=0.25)


def test_a_longer_drive_has_more_places():
    near, far = (drive_over(s_turn, approach_m=approach_m)[0] for approach_m in (80.0, 1000.0))
    seen = [shown(driven_line(one.wheel_speed_mps[:, 2:].mean(axis=1), one.yaw_rate_radps)) for one in (near, far)]
    assert seen[0] is not None
    assert seen[1] is not None
    assert seen[1].places_count - seen[0].places_count == pytest.approx(920.0 / 400.0, abs=0.02)


def test_headings_far_apart_show_nothing():
    hairpin = road(lambda station_m: 6.0 * s_turn(station_m))
    assert shown(driven_line(SPEED_MPS, -TRACE.yaw_rate_radps), hairpin) is None


def test_metres_apart_are_metres():
    # A heading that swings by 0.03 rad every 60 m: 0.29 m to and fro, 0.2 m root mean square.
    swing = 0.03 * np.sin(2.0 * np.pi * np.cumsum(SPEED_MPS) * 0.01 / 60.0)
    seen = shown(driven_line(SPEED_MPS, TRACE.yaw_rate_radps + np.gradient(swing, 0.01)))
    assert seen is not None
    assert seen.lateral_rms_m == pytest.approx(0.2, rel=0.2)

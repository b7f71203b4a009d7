"""What the channels of a drive say about each other."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vehicle_client.synthetic import drive_over, motion, s_turn
from vehicle_client.estimation.vehicle_geometry import XC90
from vehicle_client.recording.consistency import (
    LATERAL,
    Misreading,
    Relation,
    blocks_of,
    likeliest,
    relations_of,
    steering_gain_ratio,
)

TRACE, _ = drive_over(s_turn, swing_mps=2.0)


def test_a_block_with_a_hole_and_its_neighbours_say_nothing():
    whole = blocks_of(TRACE)
    holed = blocks_of(replace(TRACE, valid=np.arange(TRACE.samples_count) != 210))
    # Samples 200 to 219 are the block around 2.1 s; the slopes of its neighbours lean on it.
    missing = sorted(set(np.round(whole.time_s, 3)) - set(np.round(holed.time_s, 3)))
    assert missing == pytest.approx([1.9, 2.1, 2.3])


def test_a_car_that_hardly_moves_says_nothing():
    speed = np.where(np.arange(2000) < 1000, 20.0, 3.0)
    blocks = blocks_of(motion(speed, np.zeros(2000), steer_rad=np.zeros(2000)))
    assert blocks.time_s.max() < 10.1


def test_a_recording_of_holes_says_nothing():
    blocks = blocks_of(replace(TRACE, valid=np.arange(TRACE.samples_count) % 40 < 30))
    assert (len(blocks.time_s), relations_of(blocks, TRACE, XC90)) == (0, {})


def test_a_channel_that_the_car_lacks_is_in_no_relation():
    assert LATERAL in relations_of(blocks_of(TRACE), TRACE, XC90)
    lacking = replace(TRACE, absent=("accel_y_mps2",))
    assert LATERAL not in relations_of(blocks_of(lacking), lacking, XC90)


def test_at_one_speed_a_car_is_taken_to_understeer_as_usual():
    trace, _ = drive_over(s_turn)
    w = trace.yaw_rate_radps
    usual = XC90.wheelbase_m * w / 15.0 + 0.002 * 15.0 * w
    blocks = blocks_of(replace(trace, steer_rad=12.0 * usual))
    assert steering_gain_ratio(blocks, XC90, Misreading()) == pytest.approx(12.0, rel=0.02)


def test_a_small_misfit_is_rather_borne_than_explained_by_a_misreading():
    relations = {LATERAL: Relation(LATERAL, 1.3, 0.9, 0.4)}
    assert likeliest(relations) == Misreading()
    assert likeliest({LATERAL: Relation(LATERAL, -1.0, 0.2, 0.4)}) == Misreading()
    assert likeliest({LATERAL: Relation(LATERAL, -1.0, 0.9, 0.4)}).count == 1

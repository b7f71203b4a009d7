"""Slippery packaged roads without satellites: whoever slides must not be the one who is refused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from roadgrip.records import Rejected
from roadgrip.sections import read_section
from vehicle_client.pipeline import Summarised, summarise_passage
from vehicle_client.simulator.amplitudes import AUTOMOTIVE
from vehicle_client.simulator.map_error import map_as_surveyed
from vehicle_client.simulator.run import draw_plan, each_passage

pytestmark = pytest.mark.sim

DRIVES_COUNT = 48
SLIDING_RAD = np.deg2rad(3.0)


@cache
def passages(name):
    """Return map, drive and what the client says of it, for all drives that passed a slippery section."""
    section = read_section(name)
    rng = np.random.default_rng([31, len(name)])
    road_map = map_as_surveyed(section, rng=rng, sensors=AUTOMOTIVE)
    plans = [
        draw_plan(rng, section=section, base_friction_mu=rng.uniform(0.3, 0.6), with_gnss=False)
        for _ in range(DRIVES_COUNT)
    ]
    drives = [drive for drive in each_passage(section, plans) if drive.completed]
    return [(road_map, drive, summarise_passage(drive.trace, road_map)) for drive in drives]


@pytest.mark.parametrize("name", ["long-turn", "s-turn"])
def test_sliding_drives_are_found_as_others_are(name):
    found = passages(name)
    sliding = [outcome for _, drive, outcome in found if drive.peak_sideslip_rad > SLIDING_RAD]
    assert len(sliding) >= 4
    assert sum(isinstance(outcome, Rejected) for outcome in sliding) <= 0.25 * len(sliding)
    assert sum(isinstance(outcome, Rejected) for *_, outcome in found) <= 0.06 * len(found)


@pytest.mark.parametrize("name", ["long-turn", "s-turn"])
def test_the_stated_deviation_covers_nine_of_ten_ends(name):
    covered = []
    for road_map, drive, outcome in passages(name):
        if isinstance(outcome, Summarised):
            match = outcome.match
            ends = np.interp([match.entry_s, match.exit_s], drive.truth.time_s, drive.truth.station_m)
            covered += (np.abs(ends - [0.0, road_map.length_m]) <= 2.0 * match.position_std_m).tolist()
    assert np.mean(covered) >= 0.9


def test_a_car_without_a_lateral_accelerometer_is_matched_by_its_nose():
    road_map, drive, _ = passages("s-turn")[0]
    blind = replace(drive.trace, accel_y_mps2=np.zeros_like(drive.trace.accel_y_mps2), absent=("accel_y_mps2",))
    assert isinstance(summarise_passage(blind, road_map), Summarised)

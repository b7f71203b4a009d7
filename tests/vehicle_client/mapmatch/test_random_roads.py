"""Thirty random roads without satellites: a guard with wide margins; bench/onboard/matching.py has the figures."""

from functools import cache

import numpy as np
import pytest

from roadgrip.records import Rejected
from training.random_roads import random_section
from vehicle_client.estimation.vertical import vertical_velocity_mps
from vehicle_client.mapmatch.dead_reckoning import match_by_dead_reckoning
from vehicle_client.mapmatch.driven_line import driven_line
from vehicle_client.mapmatch.match import SectionMatch
from vehicle_client.simulator.amplitudes import AUTOMOTIVE
from vehicle_client.simulator.map_error import map_as_surveyed
from vehicle_client.simulator.run import draw_plan, simulate_passage

pytestmark = pytest.mark.sim

ROADS_COUNT = 30


@cache
def drives():
    """Return map, line, times and true stations of every drive that passed its section."""
    passed = []
    for number in range(ROADS_COUNT):
        rng = np.random.default_rng([14, number])
        section = random_section(rng, section_id=f"road-{number}")
        plan = draw_plan(rng, section=section, base_friction_mu=rng.uniform(0.25, 0.8), with_gnss=False)
        drive = simulate_passage(section, plan)
        if drive.completed:
            trace = drive.trace
            speed = trace.wheel_speed_mps[:, 2:].mean(axis=1)
            climb = vertical_velocity_mps(trace.accel_x_mps2, speed, trace.yaw_rate_radps)
            line = driven_line(speed, trace.yaw_rate_radps, None, climb)
            passed.append((map_as_surveyed(section, rng=rng, sensors=AUTOMOTIVE), line, trace.time_s, drive.truth))
    return passed


def test_nine_of_ten_find_their_road_to_ten_metres():
    errors = []
    for road_map, line, time_s, truth in drives():
        match = match_by_dead_reckoning(line, time_s, road_map)
        if isinstance(match, SectionMatch):
            seen = np.interp([match.entry_s, match.exit_s], time_s, truth.station_m)
            errors.append(np.abs(seen - [0.0, road_map.length_m]).max())
    assert len(errors) >= 0.9 * len(drives())
    assert max(errors) < 10.0
    assert np.median(errors) < 4.0


def test_hardly_any_of_nine_hundred_foreign_maps_is_accepted():
    taken = [
        isinstance(match_by_dead_reckoning(line, time_s, other), SectionMatch)
        for i, (_, line, time_s, _) in enumerate(drives())
        for j, (other, *_) in enumerate(drives())
        if i != j
    ]
    assert np.mean(taken) <= 0.01


def test_a_drive_torn_off_in_the_middle_is_never_a_passage():
    for road_map, line, time_s, truth in drives():
        torn = truth.station_m < 0.6 * road_map.length_m
        count = int(np.argmin(torn)) if not torn.all() else len(torn)
        piece = driven_line(np.gradient(line.distance_m[:count], 0.01), np.gradient(line.heading_rad[:count], 0.01))
        assert isinstance(match_by_dead_reckoning(piece, time_s[:count], road_map), Rejected)
